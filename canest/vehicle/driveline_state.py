"""Whether engine and wheels turn together: what the driveline reports, and what another speed contradicts."""

from __future__ import annotations

import numpy as np

from canest.core.columns import constant
from canest.core.frames import BoolColumn, FloatColumn
from canest.vehicle.facts import Vehicle
from canest.vehicle.working_columns import ModelColumns

#: the engine's speed through the gear and the road's differ by a tyre's size and a message's delay
_MISMATCH_SHARE, _MISMATCH_MPS = 0.15, 0.5
#: a wheel-based speed comes every 100 ms, from pulses that were counted before, s
ROAD_SPEED_LATE_S = 0.25
#: signals that report when the clutch or the converter separates the engine from the wheels
ENGAGED_ROLES = ("driveline_engaged", "lockup_engaged")
CLUTCH_ROLES = (*ENGAGED_ROLES, "clutch_switch", "clutch_slip")


def driveline_open(c: ModelColumns, clutch_slip_pct: float) -> BoolColumn:
    """Return where a signal reports that the engine is separated from the wheels (n,)."""
    found = constant(False, len(c))
    for role in ENGAGED_ROLES:
        if role in c.signals:
            found = found | (c.signals[role] < 0.5)
    if "clutch_switch" in c.signals:
        found = found | c.on("clutch_switch")
    if "clutch_slip" in c.signals:
        found = found | c.on("clutch_slip", clutch_slip_pct)
    return found


class ClutchReports:
    """Carries whether any signal has ever reported the state of the clutch."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._received = vehicle.has_one_gear

    def reported(self, c: ModelColumns) -> BoolColumn:
        """Return where the clutch has been reported by then, or there is one gear and no clutch (n,)."""
        if self._received:
            return constant(True, len(c))
        reported = constant(False, len(c))
        for role in CLUTCH_ROLES:
            if role in c.signals:
                reported = reported | np.isfinite(c.signals[role])
        reported = np.logical_or.accumulate(reported)
        self._received = bool(reported[-1])
        return reported


def geared_speed(c: ModelColumns) -> FloatColumn:
    """Return the speed that the engine's is through the gear and the wheels, m/s (n,), NaN without a gear."""
    geared = c.ratio > 0
    speed: FloatColumn = (
        np.where(geared, c.engine_radps / np.where(geared, c.ratio, 1.0), np.nan) * c.radius_m
    )
    return speed


def road_speed_of_engine(c: ModelColumns, clutch_slip_pct: float) -> FloatColumn:
    """Return the vehicle's speed from the engine's, m/s (n,): NaN where the engine turns by itself.

    At a crossing it idles in gear with its clutch open, and would be a truck that creeps: no stop, and no
    load that may have changed in it.
    """
    speed = geared_speed(c)
    alone = driveline_open(c, clutch_slip_pct) | c.on("shift_in_process")
    road = c.signals.get("vehicle_speed")
    if road is not None:
        contradicted = np.abs(speed - road) > _MISMATCH_SHARE * road + _MISMATCH_MPS
        alone = alone | contradicted | (road == 0.0)
    return np.where(alone, np.nan, speed)
