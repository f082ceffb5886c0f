"""Where a vehicle coasts: its driveline is open, and nothing but air, tyres and the slope acts on it.

A vehicle out of gear rolls as steep as the road is, whatever it weighs. Every shift of an automated gearbox
is such a moment, of half a second or so.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from canest.core.columns import constant
from canest.core.frames import BoolColumn
from canest.core.gates import Gate
from canest.core.roles import BRAKES
from canest.grid.grid import GridBlock
from canest.vehicle.model import RawModel
from canest.vehicle.spec import ModelSpec

#: gates that an open driveline closes by itself
OPEN_DRIVELINE_GATES = (Gate.SHIFT, Gate.DRIVELINE)
_ENGAGED = "driveline_engaged"
_NEVER = -(1 << 62)
#: speeds of one gear apart by this share are not synchronous; gears are three times that apart and more
_TOGETHER = 0.05
#: auxiliaries take no more than this share of the reference torque; a shift no longer than 3 s
_IDLE_SHARE, _SHIFT_TICKS = 0.05, 150


class Coasting:
    """Carries when the driveline was last closed, when the vehicle last stood and what else acts on it."""

    def __init__(self, spec: ModelSpec, *, at_wheels: bool) -> None:
        self._standstill_mps = spec.gates.low_speed.min_mps
        reference = spec.vehicle.reference_torque_Nm
        pedal = ("accelerator",) if spec.gates.brake.assume_when_pedal_released else ()
        self._brakes = (*BRAKES, *pedal)
        self._reference_Nm = math.nan if reference is None else reference
        self._at_wheels = at_wheels
        self._closed_tick = self._stood_tick = self._acts_until_tick = _NEVER

    def of(
        self, grid: GridBlock, raw: RawModel, tick: NDArray[np.int64], acts_until: NDArray[np.int64]
    ) -> BoolColumn:
        """Return where the vehicle coasts (n,).

        acts_until: until which tick something else acts on it, or has left its traces, by each tick's causes.
        An open driveline may be a clutch that slips. So it has to have been closed since the last stop, the
        engine does not turn with the wheels, and it is in a shift, which is soon over, or idles. Brakes
        that no signal reports would be a hill. And a speed that its sender smooths, as wheel-based ones are,
        still shows the pull of the gear before: only the output shaft's counts.
        """
        engaged = grid.values.get(_ENGAGED)
        if engaged is None:
            return constant(False, len(grid))
        if not grid.continues:
            self._closed_tick = self._stood_tick = self._acts_until_tick = _NEVER
        opened = engaged < 0.5
        closed, stood = (
            engaged >= 0.5,
            ~(raw.speed_mps > self._standstill_mps),
        )  # also where no speed is known
        if not np.count_nonzero(opened):  # as a rule
            self._closed_tick = _last(tick, closed, self._closed_tick)
            self._stood_tick = _last(tick, stood, self._stood_tick)
            self._acts_until_tick = max(int(acts_until.max()), self._acts_until_tick)
            return opened
        closed_at, stood_at = (np.where(marked, tick, _NEVER) for marked in (closed, stood))
        until = acts_until.copy()
        for column, before in (
            (closed_at, self._closed_tick),
            (stood_at, self._stood_tick),
            (until, self._acts_until_tick),
        ):
            column[0] = max(column[0], before)
            np.maximum.accumulate(column, out=column)
        self._closed_tick, self._stood_tick = int(closed_at[-1]), int(stood_at[-1])
        self._acts_until_tick = int(until[-1])
        alone = ~_with_wheels(raw) & (self._idles(raw) | _shifts(raw, tick - closed_at))
        alone = alone & self._brakes_reported(raw) & raw.speed_is_shaft
        coasting: BoolColumn = opened & (closed_at > stood_at) & (tick >= until) & alone
        return coasting

    def _brakes_reported(self, raw: RawModel) -> BoolColumn:
        """Return where any signal reports whether the brakes are on (n,)."""
        reported = constant(False, len(raw.columns))
        for role in self._brakes:
            reported = reported | np.isfinite(raw.columns.signal(role, math.nan))
        return reported

    def _idles(self, raw: RawModel) -> BoolColumn:
        """Return where the engine gives no more than its auxiliaries take, as far as known (n,)."""
        c = raw.columns
        if self._at_wheels:  # no signal reports what the crank gives
            return constant(False, len(c))
        reference = c.signal("reference_torque", self._reference_Nm)
        idles: BoolColumn = np.abs(c.torque_Nm) <= _IDLE_SHARE * reference
        return idles


def _last(tick: NDArray[np.int64], marked: BoolColumn, before: int) -> int:
    """Return the last tick that is marked, ``before`` where none is."""
    return int(tick[marked][-1]) if np.count_nonzero(marked) else before


def _shifts(raw: RawModel, open_ticks: NDArray[np.int64]) -> BoolColumn:
    """Return where a shift opens the driveline, for as long as one may take (n,)."""
    shifts: BoolColumn = raw.columns.on("shift_in_process") & (open_ticks <= _SHIFT_TICKS)
    return shifts


def _with_wheels(raw: RawModel) -> BoolColumn:
    """Return where the engine turns as fast as the wheels would turn it in this gear (n,)."""
    c = raw.columns
    turned = raw.speed_mps * c.ratio / c.radius_m
    together: BoolColumn = np.abs(c.engine_radps - turned) <= _TOGETHER * turned
    return together & (c.ratio > 0)
