"""Ticks 20 ms apart: an absolute schedule on the monotonic clock, whatever the calendar clock does."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable

from canest.core.samples import STEP_US

STEP_NS = STEP_US * 1000
#: bounds of the lateness histogram, milliseconds; the last bin takes the rest
LATENESS_BOUNDS_MS = (0.1, 0.5, 1.0, 5.0, 20.0)


class Schedule:
    """Waits for a coming tick; ticks that were missed (a long tick, SIGSTOP) are skipped and counted."""

    def __init__(
        self, clock_ns: Callable[[], int] = time.monotonic_ns, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock_ns, self._sleep = clock_ns, sleep
        self._next_ns = clock_ns() + STEP_NS
        self.ticks = 0
        self.missed = 0
        #: how many ticks began later than planned by up to each of `LATENESS_BOUNDS_MS` (last: more)
        self.lateness_counts = [0] * (len(LATENESS_BOUNDS_MS) + 1)

    def ticks_until(self, due_us: int, longest_us: int) -> int:
        """Return the ticks for `wait` to return at ``due_us`` (monotonic), after ``longest_us`` at most."""
        due = -((self._next_ns // 1000 - due_us) // STEP_US) + 1
        return max(1, min(due, longest_us // STEP_US))

    def wait(self, ticks: int = 1) -> int:
        """Sleep until the next tick, or ``ticks`` of them; return the time (monotonic, ns) then."""
        self._next_ns += (ticks - 1) * STEP_NS
        delay_ns = self._next_ns - self._clock_ns()
        if delay_ns > 0:
            self._sleep(delay_ns * 1e-9)
        now_ns = self._clock_ns()
        late_ns = now_ns - self._next_ns
        self.lateness_counts[bisect_left(LATENESS_BOUNDS_MS, late_ns * 1e-6)] += 1
        missed = max(0, late_ns) // STEP_NS
        self.missed += missed
        self.ticks += 1
        self._next_ns += (missed + 1) * STEP_NS
        return now_ns

    def share_within(self, bound_ms: float) -> float:
        """Return the share of ticks that began within one of `LATENESS_BOUNDS_MS` of their time."""
        within = sum(
            n for n, b in zip(self.lateness_counts, LATENESS_BOUNDS_MS, strict=False) if b <= bound_ms
        )
        return within / self.ticks if self.ticks else 1.0
