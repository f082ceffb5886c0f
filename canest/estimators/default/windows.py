"""Cuts the 50 Hz samples into windows of 0.2 s, over which the estimator balances momentum.

A window ends on the ticks whose number is one less than a multiple of `TICKS`, whatever the cut of the
blocks; sums run tick by tick in one order, so the bits do not depend on the cut either.

Reported torque acts earlier than it is reported. Everything but traction is therefore taken `SHIFT` ticks
back (a typical delay); what remains of the delay is a state of the filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock
from canest.estimators.default.coasting import REACH, lines, run_lengths
from canest.estimators.default.model import TICKS, WINDOW_S, Window

SHIFT = 4  #: ticks that torque is typically late
COLUMNS = Window._fields
_REACH = TICKS + SHIFT + 1  #: samples before its last one that a window looks back to
_KEPT = REACH + TICKS + 2  #: and a coasting before it
_LONGEST_S = 86_400.0  #: a gap beyond a day is one of the clock
_SETTLED = 50  #: ticks after which a filter that began anew shows accelerations as they are
#: drag of cornering tyres by lateral acceleration squared: 1 / (g x cornering stiffness per load, some 5/rad)
_CORNERING_S2PM = 0.02

(
    _SENSED, _SPEED, _REST, _MU, _ACCEL, _AERO, _TRACTION, _GEAR, _ROTATING, _ALTITUDE, _YAW, _GATE, _STOPPED,
    _TICK, _BROKEN, _RAW, _COAST, _RUN, _TORQUE, _ROAD, _ROAD_STD,
) = range(21)  # fmt: skip
_COLUMNS = 21
#: ticks between two reports of a torque at most, of which the noise is measured
_REPORT = 5
_LATE = slice(_SENSED, _AERO + 1)  #: columns whose mean is taken SHIFT ticks back
_NEEDED = slice(_SPEED, _ROTATING + 1)  #: columns without which a sample is broken
#: beyond these no vehicle goes: m/s, N, -, m/s2, N, N, 1/m, kg; and the accelerometer, altitude, yaw rate
_MOST = np.array([[150.0], [1e7], [1.0], [50.0], [1e7], [1e7], [1e4], [1e6]])
_MOST_SENSED, _MOST_ALTITUDE, _MOST_YAW, _MOST_TORQUE = 50.0, 1e4, 3.0, 1e6

Picked = slice | NDArray[np.int64]  #: indices of samples, one per window


class Windows:
    """Carries the samples of the unfinished window and what the next one needs of the past."""

    def __init__(self, late_s: float = 0.0) -> None:
        self._late_s = late_s
        self._road_back = min(round(late_s / STEP_S), _REACH - 1)  # the road where the filtered vehicle is
        self._kept: NDArray[np.float64] = np.empty((_COLUMNS, 0))
        self._altitude_m = np.nan
        self._last_end: int | None = None
        self._started = 0

    def push(self, block: ModelBlock) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Take samples (n,); return finished windows (len(COLUMNS), w) and the samples that end them (w,)."""
        rows = self._rows(block)
        ticks = rows[_TICK].astype(np.int64)
        past = rows.shape[1] - len(block)
        ends = self._ends(ticks, past)
        starts = self._starts(rows[_GATE], ticks, past, ends)
        windows = np.empty((len(COLUMNS), 0))
        if len(ends):
            coasted = lines(rows[_RUN], rows[_COAST], rows[_ROTATING], rows[_RAW], ends, TICKS)
            coasted[-1] -= self._late_s
            windows = np.concatenate((self._windows(rows, ticks, ends, starts), coasted))
            self._last_end = int(ticks[ends[-1]])
        self._kept = rows[:, max(0, rows.shape[1] - _KEPT) :].copy()
        return windows, ends - past

    def _rows(self, block: ModelBlock) -> NDArray[np.float64]:
        """Stack what is kept and the block's needed columns, (columns, n).

        A sample with a number missing or beyond physics is closed as invalid.
        """
        past = self._kept.shape[1]
        rows = np.empty((_COLUMNS, past + len(block)))
        rows[:, :past] = self._kept
        new = rows[:, past:]
        new[_SENSED] = np.where(block.ax_ok, within(block.accelerometer_mps2, _MOST_SENSED), np.nan)
        with np.errstate(over="ignore", invalid="ignore"):  # the result is judged below
            np.subtract(block.force_N, block.traction_N, out=new[_REST])
        for row, column in (
            (_SPEED, block.speed_mps), (_MU, block.mu), (_ACCEL, block.accel_mps2), (_AERO, block.aero_N),
            (_TRACTION, block.traction_N), (_GEAR, block.force_per_torque_1pm),
            (_ROTATING, block.rotating_mass_kg), (_ALTITUDE, block.altitude_m), (_YAW, block.yaw_rate_radps),
            (_GATE, block.gate), (_STOPPED, block.stopped), (_TICK, block.t_us // STEP_US), (_BROKEN, 0.0),
            (_RAW, block.raw_speed_mps), (_COAST, block.coasting_N),
            (_TORQUE, within(block.raw_torque_Nm, _MOST_TORQUE)),
            (_ROAD, np.nan if block.road_sine is None else block.road_sine),
            (_ROAD_STD, np.nan if block.road_std is None else block.road_std),
        ):  # fmt: skip
            new[row] = column
        known = past > 0
        new[_RUN] = run_lengths(
            np.concatenate((rows[_TICK, past - 1 : past] if known else [np.nan], new[_TICK])),
            np.concatenate(([np.nan], new[_COAST])), rows[_RUN, past - 1] if known else 0.0,
        )  # fmt: skip
        needed = new[_NEEDED]
        if len(block) and not (np.abs(extremes(needed)) <= _MOST).all():  # NaN is not either
            sound = np.abs(needed) <= _MOST
            broken = ~sound.all(axis=0)
            new[_BROKEN] = broken
            needed[~sound] = 0.0
            motionless = ~(sound[_SPEED - _NEEDED.start] & sound[_ACCEL - _NEEDED.start])
            new[_SENSED, motionless] = np.nan
            new[_GATE, broken & (new[_GATE] == Gate.OPEN)] = Gate.INVALID
        return rows

    @staticmethod
    def _ends(ticks: NDArray[np.int64], past: int) -> NDArray[np.int64]:
        """Return the indices of samples that end a window, with every sample there that it looks back to."""
        n = len(ticks)
        if n and (ticks[1:] - ticks[:-1] == 1).all():  # none is missing
            first = max(past, _REACH)
            return np.arange(first + (-1 - int(ticks[0]) - first) % TICKS, n, TICKS)
        candidates = past + np.flatnonzero((ticks[past:] + 1) % TICKS == 0)
        candidates = candidates[candidates >= _REACH]
        whole: NDArray[np.int64] = candidates[ticks[candidates] - ticks[candidates - _REACH] == _REACH]
        return whole

    def _windows(
        self,
        rows: NDArray[np.float64],
        ticks: NDArray[np.int64],
        ends: NDArray[np.int64],
        starts: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        now, late = rows[:, back_from(ends, 0)], rows[:, back_from(ends, SHIFT)]
        sensed, mean_speed, rest, mu, accel, aero = mean_of(rows[_LATE], ends, SHIFT)
        (mean_traction,) = mean_of(rows[_TRACTION : _TRACTION + 1], ends, 0)
        traction, rotating = now[_TRACTION], now[_ROTATING]
        before = np.empty(len(ends), np.int64)
        before[0] = ticks[ends[0]] - TICKS if self._last_end is None else self._last_end
        before[1:] = ticks[ends[:-1]]
        between_s = (ticks[ends] - before - TICKS) * STEP_S
        lateral_mps2 = late[_SPEED] * within(late[_YAW], _MOST_YAW)
        is_open, retarding, coarse, turns = self._gates(rows, ticks[ends] - starts, ends)
        bend_mps2 = np.where(turns, _CORNERING_S2PM * lateral_mps2**2, 0.0)
        coarse &= bend_mps2 >= 0.0  # NaN where nobody tells how sharp the bend is
        columns = [
            # no time runs backwards where a clock is set back, and no vehicle waits for years
            np.where(between_s < 0.0, WINDOW_S, np.minimum(between_s, _LONGEST_S)),
            np.maximum(mean_speed, 0.0) * WINDOW_S,
            rows[_TRACTION, back_from(ends, TICKS)],
            late[_SPEED],
            # traction is not shifted, the rest of the force is: force = (F - T)[k - SHIFT] + T[k]
            rest + mean_traction + rotating * accel,
            traction,
            GRAVITY_MPS2 * mu,
            accel,
            2.0 * aero / np.maximum(mean_speed, 1.0),
            now[_GEAR],
            rotating,
            sensed,
            self._new_altitudes(within(now[_ALTITUDE], _MOST_ALTITUDE)),
            is_open,
            retarding & ~is_open,
            np.maximum(now[_STOPPED], np.isnan(now[_RAW])),  # for all that is known it stands
            coarse & ~is_open,
            bend_mps2,
            mean_of(zigzag(rows[_TORQUE])[None], ends, 0)[0],
            *rows[_ROAD : _ROAD_STD + 1, back_from(ends, self._road_back)],
        ]
        return np.array(columns, np.float64)

    @staticmethod
    def _gates(
        rows: NDArray[np.float64], settled: NDArray[np.int64], ends: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where no gate is closed, only a retarder's, only one of a bend or dwell, and where it turns.

        settled: ticks since filters last began anew.
        """
        closed, turning = rows[_GATE] != Gate.OPEN, rows[_GATE] == Gate.TURNING
        is_open = none_of(closed, ends, TICKS)
        retarding = none_of(closed & (rows[_GATE] != Gate.RETARDER), ends, TICKS)
        coarse = none_of(closed & (rows[_GATE] != Gate.RECOVERY) & ~turning, ends, _REACH)
        coarse &= settled > _SETTLED
        if rows[_BROKEN].any():
            sound = none_of(rows[_BROKEN] > 0.0, ends, _REACH + 1)
            is_open, retarding, coarse = is_open & sound, retarding & sound, coarse & sound
        return is_open, retarding, coarse, ~none_of(turning, ends, _REACH)

    def _starts(
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

    def _new_altitudes(self, altitude_m: FloatColumn) -> FloatColumn:
        """Return altitudes where they differ from the one before, else NaN."""
        before = np.concatenate(([self._altitude_m], altitude_m[:-1]))
        self._altitude_m = float(altitude_m[-1])
        return np.where(altitude_m != before, altitude_m, np.nan)


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


def zigzag(torque_Nm: FloatColumn) -> FloatColumn:
    """Return -d d' dt of changes d, d' of a torque that follow each other dt apart, Nm2 s by tick, (n,).

    Its mean is the density of white noise; a torque that rises or falls has a negative one (Roll 1984).
    """
    change = np.diff(torque_Nm, prepend=torque_Nm[:1])
    at = np.flatnonzero(change != 0.0)
    ticks = np.diff(at)
    out = np.zeros(len(torque_Nm))
    found = -change[at[1:]] * change[at[:-1]] * ticks * ticks * STEP_S  # each for the ticks that it lasts
    out[at[1:]] = np.where((ticks <= _REPORT) & np.isfinite(found), found, 0.0)
    return out


def within(values: FloatColumn, most: float) -> FloatColumn:
    """Return values (n,), NaN where they are beyond physics."""
    return np.where(np.abs(values) <= most, values, np.nan)


def extremes(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least and the largest value of each row, (rows, 2); NaN where there is one."""
    return np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1)
