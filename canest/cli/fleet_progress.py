"""How far a run over thousands of logs is: a bar on a terminal, a line now and then in a file."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from canest.cli.progress import COMPILING, Count

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from canest.fleet.job import Outcome

#: from line to line, where standard error is no terminal
LINE_EVERY_S = 60.0


class FleetProgress:
    """Shows how many logs are done and how long the rest will take; a context manager."""

    def __init__(self) -> None:
        self._count: Count | None = None
        self._work: Mapping[str, float] = {}
        self._done = self._present = self._failed = self._unmatched = 0
        self._worked = self._left = 0.0
        self._begin_s = self._line_s = time.monotonic()

    def begin(self, work: Mapping[str, float]) -> None:
        """Take note of the logs, and how much work each is."""
        self._work, self._left = work, sum(work.values())
        self._count = Count("fleet", self._left)
        self._count.__enter__()
        self._begin_s = self._line_s = time.monotonic()

    def compiling(self) -> None:
        """Say why nothing happens at first."""
        print(COMPILING, file=sys.stderr, flush=True)

    def step(self, outcome: Outcome) -> None:
        """Take note of a log that ended."""
        work = self._work.get(outcome.name, 0.0)
        self._left -= work
        if outcome.unmatched:
            self._unmatched += 1
        elif outcome.error:
            self._failed += 1
        elif outcome.present:
            self._present += 1
        else:
            self._done += 1
        if not (outcome.present or outcome.unmatched):  # their time is no measure of what others take
            self._worked += work
        if self._count is not None:
            self._count.step(self._counts(), work)
        now_s = time.monotonic()
        if now_s - self._line_s >= LINE_EVERY_S and not sys.stderr.isatty():
            self._line_s = now_s
            print(self._counts() + self._time_left(now_s), file=sys.stderr, flush=True)

    def _counts(self) -> str:
        ended = self._done + self._present + self._failed + self._unmatched
        kinds = {
            "done": self._done, "there before": self._present, "failed": self._failed,
            "without a rule": self._unmatched,
        }  # fmt: skip
        counts = ", ".join(f"{number:,} {kind}" for kind, number in kinds.items() if number)
        return f"{ended:,} of {len(self._work):,} logs: {counts}"

    def _time_left(self, now_s: float) -> str:
        if not self._worked:
            return ""
        left_s = (now_s - self._begin_s) / self._worked * self._left
        return f"; about {left_s / 60:,.0f} min left" if left_s >= 90 else f"; about {left_s:,.0f} s left"

    def __enter__(self) -> FleetProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._count is not None:
            self._count.__exit__(kind, error, trace)
        if kind is KeyboardInterrupt and self._work:
            kept = f"{self._done + self._present:,} of {len(self._work):,} logs are done and kept"
            print(f"{kept}: the same command with --resume does the rest", file=sys.stderr)
