"""Text for a terminal: what a log, a file's name or a config may hold steers no terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TextIO

from canest.core.errors import printable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.console import Console, ConsoleOptions, ConsoleRenderable


class EscapingStream:
    """A text stream that shows what would steer a terminal as Python writes it; else as the one it wraps."""

    def __init__(self, stream: TextIO) -> None:
        self.unescaped = stream

    def write(self, text: str) -> int:
        """Write text; return its length."""
        self.unescaped.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write lines."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unescaped, name)


def console(*, stderr: bool = False, **options: Any) -> Console:
    """Return a rich console whose own colours reach the terminal, and nothing else that steers it."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    made = Console(file=getattr(stream, "unescaped", stream), **options)
    hook: Any = _Escape()  # rich's own class of hooks would import rich with this module
    made.push_render_hook(hook)
    return made


class _Escape:
    """A hook of rich that escapes what it is about to print."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Escaped(renderable) for renderable in renderables]


class _Escaped:
    def __init__(self, renderable: ConsoleRenderable) -> None:
        self._renderable = renderable

    def __rich_console__(self, of: Console, options: ConsoleOptions) -> Any:
        from rich.segment import Segment

        for text, style, control in of.render(self._renderable, options):
            yield Segment(text if control else printable(text), style, control)
