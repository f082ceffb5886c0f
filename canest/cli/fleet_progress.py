"""How far a run over thousands of logs is: a bar on a terminal, a line now and then in a file."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from canest.cli.progress import Count

if TYPE_CHECKING:
    from types import TracebackType

    from canest.fleet.job import Outcome

#: from line to line, where standard error is no terminal
LINE_EVERY_S = 60.0


class FleetProgress:
    """Shows how many logs are done and how long the rest will take; a context manager."""

    def __init__(self) -> None:
        self._count: Count | None = None
        self._total = self._ended = self._failed = self._quick = 0
        self._begin_s = self._line_s = time.monotonic()

    def begin(self, total: int) -> None:
        """Take note of how many logs there are."""
        self._total, self._count = total, Count("fleet", total)
        self._count.__enter__()

    def step(self, outcome: Outcome) -> None:
        """Take note of a log that ended."""
        self._ended += 1
        self._failed += not outcome.is_done
        self._quick += outcome.present or bool(
            outcome.unmatched
        )  # their time is no measure of what others take
        if self._count is not None:
            self._count.step(outcome.name)
        now_s = time.monotonic()
        if now_s - self._line_s >= LINE_EVERY_S and not sys.stderr.isatty():
            self._line_s = now_s
            print(self._line(now_s), file=sys.stderr, flush=True)

    def _line(self, now_s: float) -> str:
        line = f"{self._ended:,} of {self._total:,} logs, {self._failed:,} failed"
        worked = self._ended - self._quick
        if worked:
            left_s = (now_s - self._begin_s) / worked * (self._total - self._ended)
            line += f", about {left_s / 60:,.0f} min left"
        return line

    def __enter__(self) -> FleetProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._count is not None:
            self._count.__exit__(kind, error, trace)
        if kind is KeyboardInterrupt and self._total:
            kept = f"{self._ended:,} of {self._total:,} logs are done and kept"
            print(f"{kept}: the same command with --resume does the rest", file=sys.stderr)
