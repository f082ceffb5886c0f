"""Cuts the 50 Hz samples into windows of 0.2 s and balances momentum over each.

Reported torque acts earlier than it is reported. Everything but traction is therefore taken `SHIFT` ticks
back (a typical delay); what remains of the delay is a state of the filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock
from canest.estimators.canest_0_1.lines import COLUMNS as COASTED
from canest.estimators.canest_0_1.lines import CoastLines
from canest.estimators.windowing import (
    REACH,
    SHIFT,
    TICKS,
    WINDOW_S,
    WindowCutter,
    back_from,
    extremes,
    mean_of,
    window_gates,
    within,
)

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


class Windows:
    """Carries the samples of the unfinished window and what the next one needs of the past."""

    def __init__(self, late_s: float = 0.0) -> None:
        self._late_s = late_s
        self._road_back = min(round(late_s / STEP_S), REACH - 1)  # the road where the filtered vehicle is
        self._kept: NDArray[np.float64] = np.empty((_COLUMNS, 0))
        self._cutter = WindowCutter()
        self._lines = CoastLines()

    def push(self, block: ModelBlock) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Take samples (n,); return finished windows (len(COLUMNS), w) and the samples that end them (w,)."""
        rows = self._rows(block)
        ticks = rows[_TICK].astype(np.int64)
        past = rows.shape[1] - len(block)
        ends = self._cutter.ends(ticks, past)
        starts = self._cutter.starts(rows[_GATE], ticks, past, ends)
        coasted = self._lines.push(past, rows[_LINED], ends)
        if len(ends):
            coasted[-1] -= self._late_s
            windows = np.concatenate((self._windows(rows, ticks, ends, starts), coasted))
        else:
            windows = np.empty((len(COLUMNS), 0))
        self._kept = rows[:, max(0, rows.shape[1] - REACH) :].copy()
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
        is_open, retarding, coarse, turns = window_gates(
            rows[_GATE], rows[_BROKEN], ticks[ends] - starts, ends
        )
        lateral_mps2 = late[_SPEED] * within(late[_YAW], _MOST_YAW)
        bend_mps2 = np.where(turns, _CORNERING_S2PM * lateral_mps2**2, 0.0)
        coarse &= bend_mps2 >= 0.0  # NaN where nobody tells how sharp the bend is
        columns = [
            self._cutter.gaps_s(ticks[ends]),
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
            self._cutter.new_altitudes(within(now[_ALTITUDE], _MOST_ALTITUDE)),
            is_open,
            retarding & ~is_open,
            now[_STOPPED],
            coarse & ~is_open,
            bend_mps2,
            *rows[_ROAD:, back_from(ends, self._road_back)],
        ]
        return np.array(columns, np.float64)
