"""Estimated grade against the slope of a satellite receiver's altitude, over windows of the way.

A receiver's altitude wanders by metres in a minute, so its slope over 200 m is wrong by a degree or so. How
wrong is seen where the vehicle comes by again, in either direction: two passes see one road and two errors.
The product of one estimate's differences from the altitudes of two passes has the error of the estimate
squared, and of the altitudes' errors only what both passes share.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from common import Column, Estimates, line_through, number
from scipy.spatial import cKDTree
from scipy.stats import bootstrap

#: a pass is another one if it is so much later
APART_S = 300.0
#: and it passes both ends of a window so near, over a way that is as long
NEAR_M = 20.0
#: a window that takes longer has a stop in it, in which a receiver's error wanders on
LONGEST_S = 90.0
#: windows that begin in one square of this size see one place, and count as one in an interval
CELL_M = 500.0
_EARTH_M = 6_371_008.8


class Way(NamedTuple):
    """Where a vehicle was, one row a second, all columns (n,).

    metres: along the way. east_m, north_m: NaN where the position is not known.
    """

    t_s: Column
    metres: Column
    altitude_m: Column
    east_m: Column
    north_m: Column


class Windows(NamedTuple):
    """Slopes over windows of the way as ratios, (n,). begin: row of the way. altitude, estimated: slopes."""

    begin: Column
    t_s: Column
    altitude: Column
    estimated: Column


class GradeCheck(NamedTuple):
    """How grade and altitude agree, in degrees; NaN where there is nothing to compare.

    rms: of the difference over all windows. bias: mean of estimated less altitude's. revisited: as rms, over
    windows with other passes. noise: of the altitude's slope there. rest: what is left of revisited without
    it.
    repeated: scatter of the estimated slope between passes.
    """

    windows: int
    passes: int
    rms: float
    bias: float
    revisited: float
    noise: float
    rest: float
    repeated: float


def way_of(t_s: Column, speed_mps: Column, altitude_m: Column, latitude: Column, longitude: Column) -> Way:
    """Return the way at whole seconds, of columns at the same times. Positions in degrees."""
    ticks = np.arange(np.ceil(t_s[0]), np.floor(t_s[-1]))
    steps = np.diff(t_s) * 0.5 * (np.nan_to_num(speed_mps)[1:] + np.nan_to_num(speed_mps)[:-1])
    metres = np.interp(ticks, t_s, np.concatenate(([0.0], np.cumsum(steps))))
    middle = np.nanmean(latitude) if np.isfinite(latitude).any() else 0.0
    north = np.radians(latitude - middle) * _EARTH_M
    centre = np.nanmean(longitude) if np.isfinite(longitude).any() else 0.0
    east = np.radians(longitude - centre) * _EARTH_M * np.cos(np.radians(middle))
    columns = (np.interp(ticks, t_s, column) for column in (altitude_m, east, north))
    return Way(ticks, metres, *columns)


def windows_of(way: Way, estimates: Estimates, length_m: float) -> Windows:
    """Return the windows without overlap, one after the other, that were driven without a long stop."""
    grade = np.interp(way.t_s, estimates.t_s, estimates.grade)
    last = int(np.floor(way.metres[-1] / length_m))
    edges = np.searchsorted(way.metres, np.arange(last + 1) * length_m)
    rows = []
    for a, b in pairwise(edges):
        if b >= len(way.metres) or way.t_s[b] - way.t_s[a] > LONGEST_S:
            continue
        over_m = way.metres[b] - way.metres[a]
        rise_m = way.altitude_m[b] - way.altitude_m[a]
        climbed_m = np.trapezoid(grade[a : b + 1], way.metres[a : b + 1])
        if over_m > 0.8 * length_m and np.isfinite(rise_m + climbed_m):
            rows.append((a, way.t_s[a], rise_m / over_m, climbed_m / over_m))
    return Windows(*np.array(rows, float).reshape(-1, 4).T)


class Passes(NamedTuple):
    """Slopes of one window in every pass over it, its own first; up is positive in the window's direction.

    direction: 1 as the window itself, -1 against it.
    """

    altitude: Column
    estimated: Column
    direction: Column


def passes_of(way: Way, estimates: Estimates, windows: Windows, length_m: float) -> list[Passes]:
    """Return for every window all passes over it, in both directions."""
    grade = np.nan_to_num(np.interp(way.t_s, estimates.t_s, estimates.grade))
    steps = np.diff(way.metres) * 0.5 * (grade[1:] + grade[:-1])
    climbed_m = np.concatenate(([0.0], np.cumsum(steps)))
    places = np.column_stack((way.east_m, way.north_m))
    known = np.flatnonzero(np.isfinite(places.sum(axis=1) + way.altitude_m))
    tree = cKDTree(places[known]) if len(known) else None
    found = []
    for a, altitude, estimated in zip(
        windows.begin.astype(int), windows.altitude, windows.estimated, strict=True
    ):
        b = int(np.searchsorted(way.metres, way.metres[a] + length_m))
        rows = [(altitude, estimated, 1.0)]
        if tree is not None and np.isfinite(places[[a, b]]).all():
            ends = [known[tree.query_ball_point(places[k], NEAR_M)] for k in (a, b)]
            for sign, (first, last) in ((1.0, ends), (-1.0, ends[::-1])):
                for i, j in _passes(way, a, first, last, length_m):
                    over_m = sign * (way.metres[j] - way.metres[i])
                    rise_m, climb_m = way.altitude_m[j] - way.altitude_m[i], climbed_m[j] - climbed_m[i]
                    rows.append((rise_m / over_m, climb_m / over_m, sign))
        found.append(Passes(*np.array(rows).T))
    return found


def _passes(way: Way, a: int, begins: Column, ends: Column, length_m: float) -> list[tuple[int, int]]:
    """Return the first and last row of each pass from one end to the other, other than the one at row a."""
    found: list[tuple[int, int]] = []
    last_s = -np.inf
    for begin in sorted(begins):
        t_s = way.t_s[begin]
        if min(abs(t_s - way.t_s[a]), t_s - last_s) < APART_S:
            continue
        off_m = np.abs(way.metres[ends] - way.metres[begin] - length_m)
        fits = (off_m < 2 * NEAR_M) & (way.t_s[ends] > t_s) & (way.t_s[ends] < t_s + LONGEST_S)
        if fits.any():
            found.append((int(begin), int(ends[np.where(fits, off_m, np.inf).argmin()])))
            last_s = t_s
    return found


def grade_against_altitude(ways: Iterable[tuple[Way, Estimates]], length_m: float) -> GradeCheck:
    """Compare the slopes of all drives, and remove the altitude's own error where it is seen."""
    every, again, noise, repeated, passes = [], [], [], [], 0
    for way, estimates in ways:
        windows = windows_of(way, estimates, length_m)
        for p in passes_of(way, estimates, windows, length_m):
            miss = p.estimated[0] - p.altitude[0]
            every.append(miss)
            if len(p.altitude) > 1:
                passes += len(p.altitude) - 1
                again.append(miss)
                # n passes see one road: their scatter about their mean is the error of each
                noise.append(np.var(p.altitude, ddof=1))
                repeated.append(np.var(p.estimated, ddof=1))
    rms, revisited = _rms(np.square(every)), _rms(np.square(again))
    own, repeat = _rms(noise), _rms(repeated)
    rest = float(np.sqrt(max(revisited**2 - own**2, 0.0))) if again else np.nan
    bias = float(np.mean(every)) if every else np.nan
    degrees = (float(np.degrees(np.arctan(v))) for v in (rms, bias, revisited, own, rest, repeat))
    return GradeCheck(len(every), passes, *degrees)


