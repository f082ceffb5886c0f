"""Refuses torque samples that no engine gives: readings of zero between others, and a type's maximum.

A real torque hole (a shift, a pedal let go) lasts: torque has to come down, to stay, and to build up again,
which takes an engine half a second and more. A sample that reads exactly zero while the last one was far
from it, and is followed within `DROPOUT_US` by one near that last one, is a dropout of the sensor, its
message or its logger. From the first such zero alone the two look the same, and to wait would delay
every real hole. So a signal is accepted until it has shown `CONFIRMED` dropouts within `CONFIRMED_US`. From
then on a zero that follows a torque far from it counts only once it has been repeated, or has lasted.
Meanwhile the torque before it holds. A signal without dropouts is thus never touched, and one report in
thousands that reads zero does no harm.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from canest.core.columns import shifted
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.vehicle.facts import Vehicle

#: a dropout is at most so many reports long, and its neighbours lie at most so far apart
DROPOUT_REPORTS, DROPOUT_US = 3, 450_000
#: so many dropouts within so long confirm that a signal has them
CONFIRMED, CONFIRMED_US = 2, 60_000_000
#: the torques before and after a dropout differ by this share of the smaller at most
_ALIKE = 0.5
#: nearer to zero no dropout bends a mass: percent of the reference torque, or what pushes the empty vehicle
_FAR_PCT, _FAR_MPS2 = 5.0, 0.1
_FAR_STEPS = 3.0  #: nor one of so many steps of a coarse signal, which may be a torque
#: SPN 513 ends at 125 % (raw 0xFA), and no engine exceeds the 100 % that is the most of all its ratings
_MOST_PCT = 124.0
#: engines give less, N m; torques of wheels push the full vehicle harder than tyres hold at this, m/s2
_MOST_ENGINE_NM, _MOST_MPS2 = 20_000.0, 24.0
#: what 16-bit integers end at: a table that holds one has copied "no value"
_TYPE_ENDS = (32767.0, -32768.0, 65535.0)
_ENGINE = ("engine_torque_pct", "engine_torque")
_WHEELS = ("wheel_force", "wheel_torque", "half_shaft_torque_left", "half_shaft_torque_right")
LIMITED = (*_ENGINE, *_WHEELS)  #: roles whose samples are looked at
_FEW = 50  #: samples up to which walking them is faster than columns (both give the same bits)


class TorqueDropoutCheck:
    """Carries what one torque signal last read, and its latest dropouts.

    far: torques up to this are near zero. most: no torque is larger. ends: values that mean "no value".
    All in the unit of the role.
    """

    def __init__(self, far: float, most: float = math.inf, ends: Collection[float] = ()) -> None:
        self._far, self._most, self._ends = far, most, frozenset(ends)
        self.restart()

    def restart(self) -> None:
        """Forget the last samples: the clock was set back, their stamps mean nothing any more."""
        self._before_us, self._before = 0, 0.0
        self._zeros = 0  #: reports of zero since, not yet accepted as a torque
        self._dropouts: deque[int] = deque(maxlen=CONFIRMED)

    def refused(self, t_us: IntColumn, values: FloatColumn) -> BoolColumn | None:
        """Return which samples are no torque (n,), None when all are; "not available" stays as it is."""
        if len(values) > _FEW:
            known = np.flatnonzero(np.isfinite(values))
            first = self._first_odd(values[known])
            if first:
                last = int(known[first - 1])
                self._before_us, self._before, self._zeros = int(t_us[last]), float(values[last]), 0
            if first == len(known):
                return None
            begin = int(known[first])
        else:
            begin = 0
        rows = self._walk(t_us[begin:].tolist(), values[begin:].tolist())
        if not rows:
            return None
        refused = np.zeros(len(values), np.bool_)
        refused[[begin + row for row in rows]] = True
        return refused

    def _first_odd(self, values: FloatColumn) -> int:
        """Return how many finite samples pass before one that has to be looked at by itself."""
        if self._zeros:
            return 0
        if not len(values):
            return 0
        odd = (values == 0.0) & (np.abs(shifted(values, self._before)) > self._far)
        odd = odd | (np.abs(values) > self._most)
        for end in self._ends:
            odd = odd | (values == end)
        return int(odd.argmax()) if odd.any() else len(values)

    def _walk(self, stamps: list[int], values: list[float]) -> list[int]:
        """Return the positions of samples that are no torque."""
        refused = []
        for row, (stamp, value) in enumerate(zip(stamps, values, strict=True)):
            if not -math.inf < value < math.inf:
                continue
            if abs(value) > self._most or value in self._ends:
                refused.append(row)
            elif value == 0.0 and abs(self._before) > self._far:
                if self._may_be_dropout(stamp):
                    self._zeros += 1
                    if self._confirmed(stamp):
                        refused.append(row)
                else:
                    self._before_us, self._before, self._zeros = stamp, 0.0, 0
            else:
                if self._zeros and self._ends_dropout(stamp, value):
                    self._dropouts.append(stamp)
                self._before_us, self._before, self._zeros = stamp, value, 0
        return refused

    def _may_be_dropout(self, stamp: int) -> bool:
        """Return whether another zero may still belong to a dropout."""
        return self._zeros < DROPOUT_REPORTS and stamp - self._before_us <= DROPOUT_US

    def _ends_dropout(self, stamp: int, value: float) -> bool:
        """Return whether the torque is back where it was before the zeros, sooner than any engine does it."""
        nearer = min(abs(value), abs(self._before))
        alike = abs(value - self._before) <= _ALIKE * nearer
        return nearer > self._far and alike and stamp - self._before_us <= DROPOUT_US

    def _confirmed(self, stamp: int) -> bool:
        """Return whether the signal has had dropouts enough lately."""
        return len(self._dropouts) == CONFIRMED and stamp - self._dropouts[0] <= CONFIRMED_US


class TorqueLimit(NamedTuple):
    """What a torque may read; see `TorqueDropoutCheck`. All in the unit of the role."""

    far: float
    most: float = math.inf
    ends: tuple[float, ...] = ()


def torque_limits(
    roles: Collection[str],
    vehicle: Vehicle,
    scales: Mapping[str, tuple[float, float]],
    steps: Mapping[str, float],
) -> dict[str, TorqueLimit]:
    """Return the limits of every torque role that is mapped.

    scales: role -> factor and offset of the numbers of its table column (none for a DBC signal).
    steps: role -> resolution of its DBC signal. A driver's foot moves a torque by some steps and back.
    """
    ratio = min(vehicle.gear_ratios.values(), default=1.0) * vehicle.final_drive
    limits = {}
    for role in LIMITED:
        if role not in roles:
            continue
        per_mps2 = vehicle.wheel_radius_m / (ratio if role in _ENGINE else 1.0)
        if role == "wheel_force":
            per_mps2 = 1.0
        far = _FAR_MPS2 * vehicle.mass_min_kg * per_mps2
        most = _MOST_MPS2 * vehicle.mass_max_kg * per_mps2
        if role == "engine_torque_pct":
            far, most = _FAR_PCT, _MOST_PCT
        elif role == "engine_torque":
            most = min(most, _MOST_ENGINE_NM)
        factor, offset = scales.get(role, (math.nan, 0.0))
        ends = tuple(end * factor + offset for end in _TYPE_ENDS) if role in scales else ()
        limits[role] = TorqueLimit(max(far, _FAR_STEPS * steps.get(role, 0.0)), most, ends)
    return limits
