"""Drives to a map: tracks, cells, one grade for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.road.fusion import fuse
from canest.road.network import Network, Visits
from canest.road.sphere import headings_of, positions_of
from canest.road.table import RoadMap
from canest.road.tracks import Drive, tracks_of

DRIVES, PIECES, CELLS = "drives", "pieces of them", "cells of 25 m"
STACKED, UNKNOWN, SELDOM = (
    "cells of stacked roads left out",
    "cells without a grade",
    "cells with too few passes",
)


def build_map(drives: Iterable[Drive], *, least_passes: int = 1) -> RoadMap:
    """Return the map of drives, in their order. least_passes: cells with fewer are left out.

    Errors: CanestError for too many drives.
    """
    counts: Counter[str] = Counter()
    network = Network()
    vehicles: dict[str, int] = {}
    of_track: list[int] = []
    days: list[float] = []
    for drive in drives:
        counts[DRIVES] += 1
        for track in tracks_of(drive, counts):
            network.add(track)
            of_track.append(vehicles.setdefault(drive.vehicle, len(vehicles)))
            days.append(drive.day)
    counts[PIECES] = network.tracks
    return _map(network, np.array(of_track, np.int64), np.array(days), counts, least_passes)


def _map(
    network: Network, vehicle: IntColumn, days: FloatColumn, counts: Counter[str], least_passes: int
) -> RoadMap:
    visits, cells = network.visits(), len(network.points)
    fused = fuse(visits, cells, vehicle)
    points = np.stack([_means(visits, visits.points[:, k], cells) for k in range(3)], axis=1)
    latitude, longitude = positions_of(points)
    day = days[visits.track] if len(days) else np.empty(0)
    road = RoadMap(
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_m=_means(visits, visits.altitude_m, cells),
        heading_deg=headings_of(points, network.directions),
        next=network.successors(),
        grade=np.tan(np.arcsin(np.clip(fused.sine, -0.5, 0.5))),
        grade_std=fused.std,
        passes=fused.passes,
        vehicles=_distinct(visits, vehicle, cells),
        first_day=_extreme(visits, day, cells, np.fmin),
        last_day=_extreme(visits, day, cells, np.fmax),
        counts=counts,
    )
    unknown = (fused.passes == 0) & ~fused.stacked
    seldom = (fused.passes < least_passes) & ~unknown & ~fused.stacked
    counts[STACKED], counts[UNKNOWN] = int(fused.stacked.sum()), int(unknown.sum())
    counts[SELDOM] = int(seldom.sum())
    road = road.selected(~(unknown | seldom | fused.stacked))
    counts[CELLS] = len(road)
    return road


def _means(visits: Visits, values: FloatColumn, cells: int) -> FloatColumn:
    known = np.isfinite(values)
    number = np.bincount(visits.cell[known], minlength=cells)
    total = np.bincount(visits.cell[known], values[known], cells)
    mean: FloatColumn = np.divide(total, number, out=np.full(cells, np.nan), where=number > 0)
    return mean


def _distinct(visits: Visits, vehicle: IntColumn, cells: int) -> IntColumn:
    pairs = (
        np.unique(np.stack([visits.cell, vehicle[visits.track]]), axis=1)
        if len(vehicle)
        else np.empty((2, 0))
    )
    return np.bincount(pairs[0].astype(np.int64), minlength=cells)


def _extreme(visits: Visits, values: FloatColumn, cells: int, better: np.ufunc) -> FloatColumn:
    found = np.full(cells, np.nan)
    better.at(found, visits.cell, values)
    return found
