"""Refuses samples that jump further than the vehicle can: forged frames, broken sensors.

A sample is compared with the last one that was accepted. The longer ago that was, the more it may differ,
so a value that has really changed (a locked wheel, a sensor that was replaced) is accepted again after a
while, and no forged start value keeps the truth out for long. Refused samples never reach the grid; while
they come, the gate `implausible` is closed, since forged ones that do not jump cannot be found.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from canest.core.columns import shifted
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.vehicle.torque_dropout import TorqueDropoutCheck

Samples = dict[str, tuple[IntColumn, FloatColumn]]

#: no road vehicle accelerates harder than its tyres hold
MAX_ACCEL_MPS2 = 12.0
#: nor is it faster; a first value has nothing else to be judged by
MAX_SPEED_MPS = 150.0
#: slower than this the vehicle stands: speed sensors give no pulses below
STANDSTILL_MPS = 0.2
#: two speeds of one vehicle may differ by noise, rounding to a mile per hour and timing
SPEED_SLACK_MPS = 1.5
#: channels that are 1 for `JUMP_HOLD_S` after a sample was refused, any one or one of the motion
JUMP, MOTION_JUMP = "implausible_jump", "implausible_motion"
JUMP_HOLD_S = 1.0
_FEW = 50  #: samples of one role up to which walking them is faster than columns (both give the same bits)
_AFTER_JUMP = 50  #: samples that are walked from a jump on before columns are tried again


class Limit(NamedTuple):
    """A signal may differ by ``slack`` at once and by ``rate`` more per second, its size has bounds."""

    slack: float
    rate: float
    most: float = math.inf
    least: float = 0.0


#: finest first; engine speed through the gear is finer than a road speed in half miles per hour
SPEED_ORDER = ("output_shaft_speed", "undriven_speed", "engine_speed", "vehicle_speed", "gps_speed")

#: in the units of `canest.core.roles`
_ROAD_SPEED = Limit(SPEED_SLACK_MPS, MAX_ACCEL_MPS2, MAX_SPEED_MPS)
LIMITS: dict[str, Limit] = {
    "vehicle_speed": _ROAD_SPEED,
    "undriven_speed": _ROAD_SPEED,
    "gps_speed": _ROAD_SPEED,
    # friction follows engine speed and oil temperature, with steps when an auxiliary cuts in
    "engine_friction_pct": Limit(5.0, 15.0),
    # the full scale of the reported torque is a constant of the engine, but for another rating: that is sent
    # every 5 s and accepted the second or third time. A controller that has just woken may send 0
    "reference_torque": Limit(5.0, 50.0, most=20_000.0, least=50.0),
    "retarder_reference_torque": Limit(5.0, 50.0, most=20_000.0),
    # one stage of an engine brake acts within 0.1 s, and one is at most half of them
    "retarder_torque_pct": Limit(60.0, 300.0, 125.0),
    # a mountain road changes the pressure by 0.05 kPa/s; faster, so that a replaced sensor is accepted
    "barometric_pressure": Limit(2.0, 2.0),
    "ambient_temperature": Limit(3.0, 2.0),
    # rough roads shake the sensor; a vehicle's own acceleration builds up at some 10 m/s3
    "longitudinal_accel": Limit(4.0, 40.0, 50.0),
}


def limits_of(roles: Iterable[str], mps_per_shaft_rpm: float) -> dict[str, Limit]:
    """Return the limits of the roles that have one; ``mps_per_shaft_rpm`` scales the output shaft's."""
    per_rpm = mps_per_shaft_rpm
    shaft = Limit(*(limit / per_rpm for limit in (SPEED_SLACK_MPS, MAX_ACCEL_MPS2, MAX_SPEED_MPS)))
    every = {**LIMITS, "output_shaft_speed": shaft}
    return {role: every[role] for role in roles if role in every}


