"""A road map as a sensor, while this drive does not contradict it (docs/theory.md, section 4.6)."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.estimators.default.model import Window
from canest.estimators.default.report import Report

#: distance between two measurements, and over which the errors of a map are alike, m
CELL_M, ALIKE_M = 25.0, 300.0
#: std of the level of a map, a sine: what its drives have in common; and least of a cell
LEVEL_STD, _LEAST_STD = 4e-4, 6e-4
#: another road differs by this, std
_OTHER_STD = 0.02
#: mean distances after which a right map is wrong, and a wrong one right again, m
_RIGHT_M, _WRONG_M = 10_000.0, 2_000.0
#: a map is used from this probability on, and left below the other
_FIRST, _USED = 0.85, 0.5
#: one cell says no more than this of the map, log likelihood
_MOST = 4.0


class RoadUse(NamedTuple):
    """How the map is used."""

    since_m: float = 0.0  #: since the cell before
    right: float = 0.9  #: probability that the map shows this road
    uses: bool = False  #: this window is given a cell
    trusted: bool = False  #: the map is used
    lost: bool = False  #: it is found wrong now: what was learned with it is in doubt


@jit.kernel
def follow_road(road: RoadUse, given: Report, w: Window, metres: float, late_s: float) -> RoadUse:
    """Return whether the window has a cell, and how well the map agrees with the grade so far.

    metres: since then. late_s: how far what a window shows lies behind the vehicle.
    """
    since_m = road.since_m + metres
    if math.isnan(w.road_sine) or since_m < CELL_M or metres <= 0.0:
        return RoadUse(since_m, road.right, False, road.trusted, False)
    late_m = late_s * max(w.speed_mps, 0.0)  # `given` is the grade of now, the cell that of a window's end
    e = w.road_sine - (given.grade + given.slope_1pm * (min(metres, ALIKE_M) - late_m))
    unseen = min(w.gap_s * max(w.speed_mps, 0.0) / ALIKE_M, 1.0)  # the road may be as another there
    s = given.grade_var + cell_var(w) + unseen * _OTHER_STD * _OTHER_STD
    wide = s + _OTHER_STD * _OTHER_STD
    log_factor = 0.5 * (e * e / wide - e * e / s + math.log(wide / s))
    rest = _RIGHT_M / (_RIGHT_M + _WRONG_M)  # of a map of which nothing is known any more
    right = rest + (road.right - rest) * math.exp(-since_m / _WRONG_M - since_m / _RIGHT_M)
    right = min(max(right, 0.01), 0.99)
    odds = right / (1.0 - right) * math.exp(min(max(log_factor, -_MOST), _MOST))
    right = odds / (1.0 + odds)
    uses = right > (_USED if road.trusted else _FIRST)
    return RoadUse(0.0, right, uses, uses, road.trusted and not uses)


@jit.kernel
def cell_var(w: Window) -> float:
    """Return the variance of a cell that may count as independent of its neighbours."""
    std = max(w.road_std, _LEAST_STD)
    return std * std * ALIKE_M / CELL_M
