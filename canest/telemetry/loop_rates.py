"""Frames per second and CPU time per tick, as means over the last period."""

from __future__ import annotations


class LoopRates:
    """Counts frames and CPU time; `end_period` makes the means of a period available.

    frames: received in the present period; whoever receives them adds to it.
    frames_per_s, cpu_us_per_tick, cpu_us_max: of the last complete period.
    """

    def __init__(self) -> None:
        self.frames_per_s = 0.0
        self.cpu_us_per_tick = 0.0
        self.cpu_us_max = 0.0
        self.frames = self._ticks = self._cpu_ns = self._cpu_max_ns = 0
        self._used_ns: int | None = None
        self._since_s: float | None = None

    def count_tick(self, used_ns: int) -> None:
        """Count one tick; ``used_ns``: CPU time that the thread has used since its start."""
        if self._used_ns is not None:
            cpu_ns = used_ns - self._used_ns
            self._ticks += 1
            self._cpu_ns += cpu_ns
            self._cpu_max_ns = max(self._cpu_max_ns, cpu_ns)
        self._used_ns = used_ns

    def end_period(self, now_s: float) -> None:
        """End the period at ``now_s`` (monotonic)."""
        if self._since_s is not None and now_s > self._since_s and self._ticks:
            self.frames_per_s = self.frames / (now_s - self._since_s)
            self.cpu_us_per_tick = self._cpu_ns * 1e-3 / self._ticks
            self.cpu_us_max = self._cpu_max_ns * 1e-3
        self.frames = self._ticks = self._cpu_ns = self._cpu_max_ns = 0
        self._since_s = now_s