class RangeRateCheck:
    """Carries the last accepted sample of every limited role; counts what it refused, per role.

    limits: role -> Limit. motion: roles that the accelerometer is compared with, or the sensor itself.
    torques: role -> `TorqueDropoutCheck`; what that refuses closes no gate, the torque before it holds.
    """

    def __init__(
        self,
        limits: Mapping[str, Limit],
        motion: Collection[str] = (),
        torques: Mapping[str, TorqueDropoutCheck] | None = None,
    ) -> None:
        self._limits, self._motion, self._torques = limits, motion, torques or {}
        self._accepted: dict[str, tuple[int, float]] = {}
        self.refused: Counter[str] = Counter()

    def restart(self) -> None:
        """Forget the last samples: the clock was set back, their stamps mean nothing any more."""
        self._accepted.clear()
        for torque in self._torques.values():
            torque.restart()

    def apply(self, samples: Mapping[str, tuple[IntColumn, FloatColumn]]) -> Samples:
        """Return the samples without the refused ones, and when those came as further roles (`JUMP`)."""
        kept = dict(samples)
        jumps: list[tuple[str, IntColumn]] = []
        for role, torque in self._torques.items():
            if role in kept:
                self._keep(kept, role, torque.refused(*kept[role]))
        for role, limit in self._limits.items():
            if role in kept:
                t_us, values = kept[role]
                refused = self._refused(role, limit, t_us, values)
                if refused is not None:
                    self._keep(kept, role, refused)
                    jumps.append((role, t_us[refused]))
        for name, stamps in (
            (JUMP, [t for _, t in jumps]),
            (MOTION_JUMP, [t for role, t in jumps if role in self._motion]),
        ):
            if stamps:
                t_us = np.sort(np.concatenate(stamps))
                kept[name] = t_us, np.ones(len(t_us))
        return kept

    def _keep(self, kept: Samples, role: str, refused: BoolColumn | None) -> None:
        """Take the refused samples (n,) out of a role's, and count them; None: there are none."""
        if refused is not None:
            t_us, values = kept[role]
            kept[role] = t_us[~refused], values[~refused]
            self.refused[role] += int(np.count_nonzero(refused))

    def _refused(self, role: str, limit: Limit, t_us: IntColumn, values: FloatColumn) -> BoolColumn | None:
        """Return which samples jump (n,), None when none does; "not available" never does."""
        if len(values) <= _FEW:
            jumps = self._walk(role, limit, t_us.tolist(), values.tolist())
        else:
            rows = np.flatnonzero(np.isfinite(values))
            jumps = self._far(role, limit, t_us[rows], values[rows])
            jumps = rows[jumps].tolist() if jumps else []
        if not jumps:
            return None
        refused = np.zeros(len(values), np.bool_)
        refused[jumps] = True
        return refused

    def _far(self, role: str, limit: Limit, t_us: IntColumn, values: FloatColumn) -> list[int]:
        """Return the positions of finite samples that jump: in columns, but for some samples after a jump."""
        if not len(values):
            return []
        before_us, before = self._accepted.get(role, (int(t_us[0]), float(values[0])))
        steps = values - shifted(values, before)
        allowed = limit.slack + limit.rate * 1e-6 * (t_us - shifted(t_us, before_us))
        size = np.abs(values)
        far = (np.abs(steps) > allowed) | (size > limit.most) | (size < limit.least)
        jumps: list[int] = []
        begin, end = 0, len(far)
        while begin < end:
            first = begin + int(far[begin:].argmax()) if far[begin:].any() else end
            if first > begin:
                self._accepted[role] = int(t_us[first - 1]), float(values[first - 1])
            begin = min(first + _AFTER_JUMP, end)
            walked = self._walk(role, limit, t_us[first:begin].tolist(), values[first:begin].tolist())
            jumps += [first + i for i in walked]
            if begin < end and jumps[-1:] == [begin - 1]:  # the next one's step is from a refused sample
                far[begin] = True
        return jumps

    def _walk(self, role: str, limit: Limit, stamps: list[int], values: list[float]) -> list[int]:
        """Return the positions of samples that jump, each compared with the last accepted one."""
        slack, rate = limit.slack, limit.rate * 1e-6
        before_us, before = self._accepted.get(role, (0, math.nan))
        jumps = []
        for i, (stamp, value) in enumerate(zip(stamps, values, strict=True)):
            if not -math.inf < value < math.inf:
                continue
            possible = limit.least <= abs(value) <= limit.most
            if not possible or abs(value - before) > slack + rate * (stamp - before_us):
                jumps.append(i)
            else:
                before_us, before = stamp, value
        if before == before:  # noqa: PLR0124 - NaN alone is not equal to itself
            self._accepted[role] = before_us, before
        return jumps
