"""Which gear is engaged, and its ratio: as the transmission sends it, from the table, or from two speeds."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from canest.core.columns import constant, shifted
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import STEP_S
from canest.vehicle.facts import NOTHING_ENGAGED, Vehicle

#: a shaft slower than this gives no ratio, rpm
MIN_SHAFT_RPM = 50.0
#: a gear ratio found from shaft speeds is snapped to a table entry this close, relative
RATIO_SNAP = 0.05


class GearRatio:
    """A vehicle's table of gears."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._rpm_per_mps = 1.0 / vehicle.mps_per_shaft_rpm
        self._gears = np.array(sorted(vehicle.gear_ratios), np.float64)
        self._ratios = np.array([vehicle.gear_ratios[int(g)] for g in self._gears], np.float64)
        forwards = self._gears > 0 if (self._gears > 0).any() else self._gears != 0
        self._forwards, self._ratios_forwards = self._gears[forwards], self._ratios[forwards]
        self._last = math.nan

    def of(self, values: Mapping[str, FloatColumn], n: int) -> tuple[FloatColumn, FloatColumn]:
        """Return transmission ratio and gear number: from ETC2, else the gear table, else shaft speeds."""
        ratio, gear = values.get("gear_ratio"), values.get("gear")
        if not len(self._gears):
            known = constant(1.0, n) if ratio is None else ratio
            return known, constant(0.0, n) if gear is None else gear
        if len(self._gears) == 1 and ratio is None and gear is None:
            return constant(float(self._ratios[0]), n), constant(float(self._gears[0]), n)
        if gear is not None:
            table = self._by_table(gear)
            ratio = table if ratio is None else np.where(ratio > 0, ratio, table)
        if ratio is None:
            ratio = self._by_shafts(values, n)
        elif np.count_nonzero(unknown := np.isnan(ratio)):
            if gear is not None:  # the gear is known: nothing is engaged
                unknown = unknown & ~np.isin(gear, NOTHING_ENGAGED)
            ratio = np.where(unknown, self._by_shafts(values, n), ratio)
        if gear is None:
            nearest = self._nearest(np.where(ratio > 0, ratio, 1.0))
            gear = np.where(ratio > 0, self._forwards[nearest], 0.0)
        return ratio, gear

    @property
    def has_steps(self) -> bool:
        """Whether there is a table of gears."""
        return len(self._gears) > 0

    def gained(self, ratio: FloatColumn, engine_radps: FloatColumn, continues: bool) -> FloatColumn:
        """Return what a transmission without steps accelerates the engine beyond the vehicle, rad/s2 (n,).

        Zero where that is unknown, and where the ratio changes by more than `RATIO_SNAP` at once.
        """
        change = ratio - shifted(ratio, self._last if continues else math.nan)
        self._last = float(ratio[-1])
        glides = np.abs(change) < RATIO_SNAP * ratio
        gained = engine_radps * (np.where(glides, change, 0.0) / np.where(glides, ratio, 1.0) / STEP_S)
        return np.where(np.isfinite(gained), gained, 0.0)

    def _by_table(self, gear: FloatColumn) -> FloatColumn:
        at = np.minimum(np.searchsorted(self._gears, gear), len(self._gears) - 1)
        return np.where(self._gears[at] == gear, self._ratios[at], np.nan)

    def _by_shafts(self, values: Mapping[str, FloatColumn], n: int) -> FloatColumn:
        engine, shaft = values.get("engine_speed"), values.get("output_shaft_speed")
        if "vehicle_speed" in values:  # as the road turns it
            by_road = values["vehicle_speed"] * self._rpm_per_mps
            shaft = by_road if shaft is None else np.where(np.isnan(shaft), by_road, shaft)
        if engine is None or shaft is None:
            return constant(math.nan, n)
        turning = (shaft > MIN_SHAFT_RPM) & (engine > MIN_SHAFT_RPM)
        measured = np.where(turning, engine, 1.0) / np.where(turning, shaft, 1.0)
        table = self._ratios_forwards[self._nearest(measured)]
        return np.where(turning & (np.abs(measured / table - 1) < RATIO_SNAP), table, np.nan)

    def _nearest(self, ratio: FloatColumn) -> IntColumn:
        """Return the positions of forward gears: ratios do not show the direction of travel."""
        nearest: IntColumn = np.abs(np.log(ratio)[:, None] - np.log(self._ratios_forwards)).argmin(1)
        return nearest
