"""Quiet windows are joined: while nothing happens, five of them say as much as one five times as long.

A window is quiet where the torque stands still and the speed goes on as the model said: its end is not worth
an update. Sums over the windows stay exact, so a joined window balances momentum as its parts would.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.model import WINDOW_S, Window


class Quiet(NamedTuple):
    """What the next window is held against, and the windows that wait."""

    speed_mps: float = 0.0  #: at the end of the last update
    accel_mps2: float = 0.0  #: by the model there
    traction_N: float = 0.0  #: there
    last_mps: float = math.nan  #: speed and rate of the traction at the end of the last window, if any
    last_Nps: float = 0.0
    before_mps: float = 0.0  #: and of the one before it
    before_Nps: float = 0.0
    joined: float = 0.0  #: windows that wait; their sums:
    distance_m: float = 0.0
    force_N: float = 0.0
    roll_mps2: float = 0.0
    accels_mps2: float = 0.0
    drag_N_per_mps: float = 0.0
    sensed_mps2: float = 0.0
    altitude_m: float = math.nan  #: the latest of them


@jit.kernel
def begin_sums(w: Window, accel_mps2: float) -> Quiet:
    """Return empty sums after an update with a window. accel_mps2: by the model."""
    return Quiet(
        w.speed_mps, accel_mps2, w.traction_N, w.speed_mps, w.traction_Nps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 0.0, math.nan,
    )  # fmt: skip


@jit.kernel
def add_window(q: Quiet, w: Window, begins: bool) -> Quiet:
    """Return the sums with one more window. What was closed before it is no part of a balance of forces."""
    kept = 0.0 if begins or w.retarding > 0.0 or w.coarse > 0.0 else 1.0
    return Quiet(
        q.speed_mps, q.accel_mps2, q.traction_N, w.speed_mps, w.traction_Nps, q.last_mps, q.last_Nps,
        kept * q.joined + 1.0,
        q.distance_m + w.distance_m, kept * q.force_N + w.force_N, kept * q.roll_mps2 + w.roll_mps2,
        kept * q.accels_mps2 + w.accel_mps2, kept * q.drag_N_per_mps + w.drag_N_per_mps,
        (kept * q.sensed_mps2 if kept > 0.0 else 0.0) + w.sensed_mps2,
        q.altitude_m if math.isnan(w.altitude_m) else w.altitude_m,
    )  # fmt: skip


@jit.kernel
def waits(q: Quiet, w: Window, was_open: bool, u: float, speed_var: float, c: Constants, v: Vehicle) -> bool:
    """Return whether a window, the last of the sums, waits for the next. u: inverse mass.

    Between two reports of a slow signal there is a line: only at its end is anything measured.
    """
    if w.gap_s > 0.0 or not math.isnan(w.coast_mps2):
        return False
    if w.open > 0.0:
        if not was_open:
            return False
        if q.joined < v.period_windows:
            return True
        elapsed_s = q.joined * WINDOW_S
        off = abs(w.speed_mps - q.speed_mps - q.accel_mps2 * elapsed_s)
        steady = abs(w.traction_N - q.traction_N) * u < c.quiet_mps2
        expected = off < c.quiet_mps2 * elapsed_s + 3.0 * math.sqrt(2.0 * speed_var)
        return q.joined < c.most_joined_windows and steady and expected
    if was_open or w.retarding > 0.0 or w.coarse > 0.0:
        return False
    return w.stopped > 0.0 or q.joined < c.most_joined_windows


@jit.kernel
def join(q: Quiet, w: Window) -> Window:
    """Return the windows that waited as one: sums and means of all, the ends of the last."""
    n = q.joined
    return Window(
        w.gap_s, q.distance_m, q.traction_N if n > 1.0 else w.begin_N, w.speed_mps, q.force_N / n,
        w.traction_N, w.traction_Nps, q.roll_mps2 / n, q.accels_mps2 / n, q.drag_N_per_mps / n, w.gear_1pm,
        w.rotating_kg, q.sensed_mps2 / n, q.altitude_m, w.open, w.retarding, w.stopped, w.coarse, w.bend_mps2,
        w.road_sine, w.road_std, w.coast_mps2, w.coast_var, w.coast_N, w.coast_kg, w.coast_back_s,
    )  # fmt: skip
