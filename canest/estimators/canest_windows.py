"""Cuts the 50 Hz samples into windows of 0.2 s and balances momentum over each.

A window ends on the ticks whose number is one less than a multiple of `TICKS`, whatever the cut of the
blocks; sums run tick by tick in one order, so the bits do not depend on the cut either.

Reported torque acts earlier than it is reported. Everything but traction is therefore taken `SHIFT` ticks
back (a typical delay); what remains of the delay is a state of the filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.frames import FloatColumn
from canest.gates import Gate
from canest.vehicle.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock

TICKS = 10  #: samples per window; 0.2 s, about the correlation time of speeds filtered at 2 Hz
WINDOW_S = TICKS * STEP_S
SHIFT = 4  #: ticks that torque is typically late
_REACH = TICKS + SHIFT + 1  #: samples before its last one that a window looks back to

#: columns of a window, in the kernel's order
COLUMNS = (
    "gap_s",  # time missing before this window
    "distance_m",
    "before_mps",  # speed on the sample before the window
    "before_N",  # traction there
    "before_Nps",  # and its rate
    "speed_mps",  # at the end
    "force_N",  # mean, rotating inertia not subtracted
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
    _GATE,
    _STOPPED,
    _TICK,
    _BROKEN,
) = range(15)
_COLUMNS = 15
_LATE = slice(_SENSED, _AERO + 1)  #: columns whose mean is taken SHIFT ticks back
_NEEDED = slice(_SPEED, _ROTATING + 1)  #: columns without which a sample is broken
_BOUNDED = slice(_SENSED, _ALTITUDE + 1)
_BACK = np.arange(TICKS - 1, -1, -1)[:, None]  #: from a window's end to its samples, in order of time


class Windows:
    """Carries the samples of the unfinished window and what the next one needs of the past."""

    def __init__(self) -> None:
        self._kept: NDArray[np.float64] = np.empty((_COLUMNS, 0))
        self._altitude_m = np.nan
        self._last_end: int | None = None

    def push(self, block: ModelBlock) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Take samples (n,); return the finished windows (len(COLUMNS), w) and each sample's window.

        The second is int64 (n,): how many windows of this call had ended at or before the sample.
        """
        rows = np.concatenate([self._kept, _rows(block)], axis=1)
        ticks = rows[_TICK].astype(np.int64)
        past = rows.shape[1] - len(block)
        ends = self._ends(ticks, past)
        if len(ends):
            windows = self._windows(rows, ticks, ends)
            self._last_end = int(ticks[ends[-1]])
        else:
            windows = np.empty((len(COLUMNS), 0))
        self._kept = rows[:, max(0, rows.shape[1] - _REACH) :].copy()
        finished = np.searchsorted(ends, np.arange(past, rows.shape[1]), side="right")
        return windows, finished

    @staticmethod
    def _ends(ticks: NDArray[np.int64], past: int) -> NDArray[np.int64]:
        """Return the indices of samples that end a window, with every sample there that it looks back to."""
        candidates = past + np.flatnonzero((ticks[past:] + 1) % TICKS == 0)
        candidates = candidates[candidates >= _REACH]
        whole: NDArray[np.int64] = candidates[ticks[candidates] - ticks[candidates - _REACH] == _REACH]
        return whole

    def _windows(
        self, rows: NDArray[np.float64], ticks: NDArray[np.int64], ends: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        def at(column: int, back: int) -> FloatColumn:
            value: FloatColumn = rows[column][ends - back]
            return value

        samples = ends - _BACK
        sensed, mean_speed, rest, mu, accel, aero = mean_of(rows[_LATE][:, samples - SHIFT])
        (mean_traction,) = mean_of(rows[_TRACTION : _TRACTION + 1][:, samples])
        traction, rotating = at(_TRACTION, 0), at(_ROTATING, 0)
        first_N = at(_TRACTION, TICKS)
        before = np.empty(len(ends), np.int64)
        before[0] = ticks[ends[0]] - TICKS if self._last_end is None else self._last_end
        before[1:] = ticks[ends[:-1]]
        gates = rows[_GATE][samples]
        open_ = gates == Gate.OPEN
        is_open = open_.all(axis=0)
        if rows[_BROKEN].any():
            broken = np.concatenate(([0.0], np.cumsum(rows[_BROKEN])))
            is_open &= broken[ends + 1] == broken[ends - _REACH]
        retarding = ((gates == Gate.RETARDER) | open_).all(axis=0)
        columns = [
            (ticks[ends] - before - TICKS) * STEP_S,
            np.maximum(mean_speed, 0.0) * WINDOW_S,
            at(_SPEED, TICKS + SHIFT),
            first_N,
            (first_N - at(_TRACTION, TICKS + 1)) / STEP_S,
            at(_SPEED, SHIFT),
            # traction is not shifted, the rest of the force is: force = (F - T)[k - SHIFT] + T[k]
            rest + mean_traction + rotating * accel,
            traction,
            (traction - at(_TRACTION, 1)) / STEP_S,
            GRAVITY_MPS2 * mu,
            accel,
            2.0 * aero / np.maximum(mean_speed, 1.0),
            at(_GEAR, 0),
            rotating,
            at(_UNDRIVEN, SHIFT),
            sensed,
            self._new_altitudes(at(_ALTITUDE, 0)),
            is_open,
            retarding & ~is_open,
            at(_STOPPED, 0),
        ]
        return np.array(columns, np.float64)

    def _new_altitudes(self, altitude_m: FloatColumn) -> FloatColumn:
        """Return altitudes where they differ from the one before, else NaN."""
        before = np.concatenate(([self._altitude_m], altitude_m[:-1]))
        self._altitude_m = float(altitude_m[-1])
        return np.where(altitude_m != before, altitude_m, np.nan)


def mean_of(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means (columns, w) of samples (columns, `TICKS`, w), summed in order of time."""
    means: NDArray[np.float64] = np.cumsum(samples, axis=1)[:, -1] / TICKS
    return means


#: beyond these no vehicle goes, in the order of the columns: m/s2, m/s, N, -, m/s2, N, N, 1/m, kg, m/s, m
_MOST = np.array([[50.0], [150.0], [1e7], [1.0], [50.0], [1e7], [1e7], [1e4], [1e6], [150.0], [1e4]])


def _rows(block: ModelBlock) -> NDArray[np.float64]:
    """Stack the needed columns; a sample with a number missing or beyond physics is closed as invalid."""
    rows = np.array(
        [
            np.where(block.ax_ok, block.accelerometer_mps2, np.nan),
            block.speed_mps,
            block.force_N,
            block.mu,
            block.accel_mps2,
            block.aero_N,
            block.traction_N,
            block.force_per_torque_1pm,
            block.rotating_mass_kg,
            block.undriven_mps,
            block.altitude_m,
            block.gate,
            block.stopped,
            block.t_us // STEP_US,
            block.stopped,  # the place of `_BROKEN`
        ],
        np.float64,
    )
    bounded = rows[_BOUNDED]
    bounded[~(np.abs(bounded) <= _MOST)] = np.nan
    rows[_BROKEN] = broken = np.isnan(rows[_NEEDED]).any(axis=0)
    if broken.any():
        rows[_NEEDED, broken] = 0.0
        rows[_SENSED, broken] = np.nan
        rows[_GATE, broken] = np.where(rows[_GATE, broken] == 0, Gate.INVALID, rows[_GATE, broken])
    rows[_REST] -= rows[_TRACTION]
    return rows
