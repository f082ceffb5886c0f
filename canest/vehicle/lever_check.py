"""How far speeds of the bus contradict the declared gearing and wheel radius.

v = omega r / i: the speed that the shaft or, through the gear, the engine gives is that of the road where
ratio and radius are right. Where neither is there, the speed counted at the wheels (SPN 84) is compared.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.roles import RADPS_PER_RPM
from canest.core.samples import RATE_HZ, STEP_US
from canest.grid.grid import GridBlock
from canest.vehicle.model import LongitudinalModel, RawModel
from canest.vehicle.range_rate_check import MAX_SPEED_MPS
from canest.vehicle.spec import ModelSpec

#: speeds of one vehicle that differ by less are worn tyres, slip and rounding
TOLERANCE = 0.03
#: the mean of so many comparisons, one every 0.2 s, and of no fewer than these
MEAN_OF, FEWEST, _EVERY_TICKS = 100, 10, round(0.2 * RATE_HZ)
#: slower, a rounded speed says little; harder accelerated, one that is late differs by that, m/s and m/s2
LEAST_MPS, MOST_MPS2 = 8.0, 0.5
_SHAFT, _WHEELS = "output_shaft_speed", "vehicle_speed"
_ROAD = ("undriven_speed", _WHEELS, "gps_speed")


class LeverCheck:
    """Carries the mean ratio of road and shaft speed, and the standard deviation that follows from it."""

    def __init__(self, spec: ModelSpec, model: LongitudinalModel) -> None:
        roles = frozenset(spec.roles)
        engine = "engine_speed" in roles and not model.at_wheels
        self._turned = _SHAFT if _SHAFT in roles else "engine_speed" if engine else _WHEELS
        self._road = [role for role in _ROAD if role in roles and role != self._turned]
        self._possible = bool(self._road) and self._turned in roles
        self._per_rpm = RADPS_PER_RPM / spec.vehicle.final_drive
        self._declared_m = spec.vehicle.wheel_radius_m
        self._count, self._mean, self._std = 0, 0.0, 0.0

    def std(
        self, ticks: GridBlock, raw: RawModel, gate: NDArray[np.uint8], accel_mps2: FloatColumn
    ) -> FloatColumn | None:
        """Return the std of ratio and radius that speeds leave, as a share (n,); None if none can tell."""
        if not self._possible:
            return None
        asked = np.flatnonzero(ticks.t_us // STEP_US % _EVERY_TICKS == 0)
        if not len(asked):
            return np.full(len(ticks), self._std)
        road, turned = self._speeds(ticks, raw, asked)
        fit = (gate[asked] == 0) & (np.abs(accel_mps2[asked]) <= MOST_MPS2)
        for speed in (road, turned):
            fit &= (speed >= LEAST_MPS) & (speed <= MAX_SPEED_MPS)
        known = [self._std]
        for ratio in (road[fit] / turned[fit]).tolist():
            self._add(math.log(ratio))
            known.append(self._std)
        return np.repeat(known, np.diff(asked[fit], prepend=0, append=len(ticks)))

    def _speeds(
        self, ticks: GridBlock, raw: RawModel, asked: NDArray[np.int64]
    ) -> tuple[FloatColumn, FloatColumn]:
        """Return the speeds of the road and of the driven wheels at some ticks, m/s, NaN where unknown."""
        c = raw.columns
        radius_m, ratio = c.radius_m[asked], c.ratio[asked]

        def speed(role: str) -> FloatColumn:
            if role == "engine_speed":
                return np.where(ratio > 0, c.engine_radps[asked] / ratio, math.nan) * radius_m
            held = np.where(ticks.stale[role][asked], math.nan, ticks.values[role][asked])
            if role == _SHAFT:
                return held * (self._per_rpm * radius_m)
            return held * (radius_m / self._declared_m) if role == _WHEELS else held  # as the model takes it

        road = np.full(len(asked), math.nan)
        for role in self._road:
            road = np.where(np.isnan(road), speed(role), road)
        return road, speed(self._turned)

    def _add(self, share: float) -> None:
        self._count = min(self._count + 1, MEAN_OF)
        self._mean += (share - self._mean) / self._count
        if self._count >= FEWEST:
            self._std = math.sqrt(max(self._mean * self._mean - TOLERANCE * TOLERANCE, 0.0))
