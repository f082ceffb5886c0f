"""The cells of the roads: every 25 m along the first drive of a road, and when later drives pass them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, IntColumn
from canest.road.sphere import Points
from canest.road.tracks import STEP_M, Track

CELL_M = 25.0
_SIDE_M = 15.0  #: a track this far beside a cell is on another road
_NEAR_M = 30.0  #: how far cells are looked for
_TURNED = float(np.cos(np.radians(45.0)))  #: another direction is another road
#: cells of two roads are level within this: more than half a cell, less than to the next of one road
_LEVEL_M = 15.0
_COVERED_M = 17.0  #: a cell stands for the road before and after it
_AGAIN_M = 100.0  #: driven between two visits of one cell
_LINKED_M = 60.0  #: cells that follow each other lie nearer


class Visits(NamedTuple):
    """Drives over cells, columns (n,) each.

    cell, track: indices. sine: of the slope there, NaN where unknown. std: its standard deviation.
    """

    cell: IntColumn
    track: IntColumn
    way_m: FloatColumn
    sine: FloatColumn
    std: FloatColumn
    altitude_m: FloatColumn
    points: Points


class Network:
    """Grows by the tracks that are added; each is compared with the cells that are there."""

    def __init__(self) -> None:
        self.points: Points = np.empty((0, 3))
        self.directions: Points = np.empty((0, 3))
        self.tracks = 0
        #: (cell, next cell) -> drives that went so
        self.links: Counter[tuple[int, int]] = Counter()
        self._visits: list[Visits] = []
        self._tree: Any = None

    def add(self, track: Track) -> None:
        """Find a track's cells, make those that are missing, and note when it passed each."""
        cells, ways = np.empty(0, np.int64), np.empty(0)
        for part in _stretches(track):
            more, at = self._passed(Track(*(column[part] for column in track)), cells, ways)
            cells, ways = np.concatenate([cells, more]), np.concatenate([ways, at])
        near = np.diff(ways) < _LINKED_M
        self.links.update(zip(cells[:-1][near].tolist(), cells[1:][near].tolist(), strict=True))
        self._visits.append(
            Visits(
                cells, np.full(len(cells), self.tracks), ways,
                np.interp(ways, track.way_m, track.sine), np.interp(ways, track.way_m, track.std),
                np.interp(ways, track.way_m, track.altitude_m),
                np.stack([np.interp(ways, track.way_m, track.points[:, k]) for k in range(3)], axis=1),
            )
        )  # fmt: skip
        self.tracks += 1

    def _passed(
        self, track: Track, before: IntColumn, before_ways: FloatColumn
    ) -> tuple[IntColumn, FloatColumn]:
        """Return the cells of a stretch, made where they are missing, and where on its way they are.

        before, before_ways: those of the stretches before.
        """
        cells, ways, covered = self._matched(track)
        recent = before[before_ways > track.way_m[0] - _AGAIN_M]
        first = ~np.isin(cells, recent)  # where a stretch ends and the next begins, a cell is passed once
        cells, ways = cells[first], ways[first]
        new = self._new_ways(track, np.concatenate([before_ways[-1:], ways]), covered)
        at = np.round((new - track.way_m[0]) / STEP_M).astype(np.int64)
        made = len(self.points) + np.arange(len(new))
        if len(new):
            self.points = np.concatenate([self.points, track.points[at]])
            self.directions = np.concatenate([self.directions, track.directions[at]])
            self._tree = None
        cells, ways = np.concatenate([cells, made]), np.concatenate([ways, track.way_m[at]])
        order = np.argsort(ways, kind="stable")
        return cells[order], ways[order]

    def visits(self) -> Visits:
        """Return all visits in order of their tracks."""
        if not self._visits:
            none, numbers = np.empty(0), np.empty(0, np.int64)
            return Visits(numbers, numbers, none, none, none, none, np.empty((0, 3)))
        return Visits(*(np.concatenate(column) for column in zip(*self._visits, strict=True)))

    def successors(self) -> IntColumn:
        """Return the cell that most drives went to after each (cells,), -1 for none."""
        following = np.full(len(self.points), -1, np.int64)
        most = np.zeros(len(self.points), np.int64)
        for (cell, after), times in sorted(self.links.items()):
            if times > most[cell]:
                following[cell], most[cell] = after, times
        return following

    def _matched(self, track: Track) -> tuple[IntColumn, FloatColumn, NDArray[np.bool_]]:
        """Return the cells that a track passes, where on its way, and which of its points they cover."""
        covered = np.zeros(len(track.way_m), np.bool_)
        nothing = np.empty(0, np.int64), np.empty(0), covered
        if not len(self.points):
            return nothing
        from scipy.spatial import cKDTree  # only a map is built with it

        if self._tree is None:
            self._tree = cKDTree(self.points)
        pairs = cKDTree(track.points).sparse_distance_matrix(self._tree, _NEAR_M, output_type="coo_matrix")
        point, cell = pairs.row.astype(np.int64), pairs.col.astype(np.int64)
        apart = track.points[point] - self.points[cell]
        direction = self.directions[cell]
        along = (apart * direction).sum(axis=1)
        side = np.linalg.norm(apart - along[:, None] * direction, axis=1)
        same = ((track.directions[point] * direction).sum(axis=1) > _TURNED) & (side <= _SIDE_M)
        covered[point[same & (np.abs(along) <= _COVERED_M)]] = True
        passing = np.flatnonzero(same & (np.abs(along) <= STEP_M))
        if not len(passing):
            return nothing
        # per cell and visit the point that comes nearest to being level with it
        order = passing[np.lexsort((track.way_m[point[passing]], cell[passing]))]
        way = track.way_m[point[order]]
        begins = np.ones(len(order), np.bool_)
        begins[1:] = (np.diff(cell[order]) != 0) | (np.diff(way) > _AGAIN_M)
        visit = np.cumsum(begins) - 1
        best = order[np.lexsort((np.abs(along[order]), visit))][
            np.searchsorted(np.sort(visit), np.arange(visit[-1] + 1))
        ]
        cells, ways = cell[best], track.way_m[point[best]] - along[best]
        kept = _nearest_road(ways, side[best])
        return cells[kept], ways[kept], covered

    @staticmethod
    def _new_ways(track: Track, ways: FloatColumn, covered: NDArray[np.bool_]) -> FloatColumn:
        """Return where on its way a track needs new cells."""
        new: list[float] = []
        edges = np.flatnonzero(np.diff(np.concatenate(([True], covered, [True]))))
        for first, end in edges.reshape(-1, 2):
            if (end - first) * STEP_M < CELL_M and len(ways):
                continue
            begin, last = track.way_m[first], track.way_m[end - 1]
            before = ways[(ways <= begin) & (ways > begin - 2.0 * CELL_M)]
            start = before.max() + CELL_M if len(before) else begin
            new.extend(np.arange(max(start, begin), last + 0.1, CELL_M))
        return np.array(new)


