"""Windows that are joined: between two reports of a slow signal, or at rest (docs/theory.md, section 3.2)."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.estimators.default.constants import Vehicle
from canest.estimators.default.model import Window
from canest.estimators.windowing import WINDOW_S

#: a vehicle that goes slower, and no faster from second to second, creeps, as a tipper before a paver does
_CREEPS_MPS, _STEADY_MPS2 = 2.0, 0.3


class Joined(NamedTuple):
    """The windows since the last update; what they sum up to, and what their ends were."""

    windows: float = 0.0
    seconds: float = 0.0  #: of all that waited, missing time included
    begin_N: float = 0.0  #: traction where they begin
    last_mps: float = math.nan  #: speed at the end of the last window, if any
    before_mps: float = 0.0  #: and of the one before it
    distance_m: float = 0.0  #: sums from here on
    force_N: float = 0.0
    roll_mps2: float = 0.0
    accels_mps2: float = 0.0
    drag_N_per_mps: float = 0.0
    sensed_mps2: float = 0.0
    altitude_m: float = math.nan  #: the latest of them
    unseen_s: float = 0.0  #: standing, creeping and missing time since the load was last taken up


@jit.kernel
def begin_sums(speed_mps: float, unseen_s: float) -> Joined:
    """Return empty sums after an update. speed_mps: at its end. unseen_s: what is left of that time."""
    return Joined(0.0, 0.0, 0.0, speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, unseen_s)


@jit.kernel
def creeps(w: Window) -> bool:
    """Return whether the vehicle moves so slowly that nothing is learned, and it may be loaded meanwhile."""
    return w.open == 0.0 and w.speed_mps < _CREEPS_MPS and abs(w.accel_mps2) < _STEADY_MPS2


@jit.kernel
def add_window(q: Joined, w: Window, speed_mps: float, begins: bool) -> Joined:
    """Return the sums with one more window, at whose end the speed is `speed_mps`.

    What was closed before it is no part of a balance of forces.
    """
    hidden = w.retarding > 0.0 or w.coarse > 0.0 or (w.open == 0.0 and w.stopped == 0.0)
    kept = 0.0 if begins or hidden else 1.0
    goes_on = kept * q.windows > 0.0
    return Joined(
        kept * q.windows + 1.0, q.seconds + WINDOW_S + w.gap_s, q.begin_N if goes_on else w.begin_N,
        speed_mps, q.last_mps,
        q.distance_m + w.distance_m, kept * q.force_N + w.force_N, kept * q.roll_mps2 + w.roll_mps2,
        kept * q.accels_mps2 + w.accel_mps2, kept * q.drag_N_per_mps + w.drag_N_per_mps,
        (kept * q.sensed_mps2 if kept > 0.0 else 0.0) + w.sensed_mps2,
        q.altitude_m if math.isnan(w.altitude_m) else w.altitude_m,
        q.unseen_s + w.gap_s + (WINDOW_S if w.stopped > 0.0 or creeps(w) else 0.0),
    )  # fmt: skip


@jit.kernel
def tells_coasting(w: Window, v: Vehicle) -> bool:
    """Return whether a coasting has ended in a window; between two reports of a slow signal nobody knows."""
    return v.period_windows <= 1.0 and not math.isnan(w.coast_mps2)


@jit.kernel
def waits(q: Joined, w: Window, was_open: bool, v: Vehicle) -> bool:
    """Return whether a window, the last of the sums, waits for the next."""
    if w.gap_s > 0.0 or tells_coasting(w, v):
        return False
    if w.open > 0.0:
        return was_open and q.windows < v.period_windows
    return w.stopped > 0.0 and not was_open and w.retarding == 0.0 and w.coarse == 0.0


@jit.kernel
def join(q: Joined, w: Window) -> Window:
    """Return the windows that waited as one: sums and means of all, the ends of the last."""
    n = q.windows
    return Window(
        q.distance_m, q.begin_N, q.force_N / n, q.roll_mps2 / n, q.accels_mps2 / n, q.drag_N_per_mps / n,
        q.sensed_mps2 / n, q.altitude_m, w.gap_s, w.speed_mps, w.traction_N, w.undriven_mps, w.gear_1pm,
        w.rotating_kg, w.open, w.retarding, w.stopped, w.coarse, w.bend_mps2, w.zigzag_Nm2s, w.road_sine,
        w.road_std, w.coast_mps2, w.coast_var, w.coast_N, w.coast_kg, w.coast_back_s,
    )  # fmt: skip
