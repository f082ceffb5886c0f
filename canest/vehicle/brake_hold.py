"""Holds the last value of a brake signal that is lost while the brake acts, then releases it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import RATE_HZ, STEP_US
from canest.grid.grid import GridBlock
from canest.vehicle.spec import ModelSpec

#: for so long, s, a lost brake signal holds its last value
HOLD_S = 60.0
_NEVER = -(1 << 62)


class BrakeHold:
    """Carries the last known value of every brake and retarder; repeats it where it is lost while it acts."""

    def __init__(self, spec: ModelSpec) -> None:
        gates = spec.gates
        levels = {
            "brake_switch": 0.5,
            "parking_brake": 0.5,
            "abs_active": 0.5,
            "brake_pedal": gates.brake.pedal_pct,
            "retarder_torque_pct": gates.retarder.torque_pct,
        }
        self._levels = {role: level for role, level in levels.items() if role in spec.roles}
        self._last = dict.fromkeys(self._levels, (_NEVER, 0.0))

    def fill(self, ticks: GridBlock) -> GridBlock:
        """Return the ticks with what is lost and acts filled in."""
        filled = {}
        tick = ticks.t_us // STEP_US
        for role, level in self._levels.items():
            values = ticks.values[role]
            last_tick, last = self._last[role]
            if last_tick > tick[0]:  # the clock was set back
                self._last[role] = int(tick[0]), last
            known = np.flatnonzero(np.isfinite(values))
            if len(known) < len(values):
                filled[role] = self._filled(role, level, tick, values)
            if len(known):
                self._last[role] = int(tick[known[-1]]), float(values[known[-1]])
        return replace(ticks, values={**ticks.values, **filled}) if filled else ticks

    def _filled(self, role: str, level: float, tick: IntColumn, values: FloatColumn) -> FloatColumn:
        last_tick, last = self._last[role]
        at = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
        before = np.where(at >= 0, values[at], last)
        lost = tick - np.where(at >= 0, tick[at], last_tick)
        acts = (np.abs(before) > level) & (lost <= HOLD_S * RATE_HZ)
        return np.where(acts, before, values)
