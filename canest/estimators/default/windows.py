"""The columns of the windows over which the estimator balances momentum (docs/theory.md, section 3.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock
from canest.estimators.default.coasting import REACH as COASTED
from canest.estimators.default.coasting import lines, run_lengths
from canest.estimators.default.model import Window
from canest.estimators.windowing import (
    REACH,
    SHIFT,
    TICKS,
    WINDOW_S,
    WindowCutter,
    back_from,
    mean_of,
    window_gates,
    within,
)

COLUMNS = Window._fields
Ticks = NDArray[np.int64]
_KEPT = COASTED + TICKS + 2  #: samples that the next block may look back to: a window, and a coasting
#: an undriven axle that gains so much more or less than the driven ones in a window is no axle, m/s
_MOST_APART_MPS = 0.5
#: drag of cornering tyres by lateral acceleration squared: 1 / (g x cornering stiffness per load, some 5/rad)
_CORNERING_S2PM = 0.02

(
    _SENSED, _SPEED, _REST, _MU, _ACCEL, _AERO, _TRACTION, _GEAR, _ROTATING, _ALTITUDE, _YAW, _GATE, _STOPPED,
    _TICK, _BROKEN, _RAW, _COAST, _RUN, _TORQUE, _UNDRIVEN, _ROAD, _ROAD_STD, _GEAR_NUMBER,
) = range(23)  # fmt: skip
_COLUMNS = 23
#: ticks between two reports of a torque at most, of which the noise is measured
_REPORT = 5
_LATE = slice(_SENSED, _AERO + 1)  #: columns whose mean is taken SHIFT ticks back
_NEEDED = slice(_SPEED, _ROTATING + 1)  #: columns without which a sample is broken
#: beyond these no vehicle goes: m/s, N, -, m/s2, N, N, 1/m, kg; and the accelerometer, altitude, yaw rate
_MOST = np.array([[150.0], [1e7], [1.0], [50.0], [1e7], [1e7], [1e4], [1e6]])
_MOST_SENSED, _MOST_ALTITUDE, _MOST_YAW, _MOST_TORQUE = 50.0, 1e4, 3.0, 1e6


class Windows:
    """Carries the samples of the unfinished window and what the next one needs of the past."""

    def __init__(self, late_s: float = 0.0, lacking_Nm: float = 0.0, knows_retarder: bool = True) -> None:
        self._late_s, self._lacking_Nm = late_s, lacking_Nm  # the latter: torque less than reported
        self._knows_retarder = knows_retarder
        self._road_back = min(round(late_s / STEP_S), REACH - 1)  # the road where the filtered vehicle is
        self._kept: FloatColumn = np.empty((_COLUMNS, 0))
        self._cutter = WindowCutter()

    def push(self, block: ModelBlock) -> tuple[FloatColumn, Ticks]:
        """Take samples (n,); return finished windows (len(COLUMNS), w) and the samples that end them (w,)."""
        rows = self._rows(block)
        ticks = rows[_TICK].astype(np.int64)
        past = rows.shape[1] - len(block)
        ends = self._cutter.ends(ticks, past)
        starts = self._cutter.starts(rows[_GATE], ticks, past, ends)
        windows = np.empty((len(COLUMNS), 0))
        if len(ends):
            coasted = lines(rows[_RUN], rows[_COAST], rows[_ROTATING], rows[_RAW], ends, TICKS)
            coasted[-1] -= self._late_s
            windows = np.concatenate((self._windows(rows, ticks, ends, starts), coasted))
        self._kept = rows[:, max(0, rows.shape[1] - _KEPT) :].copy()
        return windows, ends - past

    def _rows(self, block: ModelBlock) -> FloatColumn:
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
            traction_N = block.traction_N - self._lacking_Nm * block.force_per_torque_1pm
        for row, column in (
            (_SPEED, block.speed_mps), (_MU, block.mu), (_ACCEL, block.accel_mps2), (_AERO, block.aero_N),
            (_TRACTION, traction_N), (_GEAR, block.force_per_torque_1pm),
            (_ROTATING, block.rotating_mass_kg), (_ALTITUDE, block.altitude_m), (_YAW, block.yaw_rate_radps),
            (_GATE, block.gate), (_STOPPED, block.stopped), (_TICK, block.t_us // STEP_US), (_BROKEN, 0.0),
            (_RAW, block.raw_speed_mps), (_COAST, block.coasting_N),
            (_TORQUE, within(block.raw_torque_Nm, _MOST_TORQUE)),
            (_UNDRIVEN, within(block.undriven_mps, _MOST[0, 0])),
            (_ROAD, np.nan if block.road_sine is None else block.road_sine),
            (_ROAD_STD, np.nan if block.road_std is None else block.road_std),
            (_GEAR_NUMBER, block.gear),
        ):  # fmt: skip
            new[row] = column
        tick_before, coasted = rows[[_TICK, _RUN], past - 1] if past else (np.nan, 0.0)
        new[_RUN] = run_lengths(np.append(tick_before, new[_TICK]), np.append(np.nan, new[_COAST]), coasted)
        needed = new[_NEEDED]
        sound = np.abs(needed) <= _MOST  # NaN is not
        if not sound.all():
            broken = ~sound.all(axis=0)
            new[_BROKEN] = broken
            needed[~sound] = 0.0
            motionless = ~(sound[_SPEED - _NEEDED.start] & sound[_ACCEL - _NEEDED.start])
            new[_SENSED, motionless] = np.nan
            new[_GATE, broken & (new[_GATE] == Gate.OPEN)] = Gate.INVALID
        return rows

    def _windows(self, rows: FloatColumn, ticks: Ticks, ends: Ticks, starts: Ticks) -> FloatColumn:
        """Return the columns of the windows but those of coasting, (len(COLUMNS) - 5, w)."""
        now, late = rows[:, back_from(ends, 0)], rows[:, back_from(ends, SHIFT)]
        sensed, mean_speed, rest, mu, accel, aero = mean_of(rows[_LATE], ends, SHIFT)
        undriven, begun = late[_UNDRIVEN], rows[_UNDRIVEN, back_from(ends, SHIFT + TICKS)]
        gained = undriven - begun
        undriven = np.where(np.abs(gained - WINDOW_S * accel) > _MOST_APART_MPS, np.nan, undriven)
        body_accel = np.where(np.isnan(undriven - begun), accel, gained / WINDOW_S)
        mean_traction, noise = mean_of(np.stack((rows[_TRACTION], zigzag(rows[_TORQUE]))), ends, 0)
        rotating, lateral_mps2 = now[_ROTATING], late[_SPEED] * within(late[_YAW], _MOST_YAW)
        settled = ticks[ends] - starts
        is_open, retarding, coarse, turns = window_gates(rows[_GATE], rows[_BROKEN], settled, ends)
        bend_mps2 = np.where(turns, _CORNERING_S2PM * lateral_mps2**2, 0.0)
        is_known = bend_mps2 >= 0.0  # NaN where nobody tells how sharp the bend is
        retarding, coarse = retarding & is_known, coarse & is_known
        direction = np.where(now[_GEAR_NUMBER] < 0.0, -1.0, 1.0)
        columns = [
            direction * np.maximum(mean_speed, 0.0) * WINDOW_S,
            rows[_TRACTION, back_from(ends, TICKS)],
            # traction is not shifted, the rest of the force is: force = (F - T)[k - SHIFT] + T[k]
            rest + mean_traction + rotating * accel,
            GRAVITY_MPS2 * mu,
            body_accel,
            2.0 * aero / np.maximum(mean_speed, 1.0),
            sensed,
            self._cutter.new_altitudes(within(now[_ALTITUDE], _MOST_ALTITUDE)),
            self._cutter.gaps_s(ticks[ends]),
            late[_SPEED],
            now[_TRACTION],
            undriven,
            now[_GEAR],
            rotating,
            is_open,
            retarding & ~is_open & self._knows_retarder,
            np.maximum(now[_STOPPED], np.isnan(now[_RAW])),  # for all that is known it stands
            coarse & ~is_open,
            bend_mps2,
            noise,
            *rows[_ROAD : _ROAD_STD + 1, back_from(ends, self._road_back)],
        ]
        return np.array(columns, np.float64)


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
