"""Straight lines through the raw speeds of a vehicle that coasts with its driveline open.

The moment between two gears is too short to be seen in filtered accelerations; a line through the raw speeds
of its half second tells the acceleration to 0.01 m/s2.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S
from canest.estimators.kernel_arrays import pack as give
from canest.estimators.kernel_arrays import state_in, state_out

Container = Any  #: list interpreted, array compiled

#: ticks in which the driveline comes to rest after it has opened, and in which it has closed before it is
#: reported closed
SETTLES, EARLY = 6, 8
#: speeds of a line: fewer tell too little. A speed that is as before is one that was not sent anew
FEWEST = 6.0
#: ticks of a line: after more the slope may be another
LONGEST = 50.0
#: no air and no retarder pulls harder, N; on no road a vehicle rolls faster and faster than this, m/s2
MOST_N, MOST_MPS2 = 1e7, 4.0
#: of the square of a parabola's change of slope one part in so many is in doubt of the line's slope: in 60 by
#: white noise, in 4 where a driveline is not at rest, or the sender smooths the speed
_BENT = 4.0

#: one coasting, per window (NaN where none has ended)
COLUMNS = (
    "coast_mps2",  # acceleration
    "coast_var",  # its variance, (m/s2)2
    "coast_N",  # known forces, mean
    "coast_kg",  # what rotates with the wheels
    "coast_back_s",  # time since its middle
)
#: carried from tick to tick: ticks without a break, whether a line has ended, its sums of x (ticks), v (m/s)
(_UNBROKEN, _ENDED, _COUNT, _X, _X2, _X3, _X4, _V, _XV, _X2V, _V2, _FORCE, _WHEELS) = range(13)
_FIRST_MPS, _FIRST_TICK, _LAST_MPS, _LAST_X = range(13, 17)
_STATES = 17


@jit.kernel
def lines(
    visits: Container, ticks: Container, force: Container, wheels: Container, speed: Container,
    ends: Container, state: Container, out: Container,
) -> None:  # fmt: skip
    """Fit lines through raw speeds; out[w] holds the one that has ended by the w-th window's last sample.

    Takes each sample `EARLY` ticks after it has come. visits: those on which something may happen (see
    `worth_visiting`), ends: those on which windows end; both are indices.
    """
    w = 0
    for visit in visits:
        now = int(visit)
        if now > 0 and ticks[now] < ticks[now - 1]:  # no line goes on when the clock was set back
            for k in range(_STATES):
                state[k] = 0.0
        if abs(force[now]) <= MOST_N:
            joins = now > 0 and ticks[now] - ticks[now - 1] == 1
            state[_UNBROKEN] = state[_UNBROKEN] + 1.0 if joins else 1.0
        else:
            state[_UNBROKEN] = 0.0
        i = now - EARLY
        sound = state[_UNBROKEN] > EARLY + SETTLES
        count = state[_COUNT]
        x = float(ticks[i]) - state[_FIRST_TICK] if count > 0.0 else 0.0
        if count > 0.0 and (not sound or x >= LONGEST):
            state[_ENDED] = 1.0
        elif sound and state[_ENDED] == 0.0 and (count == 0.0 or speed[i] != state[_LAST_MPS]):
            if count == 0.0:
                state[_FIRST_MPS], state[_FIRST_TICK] = speed[i], float(ticks[i])
            v = speed[i] - state[_FIRST_MPS]
            state[_COUNT] += 1.0
            state[_X] += x
            state[_X2] += x * x
            state[_X3] += x * x * x
            state[_X4] += x * x * x * x
            state[_V] += v
            state[_XV] += x * v
            state[_X2V] += x * x * v
            state[_V2] += v * v
            state[_FORCE] += force[i]
            state[_WHEELS] = wheels[i]
            state[_LAST_MPS], state[_LAST_X] = speed[i], x
        while w < len(ends) and ends[w] < now:
            w += 1
        if w < len(ends) and ends[w] == now and state[_ENDED] > 0.0:
            if state[_COUNT] >= FEWEST:
                draw(state, float(ticks[now]), out[w])
            unbroken = state[_UNBROKEN]
            for k in range(_STATES):
                state[k] = 0.0
            state[_UNBROKEN] = unbroken  # a long coasting goes on


@jit.kernel
def draw(state: Container, tick: float, row: Container) -> None:
    """Put the line that has ended into a row of `COLUMNS`. tick: the present one.

    Its slope is as unsure as the speeds scatter about a parabola, and as that bends: a driveline that is not
    at rest yet, or has closed already, bends what should be straight.
    """
    n = state[_COUNT]
    mx, mv = state[_X] / n, state[_V] / n
    x2 = state[_X2] - n * mx * mx
    x3 = state[_X3] - 3.0 * mx * state[_X2] + 2.0 * n * mx * mx * mx
    x4 = state[_X4] - 4.0 * mx * state[_X3] + 6.0 * mx * mx * state[_X2] - 3.0 * n * mx * mx * mx * mx
    xv = state[_XV] - n * mx * mv
    x2v = state[_X2V] - 2.0 * mx * state[_XV] + mx * mx * n * mv - x2 * mv
    v2 = state[_V2] - n * mv * mv
    slope = xv / x2
    # the parabola beside the line: (x - mx)^2 less its mean and its own slope
    square = x4 - x2 * x2 / n - x3 * x3 / x2
    bend = (x2v - slope * x3) / square
    noise = max(v2 - slope * xv - bend * bend * square, 0.0) / (n - 3.0)
    turns = 2.0 * bend * state[_LAST_X]
    accel, var = slope / STEP_S, (noise / x2 + turns * turns / _BENT) / (STEP_S * STEP_S)
    if abs(accel) <= MOST_MPS2 and var <= MOST_MPS2 * MOST_MPS2:
        row[0], row[1] = accel, var
        row[2] = state[_FORCE] / n
        row[3] = state[_WHEELS]
        row[4] = (tick - state[_FIRST_TICK] - mx) * STEP_S


class CoastLines:
    """Carries the line that is being drawn."""

    def __init__(self) -> None:
        self._state: list[float] = [0.0] * _STATES

    def push(self, past: int, samples: NDArray[np.float64], ends: NDArray[np.int64]) -> NDArray[np.float64]:
        """Take samples: tick, force (NaN: no coasting), rotating mass, raw speed; shape (4, n).

        The first `past` of them have been there before; ends: those that end windows, (w,).
        Returns `COLUMNS` of the windows, (5, w).
        """
        out = np.full((len(ends), len(COLUMNS)), math.nan)
        begun = self._state[_UNBROKEN] > 0.0 or self._state[_COUNT] > 0.0
        visits = worth_visiting(past, samples[0], samples[1], ends, begun)
        if not len(visits):
            return out.T
        given = give(visits, *samples, ends.astype(np.float64))
        state = state_in(self._state)
        rows: Any = out if jit.enabled() else out.tolist()
        lines(*given, state, rows)
        self._state = state_out(state)
        return np.asarray(rows, np.float64).reshape(out.shape).T


def worth_visiting(
    past: int, ticks: FloatColumn, force: FloatColumn, ends: NDArray[np.int64], begun: bool
) -> NDArray[np.float64]:
    """Return the samples from `past` on where a line goes on, breaks or is drawn: few, of a drive.

    ticks, force: (n,), the force NaN where there is no coasting. begun: a line is on its way.
    """
    coasting = past + np.flatnonzero(np.abs(force[past:]) <= MOST_N)
    if not len(coasting) and not begun:
        return np.empty(0)
    set_back = 1 + np.flatnonzero(ticks[1:] < ticks[:-1])
    drawn = np.searchsorted(ends, coasting + 1)
    parts = (coasting, coasting + 1, ends[drawn[drawn < len(ends)]], set_back[set_back >= past])
    first = np.array([past, *ends[:1]] if begun else [], np.int64)
    visits = np.unique(np.concatenate((*parts, first)))
    return visits[visits < len(force)].astype(np.float64)