def _stretches(track: Track) -> Iterator[slice]:
    """Yield a track in stretches, none of which passes the same road twice: cells of one serve the next."""
    from scipy.spatial import cKDTree  # only a map is built with it

    tree = cKDTree(track.points)
    pairs = tree.query_pairs(_SIDE_M, output_type="ndarray")
    earlier, later = np.sort(pairs, axis=1).T
    again = (later - earlier) * STEP_M > _AGAIN_M
    earlier, later = earlier[again], later[again]
    same = (track.directions[earlier] * track.directions[later]).sum(axis=1) > _TURNED
    before = np.full(len(track.points), -1)
    np.maximum.at(before, later[same], earlier[same])
    begin = 0
    for point in np.flatnonzero(before >= 0).tolist():
        if before[point] >= begin:
            yield slice(begin, point)
            begin = point
    yield slice(begin, len(track.points))


def _nearest_road(ways: FloatColumn, side: FloatColumn) -> IntColumn:
    """Return which visits to keep: of cells beside each other, the nearest."""
    order = np.argsort(ways, kind="stable")
    kept: list[int] = []
    for now in order.tolist():
        if kept and ways[now] - ways[kept[-1]] < _LEVEL_M:
            if side[now] < side[kept[-1]]:
                kept[-1] = now
            continue
        kept.append(now)
    return np.array(kept, np.int64)
