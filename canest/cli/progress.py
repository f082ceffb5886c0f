"""Progress on stderr: only for a person who waits (a terminal, and longer than a moment)."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

from canest.core import jit
from canest.core.errors import printable
from canest.system import terminal

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress

#: shorter jobs show nothing, and so need not import rich
PATIENCE_S = 0.7
#: nobody waits at a pipe for less
LINE_PATIENCE_S = 5.0
#: what is told before a log that takes longer than all others
COMPILING = "compiling the kernels: once after an installation, about a minute"


class _Shown:
    """A rich progress bar that appears late or never; use as a context manager."""

    def __init__(self, text: str, total: float | None = None) -> None:
        self._text, self._total, self._done = text, total, 0.0
        self._begin = time.monotonic()
        self._progress: Progress | None = None
        self._task: Any = None
        self._lock = threading.Lock()

    def _show(self, done: float, total: float | None) -> None:
        self._done, self._total = done, total
        if time.monotonic() - self._begin >= PATIENCE_S and sys.stderr.isatty():
            self._draw()

    def _draw(self) -> None:
        from rich.markup import escape

        with self._lock:
            if self._progress is None:
                from rich.progress import Progress

                self._progress = Progress(console=terminal.console(stderr=True), transient=True)
                self._task = self._progress.add_task("", total=self._total)
                self._progress.start()
            text = escape(printable(self._text))
            self._progress.update(self._task, completed=self._done, total=self._total, description=text)

    def __enter__(self) -> Any:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            if self._progress is not None:
                self._progress.stop()


class _Waiting(_Shown):
    """Appears even while nothing is done yet; tells that numba compiles, where it must."""

    def _appear(self) -> tuple[float, Callable[[], None]] | None:
        """Return after how long, s, what is to be done; None for nothing."""
        return (PATIENCE_S, self._draw) if sys.stderr.isatty() else None

    def _tell_compiling(self) -> None:
        with self._lock:
            if self._progress is None:
                print(COMPILING, file=sys.stderr, flush=True)
            else:
                self._progress.console.print(COMPILING)

    def __enter__(self) -> Any:
        jit.before_compiling(self._tell_compiling)
        wanted = self._appear()
        self._timer = None if wanted is None else threading.Timer(*wanted)
        if self._timer is not None:
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer.join()
        super().__exit__(kind, error, trace)


class Bar(_Waiting):
    """Progress through one log, by bytes."""

    def update(self, done: int, total: int) -> None:
        """Take note of the bytes done, of all (0: unknown)."""
        self._show(done, total or None)


class Stages(_Waiting):
    """Progress through stages of minutes; where standard error is no terminal, a line for each of them.

    The first word of the text is the stage.
    """

    _printed = ""

    def _appear(self) -> tuple[float, Callable[[], None]]:
        return super()._appear() or (LINE_PATIENCE_S, self._print)

    def show(self, text: str, share: float) -> None:
        """Take note of what is being done, and of the share done, 0 to 1."""
        self._text = text
        self._show(share, 1.0)
        waited = time.monotonic() - self._begin >= LINE_PATIENCE_S
        if waited and share < 1.0 and not sys.stderr.isatty():
            self._print()

    def _print(self) -> None:
        with self._lock:
            stage = self._text.split(" ", 1)[0]
            if stage != self._printed:
                self._printed = stage
                print(f"{100 * self._done:3.0f} %  {printable(self._text)}", file=sys.stderr, flush=True)


class Share(_Shown):
    """Progress as a share, 0 to 1."""

    def update(self, share: float) -> None:
        """Take note of the share done."""
        self._show(share, 1.0)


class Count(_Shown):
    """Progress through many logs. total: work of all of them."""

    def __init__(self, text: str, total: float) -> None:
        super().__init__(text, total)
        self._done = 0.0

    def step(self, text: str, work: float = 1.0) -> None:
        """Take note of one more that is done."""
        self._done += work
        self._text = text
        self._show(self._done, self._total)
