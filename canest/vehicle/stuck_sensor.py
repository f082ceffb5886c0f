"""An accelerometer that stands still while the vehicle does not: a sensor that repeats itself.

What is the same to the last bit, again and again, while the speed shows that brakes or engine have acted, is
no measurement any more. It is treated as missing until it moves again, and with it all that comes in the
same message. All later stages handle missing values. What else freezes closes the gate
`implausible` or `driveline`.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np

from canest.core.columns import shifted
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.roles import LASTING
from canest.core.samples import RATE_HZ, STEP_US
from canest.grid.grid import GridBlock
from canest.vehicle.range_rate_check import MAX_ACCEL_MPS2, STANDSTILL_MPS
from canest.vehicle.role_sources import speed_in_use
from canest.vehicle.spec import ModelSpec

#: the grid holds a value as long as it may age; one that stands for so many times that is repeated
REPEATED = 3.0
#: an acceleration is the mean over so many ticks, and is compared with that of so many before; until the
#: sensor has stood for both, what the speed shows may be from before
MEAN_TICKS, APART_TICKS = 25, 50
#: no road changes it by more meanwhile, m/s2: engines and brakes do
QUICK_MPS2 = 0.5
#: speeds that are too late, or not tied to the road
_UNSUITABLE_SPEEDS = ("engine_speed", "gps_speed")
_ACCELEROMETER = "longitudinal_accel"


class StuckSensor:
    """Watches the accelerometer by the speed in use; counts the ticks on which it was stuck."""

    def __init__(self, spec: ModelSpec) -> None:
        self.stuck_ticks: Counter[str] = Counter()
        source, self._speed = spec.accelerometer, speed_in_use(spec.roles, spec.vehicle)
        self._watches = source is not None and self._speed not in ("", *_UNSUITABLE_SPEEDS)
        if source is None or not self._watches:
            return
        self._least_ticks = REPEATED * source.stale_s * RATE_HZ
        self._mates = [role for role in source.same_message if role not in LASTING]
        by_shaft = self._speed == "output_shaft_speed"
        self._scale = spec.vehicle.mps_per_shaft_rpm if by_shaft else 1.0  #: m/s per unit of the role
        self._value, self._since_tick = math.nan, 0
        self._past = np.full(MEAN_TICKS + APART_TICKS, np.nan)
        self._quickest = 0.0

    def mask_stuck(self, ticks: GridBlock) -> GridBlock:
        """Return the ticks with a stuck accelerometer, and what comes with it, as stale."""
        if not self._watches:
            return ticks
        stuck = self._stuck(ticks)
        found = int(np.count_nonzero(stuck))
        if not found:
            return ticks
        self.stuck_ticks[_ACCELEROMETER] += found
        values = {role: np.where(stuck, np.nan, ticks.values[role]) for role in self._mates}
        stale = {role: ticks.stale[role] | stuck for role in self._mates}
        return replace(ticks, values={**ticks.values, **values}, stale={**ticks.stale, **stale})

    def _stuck(self, ticks: GridBlock) -> BoolColumn:
        """Return where it has stood for long while the speed has changed quickly (n,)."""
        changes = self._changes(ticks)
        stood = self._stood(ticks)
        settled = stood >= MEAN_TICKS + APART_TICKS
        found = np.zeros(len(ticks), np.bool_)
        edges = np.flatnonzero(settled[1:] != settled[:-1]) + 1
        for begin, end in pairwise([0, *edges.tolist(), len(ticks)]):
            if settled[begin]:
                quickest = np.fmax.accumulate(np.fmax(changes[begin:end], self._quickest))
                self._quickest = float(quickest[-1])
                found[begin:end] = quickest > QUICK_MPS2
            else:  # it moves: what the speed has shown before is void
                self._quickest = 0.0
        return found & (stood >= self._least_ticks)

    def _stood(self, ticks: GridBlock) -> IntColumn:
        """Return for how many ticks it has been the same (n,); keep the last."""
        tick, values = ticks.t_us // STEP_US, ticks.values[_ACCELEROMETER]
        same = values == shifted(values, self._value)
        if not ticks.continues:
            same[0] = False
        began = np.maximum.accumulate(np.where(same, self._since_tick if same[0] else tick[0], tick))
        self._value, self._since_tick = float(values[-1]), int(began[-1])
        stood: IntColumn = tick - began
        return stood

    def _changes(self, ticks: GridBlock) -> FloatColumn:
        """Return by how much the acceleration has changed according to the speed, m/s2 (n,).

        Zero where the vehicle stands: a speed that is late shows the end of the braking after the sensor has.
        """
        if not ticks.continues:
            self._past[:] = np.nan
        speed = np.concatenate((self._past, self._scale * ticks.values[self._speed]))
        self._past = speed[len(ticks) :]
        mean = (speed[MEAN_TICKS:] - speed[:-MEAN_TICKS]) * (RATE_HZ / MEAN_TICKS)
        changes = np.abs(mean[APART_TICKS:] - mean[:-APART_TICKS])
        moves = np.abs(speed[-len(ticks) :]) > STANDSTILL_MPS
        return np.where(moves & (changes <= MAX_ACCEL_MPS2), changes, 0.0)  # beyond it is damage
