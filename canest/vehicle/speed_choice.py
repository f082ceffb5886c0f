"""Which of several signals gives the speed.

No two speeds of a vehicle agree: tyres wear and slip, sensors round. Where one takes over from another, the
step between them is no acceleration, though 0.1 m/s in a tick looks like 5 m/s2: a sender that comes and goes
would teach a wrong mass by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from canest.core.columns import shifted
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import RATE_HZ, STEP_US
from canest.grid.grid import GridBlock

#: a speed that was lost has to be there for so long before it is taken again, s
BACK_S = 1.0
#: a step of this size is none, m/s: 1/256 km/h of wheels and 1/8 rpm of shafts are finer
NO_STEP_MPS = 0.01
_NEVER = -(1 << 62)
_NONE = -1


class SpeedChoice:
    """Carries which speed was taken last, and when each one was lost.

    Taken is the finest that has not been lost lately, else the finest that is there. The engine's is lost in
    every shift: then a gate is closed, and it is taken again as soon as there is a gear.

    roles: of the speeds, the finest first.
    """

    def __init__(self, roles: Sequence[str]) -> None:
        self._roles = roles
        self._finest = len(roles)
        self._begin()

    def _begin(self) -> None:
        self._taken, self._last_mps = _NONE, np.nan
        self._received = [False] * len(self._roles)
        self._lost_tick = [_NEVER] * len(self._roles)

    def choose(
        self, candidates: Sequence[Callable[[], FloatColumn]], ticks: GridBlock
    ) -> tuple[FloatColumn, IntColumn, IntColumn]:
        """Return the speed, NaN where none is there or another one steps in, and which one it is, both (n,).

        Third comes the finest that has ever been received (n,): one that is mapped and never sent is none.

        candidates: give the speed (n,) of each role, NaN where it is unknown, or the engine's does not count.
        """
        if not ticks.continues:
            self._begin()
        tick = ticks.t_us // STEP_US
        speeds = [candidates[0]()]
        reliable = [self._reliable(0, ~np.isnan(speeds[0]), tick)]
        usual = self._taken == 0 and np.count_nonzero(reliable[0]) == len(tick)
        for k, role in enumerate(self._roles[1:], 1):
            if usual and role == "engine_speed":  # has no past
                continue
            speeds.append(candidates[k]())
            reliable.append(self._reliable(k, ~np.isnan(speeds[-1]), tick))
        if usual:
            self._last_mps = float(speeds[0][-1])
            self._finest = 0
            first = np.zeros(len(tick), np.int64)
            return speeds[0], first, first
        there = [~np.isnan(speed) for speed in speeds]
        finest = np.full(len(tick), self._finest)
        for k, column in enumerate(there):
            finest = np.where(np.logical_or.accumulate(column), np.minimum(finest, k), finest)
        self._finest = int(finest[-1])
        taken = np.full(len(tick), _NONE)
        speed = np.full(len(tick), np.nan)
        for k, column in (*enumerate(reliable), *enumerate(there)):
            here = column & (taken == _NONE)
            taken[here] = k
            speed[here] = speeds[k][here]
        before = shifted(taken, self._taken)
        steps = np.abs(speed - shifted(speed, self._last_mps)) > NO_STEP_MPS
        self._taken, self._last_mps = int(taken[-1]), float(speed[-1])
        takes_over = steps & (taken != before) & (taken != _NONE) & (before != _NONE)
        if "engine_speed" in self._roles:
            engine = self._roles.index("engine_speed")
            takes_over &= (taken != engine) & (before != engine)
        speed[takes_over] = np.nan
        return speed, taken, finest

    def _reliable(self, k: int, there: BoolColumn, tick: IntColumn) -> BoolColumn:
        """Return where a speed is there and has been for a while, or always (n,)."""
        if self._roles[k] == "engine_speed":
            return there
        if self._received[k] and np.count_nonzero(there) == len(there):
            return there & (tick - self._lost_tick[k] > BACK_S * RATE_HZ)
        received = np.logical_or.accumulate(there) | self._received[k]
        lost = np.maximum.accumulate(np.where(received & ~there, tick, self._lost_tick[k]))
        self._received[k], self._lost_tick[k] = bool(received[-1]), int(lost[-1])
        return there & (tick - lost > BACK_S * RATE_HZ)
