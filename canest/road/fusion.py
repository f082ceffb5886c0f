"""One grade per cell out of many visits: weighted least squares with an offset of each vehicle and track.

    y = g[cell] + b[vehicle] + c[track] + e

y is the sine of the slope that a drive estimated, b and c are what a wrong torque, rolling resistance or wind
adds to it everywhere. e is correlated along a track, so the weight of a track's offset is its length over the
correlation length, and not its cells. The mean slope of a track by its altitude measures b + c.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import CanestError
from canest.core.frames import FloatColumn, IntColumn
from canest.road.network import CELL_M, Visits

# All chosen; sines of slopes.
VEHICLE_STD = 0.0005  #: offset of a vehicle: its rolling resistance
TRACK_STD = 0.001  #: offset of a track: wind, load, weather
LEAST_STD = 0.0003  #: what all visits of a cell have in common: how late a causal estimate follows
CORRELATED_M = 300.0  #: along a track
ALTITUDE_STD_M = 4.0  #: of satellite altitudes, which wander ...
ALTITUDE_CORRELATED_M = 1500.0  #: ... so slowly
SHORTEST_M = 3000.0  #: a track this short has no offset from its altitudes
_ROUNDS = 8
_CUT = 2.5  #: a residual of so many stds counts half (Cauchy)
_LEAST_POINTS = 10  #: with an altitude, for a line through them
_LEAST_SHARED = 100  #: visits of cells with another visit, for a median of their residuals
_MAD_TO_STD = 1.4826  #: of a normal distribution
_SCALES = (0.5, 3.0)  #: bounds of the residuals over the visits' own std
_TINY = 1e-300  #: keeps a quotient finite where its numerator is 0
_MOST_OFFSETS = 6000
#: two groups of visits to a cell are two roads where they differ by all of these
_APART_STDS, _APART_SINE, _APART_M = 4.0, 0.008, 8.0


class Fused(NamedTuple):
    """What is known per cell, columns (cells,); NaN and 0 where nothing is.

    stacked: visits fall into two groups, as on two levels. offset: per track.
    """

    sine: FloatColumn
    std: FloatColumn
    passes: IntColumn
    stacked: NDArray[np.bool_]
    offset: FloatColumn


def fuse(visits: Visits, cells: int, vehicle: IntColumn) -> Fused:
    """Return the cells of visits. vehicle: of each track (tracks,).

    Errors: CanestError for too many tracks.
    """
    tracks = len(vehicle)
    vehicles = int(vehicle.max()) + 1 if tracks else 0
    if tracks + vehicles > _MOST_OFFSETS:
        raise CanestError(
            "too many drives at once",
            found=f"{tracks} pieces of drives",
            expected=f"up to {_MOST_OFFSETS - vehicles}",
        )
    usable = np.isfinite(visits.sine) & np.isfinite(visits.std)
    columns: list[Any] = [column[usable] for column in visits]
    v = Visits(*columns)
    var = np.square(v.std)
    prior, expected = _offset_information(visits, vehicle, vehicles)
    offset, cov = np.zeros(tracks), np.zeros((vehicles + tracks, vehicles + tracks))
    weight = 1.0 / var
    sine = _mean(v, weight, offset, cells)
    for _ in range(_ROUNDS):
        offset, cov = _offsets(v, weight * CELL_M / CORRELATED_M, vehicle, cells, prior, expected)
        sine = _mean(v, weight, offset, cells)
        residual = v.sine - offset[v.track] - sine[v.cell]
        share = _scale(residual, var, v, cells)
        weight = 1.0 / (var * share**2 * (1.0 + np.square(residual / (_CUT * share)) / var))
    passes = np.bincount(v.cell, minlength=cells)
    total = np.bincount(v.cell, weight, cells)
    spread = np.bincount(v.cell, weight * np.square(v.sine - offset[v.track] - sine[v.cell]), cells)
    birge = np.maximum(1.0, spread / np.maximum(passes - 1, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        own = birge / total
    level = _level_var(v, weight / np.maximum(total, _TINY)[v.cell], vehicle, cov, cells)
    std = np.sqrt(own + level + LEAST_STD**2)
    stacked = _stacked(v, v.sine - offset[v.track], np.sqrt(var), cells)
    return Fused(sine, np.where(passes > 0, std, np.nan), passes, stacked, offset)


def _offset_information(visits: Visits, vehicle: IntColumn, vehicles: int) -> tuple[Any, FloatColumn]:
    """Return the information matrix and vector of the offsets before any comparison of tracks."""
    tracks = len(vehicle)
    information = np.diag(
        np.concatenate([np.full(vehicles, VEHICLE_STD**-2), np.full(tracks, TRACK_STD**-2)])
    )
    vector = np.zeros(vehicles + tracks)
    begins = np.searchsorted(visits.track, np.arange(tracks + 1))
    for k in range(tracks):
        part = slice(begins[k], begins[k + 1])
        measured = _by_altitude(visits.way_m[part], visits.sine[part], visits.altitude_m[part])
        if measured is None:
            continue
        off, var = measured
        both = np.array([int(vehicle[k]), vehicles + k])
        information[np.ix_(both, both)] += 1.0 / var
        vector[both] += off / var
    return information, vector


def _by_altitude(
    way_m: FloatColumn, sine: FloatColumn, altitude_m: FloatColumn
) -> tuple[float, float] | None:
    """Return by how much altitudes find a track's slopes too high, and the variance; None if unknown."""
    known = np.isfinite(sine) & np.isfinite(altitude_m)
    if np.count_nonzero(known) < _LEAST_POINTS:
        return None
    way, sine, altitude = way_m[known], sine[known], altitude_m[known]
    steps = np.diff(way)
    if steps.max() > 4 * CELL_M:  # what was climbed there is not known
        return None
    length = float(way[-1] - way[0])
    if length < SHORTEST_M:
        return None
    climbed = np.concatenate([[0.0], np.cumsum(0.5 * (sine[1:] + sine[:-1]) * steps)])
    off = float(np.polyfit(way, climbed - altitude, 1)[0])
    var = 12.0 * ALTITUDE_STD_M**2 / (length**2 * max(length / ALTITUDE_CORRELATED_M, 1.0))
    return off, var


