"""How far speeds of the bus contradict the declared gearing and wheel radius.

v = omega r / i: the speed that the shaft or, through the gear, the engine gives is that of the road where
ratio and radius are right. Where neither is there, the speed counted at the wheels (SPN 84) is compared.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.samples import RATE_HZ, STEP_US
from canest.grid.grid import GridBlock
from canest.vehicle.driveline_state import geared_speed
from canest.vehicle.model import LongitudinalModel, RawModel
from canest.vehicle.range_rate_check import MAX_SPEED_MPS
from canest.vehicle.role_sources import DRIVEN_SPEEDS
from canest.vehicle.spec import ModelSpec

#: speeds of one vehicle that differ by less are worn tyres, slip and rounding
SPEED_TOLERANCE = 0.03
#: the mean of so many comparisons, one every 0.2 s, and of no fewer than these
_MEAN_OF, _FEWEST, _EVERY_TICKS = 100, 10, round(0.2 * RATE_HZ)
#: slower, a rounded speed says little; harder accelerated, one that is late differs by that, m/s and m/s2
_LEAST_MPS, _MOST_MPS2 = 8.0, 0.5
_ROAD = ("undriven_speed", "vehicle_speed", "gps_speed")


class LeverCheck:
    """Carries the mean ratio of road and shaft speed, and the standard deviation that follows from it."""

    def __init__(self, spec: ModelSpec, model: LongitudinalModel) -> None:
        geared = [role for role in DRIVEN_SPEEDS if role != "engine_speed" or not model.at_wheels]
        self._model = model
        self._turned = next((role for role in geared if role in spec.roles), "")
        self._road = [role for role in _ROAD if role in spec.roles and role != self._turned]
        self._count, self._mean, self._std = 0, 0.0, 0.0

    def std(
        self, ticks: GridBlock, raw: RawModel, gate: NDArray[np.uint8], accel_mps2: FloatColumn
    ) -> FloatColumn | None:
        """Return the std of ratio and radius that speeds leave, as a share (n,); None if none can tell."""
        if not (self._turned and self._road):
            return None
        asked = np.flatnonzero(ticks.t_us // STEP_US % _EVERY_TICKS == 0)
        if not len(asked):
            return np.full(len(ticks), self._std)
        road, turned = self._road_speed(raw)[asked], self._turned_speed(raw)[asked]
        fit = (gate[asked] == 0) & (np.abs(accel_mps2[asked]) <= _MOST_MPS2)
        for speed in (road, turned):
            fit &= (speed >= _LEAST_MPS) & (speed <= MAX_SPEED_MPS)
        known = [self._std]
        for ratio in (road[fit] / turned[fit]).tolist():
            self._add(math.log(ratio))
            known.append(self._std)
        return np.repeat(known, np.diff(asked[fit], prepend=0, append=len(ticks)))

    def _road_speed(self, raw: RawModel) -> FloatColumn:
        """Return the speed of the road, m/s (n,), NaN where none is known."""
        speed = np.full(len(raw.columns), math.nan)
        for role in self._road:
            speed = np.where(np.isnan(speed), self._model.speed_of(role, raw.columns), speed)
        return speed

    def _turned_speed(self, raw: RawModel) -> FloatColumn:
        """Return the speed of the driven wheels, m/s (n,), NaN where it is not known."""
        if self._turned == "engine_speed":  # also where the road contradicts it
            return geared_speed(raw.columns)
        return self._model.speed_of(self._turned, raw.columns)

    def _add(self, share: float) -> None:
        self._count = min(self._count + 1, _MEAN_OF)
        self._mean += (share - self._mean) / self._count
        if self._count >= _FEWEST:
            self._std = math.sqrt(max(self._mean * self._mean - SPEED_TOLERANCE * SPEED_TOLERANCE, 0.0))
