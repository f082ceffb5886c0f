"""A road map as a sensor: the slope that earlier drives found here, while this drive does not contradict it.

    z = theta - rho + noise

theta: apparent grade, rho: error of the rolling resistance, with which the level of the map is lumped. The
errors of neighbouring cells are alike, so a cell's variance is raised until cells may count as independent.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.default.hypotheses import Filters
from canest.estimators.default.model import GRADE, MODES, ROLLING, Window
from canest.estimators.default.predict import Matrix, Vector
from canest.estimators.default.update import condition_on, log_likelihood

#: distance between two measurements, and over which the errors of a map are alike, m
CELL_M, ALIKE_M = 25.0, 300.0
#: std of the level of a map, a sine: what its drives have in common
LEVEL_STD = 4e-4
#: no cell is better known than this
_LEAST_STD = 6e-4
#: another road differs by this, std
_OTHER_STD = 0.02
#: mean distances after which a right map is wrong, and a wrong one right again, m
_RIGHT_M, _WRONG_M = 10_000.0, 2_000.0
#: probability that a map is right where it begins; the first cell needs `_FIRST`, the others `_USED`
_BEGIN, _FIRST, _USED = 0.9, 0.85, 0.5
#: one cell says no more than this of the map, log likelihood
_MOST = 4.0
_SLOPE = (GRADE, ROLLING)


class RoadUse(NamedTuple):
    """How the map is used."""

    since_m: float = 0.0  #: since the cell before
    right: float = _BEGIN  #: probability that the map shows this road
    uses: float = 0.0  #: 1 where this window is given a cell
    used: float = 0.0  #: cells used since the map was last found wrong
    lost: float = 0.0  #: 1 where it is found wrong now: what was learned with it is in doubt


@jit.kernel
def follow_road(road: RoadUse, filters: Filters, w: Window, metres: float) -> RoadUse:
    """Return whether the window has a cell, and how well the map agrees with all hypotheses so far."""
    since_m = road.since_m + metres
    if math.isnan(w.road_sine):
        return RoadUse(min(since_m, CELL_M), road.right, 0.0, road.used, 0.0)
    if since_m < CELL_M or metres <= 0.0:
        return RoadUse(since_m, road.right, 0.0, road.used, 0.0)
    r = cell_var(w)
    expected = other = 0.0
    for k in range(len(filters.weight)):
        if filters.weight[k] > 0.0:
            for m in range(MODES):
                share = filters.weight[k] * filters.mode[k][m]
                if share > 0.0:
                    e, s = slope_innovation(filters.x[k][m], filters.P[k][m], w.road_sine, r)
                    expected += share * math.exp(-0.5 * min(e * e / s, 80.0)) / math.sqrt(s)
                    wide = s + _OTHER_STD * _OTHER_STD
                    other += share * math.exp(-0.5 * min(e * e / wide, 80.0)) / math.sqrt(wide)
    right = road.right + (1.0 - road.right) * since_m / _WRONG_M - road.right * since_m / _RIGHT_M
    right = min(max(right, 0.01), 0.99)
    found = -_MOST
    if expected > 0.0 and other > 0.0:
        found = min(max(math.log(expected / other), -_MOST), _MOST)
    odds = right / (1.0 - right) * math.exp(found)
    right = odds / (1.0 + odds)
    if right > (_USED if road.used > 0.0 else _FIRST):
        return RoadUse(0.0, right, 1.0, road.used + 1.0, 0.0)
    return RoadUse(0.0, right, 0.0, 0.0, 1.0 if road.used > 0.0 else 0.0)


@jit.kernel
def cell_var(w: Window) -> float:
    """Return the variance of a cell that may count as independent of its neighbours."""
    std = max(w.road_std, _LEAST_STD)
    return std * std * ALIKE_M / CELL_M


@jit.kernel
def slope_innovation(x: Vector, P: Matrix, sine: float, r: float) -> tuple[float, float]:
    """Return e and s of the slope theta - rho."""
    e = sine - (x[GRADE] - x[ROLLING])
    s = P[GRADE][GRADE] - 2.0 * P[GRADE][ROLLING] + P[ROLLING][ROLLING] + r
    return e, max(s, r)


@jit.kernel
def known_slope(x: Vector, P: Matrix, h: Any, K: Any, w: Window, outlier: float) -> float:
    """Update with the slope of the map; return the log likelihood."""
    h[0], h[1] = 1.0, -1.0
    e, s = condition_on(x, P, _SLOPE, h, w.road_sine, cell_var(w), outlier, K)
    found: float = log_likelihood(e, s, outlier)
    return found
