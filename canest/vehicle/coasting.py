"""Where a vehicle coasts: its driveline is open, and nothing but air, tyres and the slope acts on it.

A vehicle out of gear rolls as steep as the road is, whatever it weighs. Every shift of an automated gearbox
is such a moment, of half a second or so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.columns import constant
from canest.frames import BoolColumn
from canest.gates import Gate
from canest.grid.grid import GridBlock
from canest.vehicle.model import RawModel

#: gates that an open driveline closes by itself
PARTED_BY = (Gate.SHIFT, Gate.DRIVELINE)
_ENGAGED = "driveline_engaged"
_NEVER = -(1 << 62)


class Coasting:
    """Carries when the driveline was last closed, when the vehicle last stood and what else acts on it."""

    def __init__(self, standstill_mps: float) -> None:
        self._standstill_mps = standstill_mps
        self._closed_tick = self._stood_tick = self._acts_until_tick = _NEVER

    def of(
        self, grid: GridBlock, raw: RawModel, tick: NDArray[np.int64], acts_until: NDArray[np.int64]
    ) -> BoolColumn:
        """Return where the vehicle coasts (n,).

        acts_until: until which tick something else acts on it, or has left its traces, by each tick's causes.
        Before it has been closed since the last stop, an open driveline is a clutch that slips in a launch.
        """
        engaged = grid.values.get(_ENGAGED)
        if engaged is None:
            return constant(False, len(grid))
        if not grid.continues:
            self._closed_tick = self._stood_tick = self._acts_until_tick = _NEVER
        closed_at = np.where(engaged >= 0.5, tick, _NEVER)
        stood_at = np.where(raw.speed_mps > self._standstill_mps, _NEVER, tick)  # also where nobody knows
        closed_at[0] = max(closed_at[0], self._closed_tick)
        stood_at[0] = max(stood_at[0], self._stood_tick)
        until = acts_until.copy()
        until[0] = max(until[0], self._acts_until_tick)
        if len(tick) > 1:
            closed_at, stood_at, until = (np.maximum.accumulate(x) for x in (closed_at, stood_at, until))
        self._closed_tick, self._stood_tick = int(closed_at[-1]), int(stood_at[-1])
        self._acts_until_tick = int(until[-1])
        coasting: BoolColumn = (engaged < 0.5) & (closed_at > stood_at) & (tick >= until)
        return coasting