class RevisitCheck(NamedTuple):
    """What passes over the same windows say of the estimate, in degrees but for the gain; NaN for nothing.

    left: error of the estimate and what the altitudes of all passes share, from all pairs of passes; low,
    high: its 90 % interval. same, opposite: the same from pairs of one direction, and of both.
    repeated_same, repeated_opposite: scatter of the estimate between passes. gain, offset: altitude's mean
    slope over the estimated one.
    """

    left: float
    low: float
    high: float
    same: float
    opposite: float
    repeated_same: float
    repeated_opposite: float
    gain: float
    offset: float


def check_revisits(ways: Iterable[tuple[Way, Estimates]], length_m: float) -> RevisitCheck:
    """Compare the estimates of all drives with the altitudes of all passes over the same windows."""
    products, cells, points = [], [], []
    same: tuple[list[float], list[float]] = ([], [])
    opposite: tuple[list[float], list[float]] = ([], [])
    for way, estimates in ways:
        windows = windows_of(way, estimates, length_m)
        passes = passes_of(way, estimates, windows, length_m)
        for a, p in zip(windows.begin.astype(int), passes, strict=True):
            n = len(p.altitude)
            if n < 2:
                continue
            miss = p.estimated[0] - p.altitude
            products.append((miss.sum() ** 2 - (miss**2).sum()) / (n * (n - 1)))
            cells.append((way.east_m[a] // CELL_M, way.north_m[a] // CELL_M))
            points.append((p.estimated[0], p.altitude.mean()))
            for found, sign in ((same, 1.0), (opposite, -1.0)):
                others = np.flatnonzero(p.direction[1:] == sign) + 1
                if len(others):
                    found[0].append(miss[0] * miss[others].mean())
                    found[1].append(np.mean((p.estimated[0] - p.estimated[others]) ** 2) / 2)
    if not products:
        return RevisitCheck(*[np.nan] * 9)
    line = line_through(*np.array(points).T)
    slopes = (_root(products), *_interval(products, cells), _root(same[0]), _root(opposite[0]),
              _root(same[1]), _root(opposite[1]))  # fmt: skip
    *degrees, offset = (float(np.degrees(np.arctan(v))) for v in (*slopes, line.intercept))
    return RevisitCheck(*[*degrees, line.slope, offset])


def _root(squares: Any) -> float:
    """Return the root of a mean that noise may make negative (then 0)."""
    return float(np.sqrt(max(np.mean(squares), 0.0))) if len(squares) else np.nan


def _interval(products: Sequence[float], cells: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the 90 % interval of the root of the mean, with whole places drawn anew."""
    place = np.unique(np.array(cells), axis=0, return_inverse=True)[1].reshape(-1)
    sums, counts = np.bincount(place, weights=products), np.bincount(place)
    if len(sums) < 3:
        return np.nan, np.nan

    def mean(total: Column, count: Column, axis: int = -1) -> Column:
        return np.asarray(total.sum(axis=axis) / count.sum(axis=axis))

    found = bootstrap((sums, counts), mean, paired=True, confidence_level=0.9, method="percentile",
                      random_state=np.random.default_rng(1))  # fmt: skip
    low, high = found.confidence_interval
    return _root([low]), _root([high])


REVISIT_HEADER = (
    "method",
    "left, all pairs of passes",
    "90 % interval",
    "one direction",
    "both directions",
    "scatter of the estimate, one direction",
    "both directions",
    "altitude's slope per estimated",
)


def rows_of_revisits(checks: dict[str, RevisitCheck]) -> list[Sequence[str]]:
    """Return a table row for each method."""
    return [
        (name, number(c.left, 2), f"{number(c.low, 2)} to {number(c.high, 2)}", number(c.same, 2),
         number(c.opposite, 2), number(c.repeated_same, 2), number(c.repeated_opposite, 2),
         f"{number(c.gain, 2)}, {c.offset:+.2f} degrees")
        for name, c in checks.items()
    ]  # fmt: skip


def _rms(squares: Any) -> float:
    return float(np.sqrt(np.mean(squares))) if len(squares) else np.nan


def rows_of_grades(checks: dict[str, GradeCheck]) -> list[Sequence[str]]:
    """Return a table row for each method."""
    return [(name, f"{c.windows:,}", *(number(v, 2) for v in c[2:])) for name, c in checks.items()]


GRADE_HEADER = (
    "method",
    "windows",
    "RMS",
    "mean",
    "RMS where passed again",
    "altitude's own error",
    "left",
    "scatter of the estimate between passes",
)
