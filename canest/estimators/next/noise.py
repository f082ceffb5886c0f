"""Noise levels, followed from the innovations; and the force that the model lacks."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.estimators.next.constants import Constants, Vehicle
from canest.estimators.next.windows import WINDOW_S

_STEP_STD = math.sqrt(12.0)


class Levels(NamedTuple):
    """Noise levels and what they follow."""

    speed_var: float
    sensed_var: float
    windows: float
    nis_sum: float
    ringing_N2: float


class Innovations(NamedTuple):
    """What the innovations of one window say, mean over the hypotheses."""

    nis: float
    speed_surplus: float
    sensed_surplus: float


@jit.kernel
def unknown_force(traction: float, moved: float, step: float, drag: float, c: Constants) -> float:
    """Return the density of the force that the model lacks, N2 s."""
    lasts_s = min(max(_STEP_STD * step / max(moved, 1.0), 1.0), c.longest_windows) * WINDOW_S
    lacking = c.force_share * traction if traction > 0.0 else -c.overrun_share * traction
    gust = c.gust_mps * drag
    return lacking * lacking * c.force_s + step * step * lasts_s + 2.0 * gust * gust * c.gust_s


@jit.kernel
def surplus(e: float, s: float, r: float, doubted: float, outlier: float) -> float:
    """Return e^2 - s, outliers cut, less where s is mostly the states' own uncertainty."""
    share = min(doubted * r / s, 1.0)
    return share * (min(e * e, outlier * s) - s)


@jit.kernel
def follow(levels: Levels, found: Innovations, changed_N: float, is_open: bool, sees: bool, c: Constants, v: Vehicle) -> Levels:
    """Return the levels after a window."""
    speed_var, sensed_var, windows, nis_sum, ringing = levels
    if is_open:
        windows += 1.0
        nis_sum += found.nis
        ringing = c.ringing * ringing + changed_N * changed_N
        memory = min(c.windows, c.first_windows + windows)
        floor, loudest = v.speed_floor_mps, v.speed_loudest_mps
        speed_var = min(max(speed_var + found.speed_surplus / memory, floor * floor), loudest * loudest)
        if sees:
            floor = v.sensed_floor_mps2
            sensed_var = max(sensed_var + found.sensed_surplus / memory, floor * floor)
    return Levels(speed_var, sensed_var, windows, nis_sum, ringing)
