"""Progress on stderr: only for a person who waits (a terminal, and longer than a moment)."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

from canest.core.errors import printable
from canest.system import terminal

if TYPE_CHECKING:
    from rich.progress import Progress

#: shorter jobs show nothing, and so need not import rich
PATIENCE_S = 0.7


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


class Bar(_Shown):
    """Progress through one log, by bytes; it appears even while nothing is done yet.

    The first log after an update may wait for a quarter of a minute until numba has compiled.
    """

    def __enter__(self) -> Any:
        self._timer = threading.Timer(PATIENCE_S, self._draw)
        self._timer.daemon = True
        if sys.stderr.isatty():
            self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        super().__exit__(kind, error, trace)

    def update(self, done: int, total: int) -> None:
        """Take note of the bytes done, of all (0: unknown)."""
        self._show(done, total or None)


class Share(_Shown):
    """Progress as a share, 0 to 1."""

    def update(self, share: float) -> None:
        """Take note of the share done."""
        self._show(share, 1.0)


class Count(_Shown):
    """Progress through many logs."""

    def __init__(self, text: str, total: int) -> None:
        super().__init__(text, total)
        self._done = 0

    def step(self, name: str) -> None:
        """Take note of one more that is done."""
        self._done += 1
        self._text = name
        self._show(self._done, self._total)
