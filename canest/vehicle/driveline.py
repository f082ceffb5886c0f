"""Whether engine and wheels turn together: what the driveline says, and what another speed denies."""

from __future__ import annotations

import numpy as np

from canest.core.columns import constant
from canest.core.frames import BoolColumn, FloatColumn
from canest.vehicle.facts import Vehicle
from canest.vehicle.working_columns import Columns

#: the engine's speed through the gear and the road's differ by a tyre's size and a message's delay
_MISMATCH_SHARE, _MISMATCH_MPS = 0.15, 0.5
#: a wheel-based speed comes every 100 ms, from pulses that were counted before, s
ROAD_SPEED_LATE_S = 0.25
#: signals that say when the clutch or the converter parts the engine from the wheels
ENGAGED_ROLES = ("driveline_engaged", "lockup_engaged")
CLUTCH_ROLES = (*ENGAGED_ROLES, "clutch_switch", "clutch_slip")


def driveline_open(c: Columns, clutch_slip_pct: float) -> BoolColumn:
    """Return where a signal says that the engine is parted from the wheels (n,)."""
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
    """Carries whether anything has ever told when the engine is parted from the wheels."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._known = vehicle.has_one_gear

    def known(self, c: Columns) -> BoolColumn:
        """Return where one knows it, or has one gear and no clutch (n,)."""
        if self._known:
            return constant(True, len(c))
        told = constant(False, len(c))
        for role in CLUTCH_ROLES:
            if role in c.signals:
                told = told | np.isfinite(c.signals[role])
        told = np.logical_or.accumulate(told)
        self._known = bool(told[-1])
        return told


def road_speed_of_engine(c: Columns, clutch_slip_pct: float) -> FloatColumn:
    """Return the vehicle's speed by the engine's, m/s (n,): NaN where that turns by itself.

    At a crossing it idles in gear with its clutch open, and would be a truck that creeps: no stop, and no
    load that may have changed in it.
    """
    geared = c.ratio > 0
    speed: FloatColumn = (
        np.where(geared, c.engine_radps / np.where(geared, c.ratio, 1.0), np.nan) * c.radius_m
    )
    alone = driveline_open(c, clutch_slip_pct) | c.on("shift_in_process")
    road = c.signals.get("vehicle_speed")
    if road is not None:
        denied = np.abs(speed - road) > _MISMATCH_SHARE * road + _MISMATCH_MPS
        alone = alone | denied | (road == 0.0)
    return np.where(alone, np.nan, speed)