def _offsets(
    v: Visits, weight: FloatColumn, vehicle: IntColumn, cells: int, prior: Any, vector: FloatColumn
) -> tuple[FloatColumn, Any]:
    """Return each track's offset, that of its vehicle included, and the covariance of all.

    The grades of the cells are eliminated: H = A'WA - A'WG (G'WG)^-1 G'WA.
    """
    from scipy import sparse  # only a map is built with it

    n, vehicles = len(v.cell), len(vector) - len(vehicle)
    rows = np.arange(n)
    a = sparse.csr_matrix(
        (np.ones(2 * n), (np.tile(rows, 2), np.concatenate([vehicle[v.track], vehicles + v.track]))),
        shape=(n, len(vector)),
    )
    g = sparse.csr_matrix((np.ones(n), (rows, v.cell)), shape=(n, cells))
    weighted = sparse.diags(weight)
    total = np.bincount(v.cell, weight, cells)
    inverse = sparse.diags(np.divide(1.0, total, out=np.zeros(cells), where=total > 0.0))
    cross = g.T @ weighted @ a
    information = prior + (a.T @ weighted @ a - cross.T @ inverse @ cross).toarray()
    mean = inverse @ (g.T @ (weight * v.sine))
    right = vector + a.T @ (weight * (v.sine - mean[v.cell]))
    cov = np.linalg.inv(information)
    found = cov @ right
    return found[vehicle] + found[vehicles:], cov


def _mean(v: Visits, weight: FloatColumn, offset: FloatColumn, cells: int) -> FloatColumn:
    """Return the weighted mean of each cell (cells,), NaN without a visit."""
    total = np.bincount(v.cell, weight, cells)
    summed = np.bincount(v.cell, weight * (v.sine - offset[v.track]), cells)
    mean: FloatColumn = np.divide(summed, total, out=np.full(cells, np.nan), where=total > 0.0)
    return mean


def _scale(residual: FloatColumn, var: FloatColumn, v: Visits, cells: int) -> float:
    """Return the visits' std as a share of what they claim, by the median residual; 1 where there are few."""
    passes = np.bincount(v.cell, minlength=cells)[v.cell]
    several = passes > 1
    if np.count_nonzero(several) < _LEAST_SHARED:
        return 1.0
    freed = np.sqrt(passes[several] / (passes[several] - 1.0))
    normed = np.abs(residual[several]) * freed / np.sqrt(var[several])
    return float(np.clip(_MAD_TO_STD * np.median(normed), *_SCALES))


def _level_var(v: Visits, share: FloatColumn, vehicle: IntColumn, cov: Any, cells: int) -> FloatColumn:
    """Return the variance that the offsets leave in each cell (cells,). share: of each visit in its cell."""
    from scipy import sparse  # only a map is built with it

    vehicles = len(cov) - len(vehicle)
    columns = np.concatenate([vehicle[v.track], vehicles + v.track])
    mix = sparse.csr_matrix((np.tile(share, 2), (np.tile(v.cell, 2), columns)), shape=(cells, len(cov)))
    return np.asarray(mix.multiply(mix @ cov).sum(axis=1)).ravel()


def _stacked(v: Visits, sine: FloatColumn, std: FloatColumn, cells: int) -> NDArray[np.bool_]:
    """Return the cells whose visits fall into two groups, by grade or altitude, of two or more each."""
    found = np.zeros(cells, np.bool_)
    order = np.argsort(v.cell, kind="stable")
    begins = np.searchsorted(v.cell[order], np.arange(cells + 1))
    for cell in np.flatnonzero(np.diff(begins) >= 4):
        at = order[begins[cell] : begins[cell + 1]]
        by_slope = _two_groups(sine[at], float(np.median(std[at])), _APART_SINE)
        found[cell] = by_slope or _two_groups(v.altitude_m[at], 0.0, _APART_M)
    return found


def _two_groups(values: FloatColumn, std: float, least: float) -> bool:
    """Return whether values part into two groups of two or more, far apart for their own spread."""
    values = np.sort(values[np.isfinite(values)])
    if len(values) < 4:
        return False
    gaps = np.diff(values)[1:-1]
    cut = int(np.argmax(gaps)) + 2
    low, high = values[:cut], values[cut:]
    spread = max(std, float(low.std()), float(high.std()))
    return bool(gaps[cut - 2] > max(least, _APART_STDS * spread))
