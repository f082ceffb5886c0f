"""Cuts the 50 Hz samples into windows of 0.2 s and balances momentum over each.

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
from canest.estimators.canest_0_1.lines import COLUMNS as COASTED
from canest.estimators.canest_0_1.lines import CoastLines

TICKS = 10  #: samples per window; 0.2 s, about the correlation time of speeds filtered at 2 Hz
WINDOW_S = TICKS * STEP_S
SHIFT = 4  #: ticks that torque is typically late
_REACH = TICKS + SHIFT + 1  #: samples before its last one that a window looks back to
_LONGEST_S = 86_400.0  #: a gap beyond a day is one of the clock
_SETTLED = 50  #: ticks after which a filter that began anew shows accelerations as they are

#: columns of a window, in the kernel's order
COLUMNS = (
    "gap_s",  # time missing before this window
    "distance_m",
    "before_mps",  # speed on the sample before the window
    "before_N",  # traction there
    "before_Nps",  # and its rate
    "speed_mps",  # at the end
    "force_N",  # mean, the inertia of `rotating_kg` not subtracted
    "traction_N",  # at the end
    "traction_Nps",  # its rate there
    "roll_mps2",  # mean g mu
    "accel_mps2",  # mean
    "drag_N_per_mps",  # aerodynamic force per m/s of wind, mean
    "gear_1pm",  # force per crank torque
    "rotating_kg",
    "undriven_mps",  # at the end, NaN without
    "sensed_mps2",  # mean of the accelerometer, NaN without
    "altitude_m",  # only when a new value came, else NaN
    "open",
    "retarding",  # 1 where nothing but a retarder of known force closes the gate
    "stopped",
    "coarse",  # 1 where nothing but a bend or the dwell after another gate closes this one
    "bend_mps2",  # what a bend may brake there, std
    "road_sine",  # slope by a road map, NaN without; and its std
    "road_std",
    *COASTED,
)

(
    _SENSED,
    _SPEED,
    _REST,  # known forces less traction
    _MU,
    _ACCEL,
    _AERO,
    _TRACTION,
    _GEAR,
    _ROTATING,
    _UNDRIVEN,
    _ALTITUDE,
    _YAW,
    _GATE,
    _STOPPED,
    _TICK,
    _BROKEN,
    _RAW,
    _COAST,
    _ROAD,
    _ROAD_STD,
) = range(20)
_COLUMNS = 20
_LINED = [_TICK, _COAST, _ROTATING, _RAW]  #: what lines through a coasting are drawn from
_LATE = slice(_SENSED, _AERO + 1)  #: columns whose mean is taken SHIFT ticks back
_NEEDED = slice(_SPEED, _ROTATING + 1)  #: columns without which a sample is broken
#: beyond these no vehicle goes: m/s, N, -, m/s2, N, N, 1/m, kg; and the accelerometer, altitude
_MOST = np.array([[150.0], [1e7], [1.0], [50.0], [1e7], [1e7], [1e4], [1e6]])
_MOST_SENSED, _MOST_SPEED, _MOST_ALTITUDE, _MOST_YAW = 50.0, 150.0, 1e4, 3.0
#: drag of cornering tyres by lateral acceleration squared: 1 / (g x cornering stiffness per load, some 5/rad)
_CORNERING_S2PM = 0.02

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
        self._lines = CoastLines()

    def push(self, block: ModelBlock) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Take samples (n,); return finished windows (len(COLUMNS), w) and the samples that end them (w,)."""
        rows = self._rows(block)
        ticks = rows[_TICK].astype(np.int64)
        past = rows.shape[1] - len(block)
        ends = self._ends(ticks, past)
        starts = self._starts(rows[_GATE], ticks, past, ends)
        coasted = self._lines.push(past, rows[_LINED], ends)
        if len(ends):
            coasted[-1] -= self._late_s
            windows = np.concatenate((self._windows(rows, ticks, ends, starts), coasted))
            self._last_end = int(ticks[ends[-1]])
        else:
            windows = np.empty((len(COLUMNS), 0))
        self._kept = rows[:, max(0, rows.shape[1] - _REACH) :].copy()
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
        new[_SPEED] = block.speed_mps
        with np.errstate(over="ignore", invalid="ignore"):  # the result is judged below
            np.subtract(block.force_N, block.traction_N, out=new[_REST])
        new[_MU] = block.mu
        new[_ACCEL] = block.accel_mps2
        new[_AERO] = block.aero_N
        new[_TRACTION] = block.traction_N
        new[_GEAR] = block.force_per_torque_1pm
        new[_ROTATING] = block.rotating_mass_kg
        new[_UNDRIVEN] = block.undriven_mps
        new[_ALTITUDE] = block.altitude_m
        new[_YAW] = block.yaw_rate_radps
        new[_GATE] = block.gate
        new[_STOPPED] = block.stopped
        new[_TICK] = block.t_us // STEP_US
        new[_BROKEN] = 0.0
        new[_RAW] = block.raw_speed_mps
        new[_COAST] = block.coasting_N
        new[_ROAD] = np.nan if block.road_sine is None else block.road_sine
        new[_ROAD_STD] = np.nan if block.road_std is None else block.road_std
        needed = new[_NEEDED]
        if len(block) and not (np.abs(extremes(needed)) <= _MOST).all():  # NaN is not either
            sound = np.abs(needed) <= _MOST
            new[_BROKEN] = ~sound.all(axis=0)
            needed[~sound] = 0.0
            motionless = ~(sound[_SPEED - _NEEDED.start] & sound[_ACCEL - _NEEDED.start])
            new[_SENSED, motionless] = np.nan
            broken = new[_BROKEN] > 0.0
            new[_GATE, broken] = np.where(new[_GATE, broken] == Gate.OPEN, Gate.INVALID, new[_GATE, broken])
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
        before_mps = rows[_SPEED, back_from(ends, TICKS + SHIFT)]
        first_N = rows[_TRACTION, back_from(ends, TICKS)]
        sensed, mean_speed, rest, mu, accel, aero = mean_of(rows[_LATE], ends, SHIFT)
        (mean_traction,) = mean_of(rows[_TRACTION : _TRACTION + 1], ends, 0)
        traction, rotating = now[_TRACTION], now[_ROTATING]
        before = np.empty(len(ends), np.int64)
        before[0] = ticks[ends[0]] - TICKS if self._last_end is None else self._last_end
        before[1:] = ticks[ends[:-1]]
        closed = rows[_GATE] != Gate.OPEN
        is_open = none_of(closed, ends, TICKS)
        retarding = none_of(closed & (rows[_GATE] != Gate.RETARDER), ends, TICKS)
        turning = rows[_GATE] == Gate.TURNING
        coarse = none_of(closed & (rows[_GATE] != Gate.RECOVERY) & ~turning, ends, _REACH)
        coarse &= ticks[ends] - starts > _SETTLED
        lateral_mps2 = late[_SPEED] * within(late[_YAW], _MOST_YAW)
        bend_mps2 = np.where(none_of(turning, ends, _REACH), 0.0, _CORNERING_S2PM * lateral_mps2**2)
        coarse &= bend_mps2 >= 0.0  # NaN where nobody tells how sharp the bend is
        if rows[_BROKEN].any():
            sound = none_of(rows[_BROKEN] > 0.0, ends, _REACH + 1)
            is_open &= sound
            retarding &= sound
            coarse &= sound
        between_s = (ticks[ends] - before - TICKS) * STEP_S
        columns = [
            # no time runs backwards where a clock is set back, and no vehicle waits for years
            np.where(between_s < 0.0, WINDOW_S, np.minimum(between_s, _LONGEST_S)),
            np.maximum(mean_speed, 0.0) * WINDOW_S,
            before_mps,
            first_N,
            (first_N - rows[_TRACTION, back_from(ends, TICKS + 1)]) / STEP_S,
            late[_SPEED],
            # traction is not shifted, the rest of the force is: force = (F - T)[k - SHIFT] + T[k]
            rest + mean_traction + rotating * accel,
            traction,
            (traction - rows[_TRACTION, back_from(ends, 1)]) / STEP_S,
            GRAVITY_MPS2 * mu,
            accel,
            2.0 * aero / np.maximum(mean_speed, 1.0),
            now[_GEAR],
            rotating,
            within(late[_UNDRIVEN], _MOST_SPEED),
            sensed,
            self._new_altitudes(within(now[_ALTITUDE], _MOST_ALTITUDE)),
            is_open,
            retarding & ~is_open,
            now[_STOPPED],
            coarse & ~is_open,
            bend_mps2,
            *rows[_ROAD:, back_from(ends, self._road_back)],
        ]
        return np.array(columns, np.float64)

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


def within(values: FloatColumn, most: float) -> FloatColumn:
    """Return values (n,), NaN where they are beyond physics."""
    return np.where(np.abs(values) <= most, values, np.nan)


def extremes(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least and the largest value of each row, (rows, 2); NaN where there is one."""
    return np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1)
