"""Engine friction between the steps in which it is reported.

SPN 514 comes in steps of 1 % of the reference torque: up to half of one is 2 % of what a light truck needs
on the level, and as it follows engine speed it does not average out. Where it steps it is known to lie
between both values; a line through these points is the friction itself. An engine that moves it for other
reasons than its speed (a fan, its controller) steps at any speed, so no line is found and none is needed:
its steps are their own dither.
"""

from __future__ import annotations

import math

import numpy as np

from canest.core.columns import shifted
from canest.core.frames import FloatColumn

#: cycle of EEC3, ticks: friction stepped somewhere in it, on the average in its middle
_CYCLE = 12
#: steps kept, and how many make a line
_MEMORY, _FEWEST = 20.0, 6
#: scatter of the steps around the line that it may have, in steps; rounding alone would be 0.29
_SCATTER = 0.2


class EngineFriction:
    """Learns friction (any unit) over engine speed from where its reports step, and interpolates between.

    step: resolution of the report. A line counts only as far as the report allows: half a step each way.
    """

    def __init__(self, step: float) -> None:
        self.step = step
        self._seen = 0  # steps so far; of those kept: weight and means,
        self._weight = self._speed = self._level = 0.0
        self._speed2 = self._both = self._level2 = 0.0  # and sums of squares and products around these
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._last = math.nan
        self._speeds: FloatColumn = np.full(_CYCLE, np.nan)

    def between_steps(self, reported: FloatColumn, speed: FloatColumn, continues: bool) -> FloatColumn:
        """Return the friction of ticks (n,) from its reports and the engine's speed, NaN where not reported.

        continues: these ticks follow on those before. The same bits however ticks are cut into blocks.
        """
        if not continues:
            self._begin_anew()
        moved = np.abs(reported - shifted(reported, self._last))
        speeds = np.concatenate((self._speeds, speed))
        found = reported.copy()
        begin = 0
        for k in np.flatnonzero((moved > 0.5 * self.step) & (moved < 1.5 * self.step)).tolist():
            found[begin:k] = self._along(reported[begin:k], speed[begin:k])
            begin = k
            before = self._last if k == 0 else reported[k - 1]
            self._learn(0.5 * (speeds[k] + speeds[k + _CYCLE]), 0.5 * (before + reported[k]))
        found[begin:] = self._along(reported[begin:], speed[begin:])
        self._last, self._speeds = float(reported[-1]), speeds[-_CYCLE:]
        return found

    def _learn(self, speed: float, level: float) -> None:
        """Take one more step into the line, by the moments of those kept (Welford 1962)."""
        if not math.isfinite(speed):
            return
        self._seen += 1
        kept = 1.0 - 1.0 / _MEMORY
        old = kept * self._weight
        self._weight = old + 1.0
        share = old / self._weight
        by_speed, by_level = speed - self._speed, level - self._level
        self._speed += by_speed / self._weight
        self._level += by_level / self._weight
        self._speed2 = kept * self._speed2 + share * by_speed * by_speed
        self._both = kept * self._both + share * by_speed * by_level
        self._level2 = kept * self._level2 + share * by_level * by_level

    def _slope(self) -> float:
        """Return by how much friction grows with speed, NaN where the steps lie on no line."""
        if self._seen < _FEWEST or self._speed2 <= 0.0 or self._both <= 0.0:
            return math.nan
        slope = self._both / self._speed2
        scatter2 = (self._level2 - slope * self._both) / (self._weight - 2.0)  # a line has two freedoms
        return slope if scatter2 < (_SCATTER * self.step) ** 2 else math.nan

    def _along(self, reported: FloatColumn, speed: FloatColumn) -> FloatColumn:
        slope = self._slope()
        if math.isnan(slope) or not len(reported):
            return reported
        line = np.where(np.isfinite(speed), self._level + slope * (speed - self._speed), reported)
        half = 0.5 * self.step
        return np.clip(line, reported - half, reported + half)
