"""Cuts the 50 Hz samples into windows of 0.2 s, of which sums and means are taken.

A window ends on the ticks whose number is one less than a multiple of `TICKS`, whatever the cut of the
blocks; sums run tick by tick in one order, so the bits do not depend on the cut either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.gates import Gate
from canest.core.samples import STEP_S

TICKS = 10  #: samples per window; 0.2 s, about the correlation time of speeds filtered at 2 Hz
WINDOW_S = TICKS * STEP_S
SHIFT = 4  #: ticks that torque is typically late
REACH = TICKS + SHIFT + 1  #: samples before its last one that a window looks back to
_LONGEST_S = 86_400.0  #: a gap beyond a day is one of the clock
_SETTLED = 50  #: ticks after which a filter that began anew shows accelerations as they are

Picked = slice | NDArray[np.int64]  #: indices of samples, one per window


class WindowCutter:
    """Tells where windows end and begin anew, over blocks that follow each other."""

    def __init__(self) -> None:
        self._altitude_m = np.nan
        self._last_end: int | None = None
        self._started = 0

    @staticmethod
    def ends(ticks: NDArray[np.int64], past: int) -> NDArray[np.int64]:
        """Return the indices of samples that end a window, with every sample there that it looks back to.

        ticks: of samples, the first `past` of them from blocks before.
        """
        n = len(ticks)
        if n and (ticks[1:] - ticks[:-1] == 1).all():  # none is missing
            first = max(past, REACH)
            return np.arange(first + (-1 - int(ticks[0]) - first) % TICKS, n, TICKS)
        candidates = past + np.flatnonzero((ticks[past:] + 1) % TICKS == 0)
        candidates = candidates[candidates >= REACH]
        whole: NDArray[np.int64] = candidates[ticks[candidates] - ticks[candidates - REACH] == REACH]
        return whole

    def starts(
        self, gate: FloatColumn, ticks: NDArray[np.int64], past: int, ends: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return for each window the tick on which filters last began anew (gap, missing signal)."""
        new = ticks[past:]
        anew = (gate[past:] == Gate.STALE) | (gate[past:] == Gate.INVALID)
        anew[1:] |= new[1:] - new[:-1] != 1
        if len(new):
            anew[0] |= not past or new[0] - ticks[past - 1] != 1
        begun = np.flatnonzero(anew)
        starts = np.concatenate(([self._started], new[begun]))
        self._started = int(starts[-1])
        return starts[np.searchsorted(begun, ends - past, side="right")]

    def gaps_s(self, end_ticks: NDArray[np.int64]) -> FloatColumn:
        """Return the time that is missing before windows that end on these ticks (w,), s.

        No time runs backwards where a clock is set back, and no vehicle waits for years.
        """
        first = end_ticks[0] - TICKS if self._last_end is None else self._last_end
        before = np.concatenate(([first], end_ticks[:-1]))
        self._last_end = int(end_ticks[-1])
        between_s = (end_ticks - before - TICKS) * STEP_S
        return np.where(between_s < 0.0, WINDOW_S, np.minimum(between_s, _LONGEST_S))

    def new_altitudes(self, altitude_m: FloatColumn) -> FloatColumn:
        """Return altitudes where they differ from the one before, else NaN."""
        before = np.concatenate(([self._altitude_m], altitude_m[:-1]))
        self._altitude_m = float(altitude_m[-1])
        return np.where(altitude_m != before, altitude_m, np.nan)


def window_gates(
    gate: FloatColumn, broken: FloatColumn, settled: NDArray[np.int64], ends: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where no gate is closed, only a retarder's, only one of a bend or dwell, and where it turns.

    gate, broken: of samples (n,). settled: ticks since filters last began anew.
    """
    closed, turning = gate != Gate.OPEN, gate == Gate.TURNING
    is_open = none_of(closed, ends, TICKS)
    retarding = none_of(closed & (gate != Gate.RETARDER), ends, TICKS)
    coarse = none_of(closed & (gate != Gate.RECOVERY) & ~turning, ends, REACH)
    coarse &= settled > _SETTLED
    if broken.any():
        sound = none_of(broken > 0.0, ends, REACH + 1)
        is_open, retarding, coarse = is_open & sound, retarding & sound, coarse & sound
    return is_open, retarding, coarse, ~none_of(turning, ends, REACH)


def back_from(ends: NDArray[np.int64], back: int) -> Picked:
    """Return the samples ``back`` ticks before each end: a slice (no copy) where none is missing."""
    first, last = int(ends[0]) - back, int(ends[-1]) - back
    if last - first == TICKS * (len(ends) - 1):
        return slice(first, last + 1, TICKS)
    return ends - back


def mean_of(columns: NDArray[np.float64], ends: NDArray[np.int64], back: int) -> NDArray[np.float64]:
    """Return the means of columns (c, n) over the windows' samples, `back` ticks earlier: (c, w).

    Summed in order of time whatever the number of windows, so that no bit depends on it.
    """
    if len(ends) == 1:  # a live block, where numpy's cost per call rules
        last = int(ends[0]) - back
        sums: NDArray[np.float64] = columns[:, last - TICKS + 1 : last + 1].cumsum(axis=1)[:, -1:]
        return sums / TICKS
    total = columns[:, back_from(ends, back + TICKS - 1)].copy()
    for earlier in range(TICKS - 2, -1, -1):
        total += columns[:, back_from(ends, back + earlier)]
    total /= TICKS
    return total


def none_of(marked: NDArray[np.bool_], ends: NDArray[np.int64], ticks: int) -> NDArray[np.bool_]:
    """Return for each end whether none of the last ``ticks`` samples is marked, bool (w,)."""
    if not marked.any():
        return np.ones(len(ends), np.bool_)
    found = marked[back_from(ends, 0)].copy()
    for back in range(1, ticks):
        found |= marked[back_from(ends, back)]
    return ~found


def within(values: FloatColumn, most: float) -> FloatColumn:
    """Return values (n,), NaN where they are beyond physics."""
    return np.where(np.abs(values) <= most, values, np.nan)


def extremes(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least and the largest value of each row, (rows, 2); NaN where there is one."""
    return np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1)
