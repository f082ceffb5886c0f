"""Finds the vehicle on a road map while it drives: by each position and the direction from the one before.

Between two positions the vehicle goes on along the cells by its speed. Nothing here needs the future, and
any cut of the ticks gives the same bits.
"""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from canest.core.columns import constant, shifted
from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S, ModelBlock
from canest.grid.grid import GridBlock
from canest.road.sphere import Points, directions_of, points_of
from canest.road.table import RoadMap

_LATITUDE, _LONGITUDE = "latitude", "longitude"
_CUBE_M = 50.0  #: cells are looked for in cubes of this size
_SIDE_M = 20.0  #: a cell further beside is another road
_ALONG_M = 25.0
#: cells of two roads are level within this: more than half a cell, less than to the next of one road
_LEVEL_M = 15.0
_TURNED = math.cos(math.radians(45.0))
_APART_M = 8.0  #: two roads beside each other whose distances differ less cannot be separated
_LEAST_MOVED_M = 5.0  #: for a direction
_AHEAD_M = 300.0  #: the way that is known without a new position
#: what a position may be wrong along the road, m, and by share of the way since
_ALONG_STD_M, _DRIFT = 6.0, 0.03
_LONGER, _FURTHER_M = 1.05, 25.0
_BLIND_S = 10.0  #: without positions for so long


class _Way(NamedTuple):
    """The cells ahead of a position: distance from it (k,), sine of the slope and its std there."""

    at_m: FloatColumn
    sine: FloatColumn
    std: FloatColumn


class RoadMatcher:
    """Carries the last position; ticks in, what the map has for each out."""

    def __init__(self, road: RoadMap) -> None:
        self._points = points_of(road.latitude_deg, road.longitude_deg)
        self._directions = directions_of(self._points, road.heading_deg)
        self._sine = np.sin(np.arctan(road.grade))
        self._std = road.grade_std
        self._next = road.next.tolist()
        self._cubes: dict[tuple[int, ...], list[int]] = defaultdict(list)
        for cell, cube in enumerate(np.floor(self._points / _CUBE_M).astype(np.int64).tolist()):
            self._cubes[tuple(cube)].append(cell)
        self._forget()

    def _forget(self) -> None:
        self._held = (math.nan, math.nan)  # position in force
        self._anchor: Points | None = None  # an earlier position, from which the direction is taken
        self._from_anchor_m = 0.0
        self._direction: Points | None = None
        self._way: _Way | None = None
        self._driven_m, self._since_ticks = 0.0, 0  # since that position
        self._cell = -1

    def match(self, ticks: GridBlock, samples: ModelBlock) -> tuple[FloatColumn, FloatColumn]:
        """Return the sine of the slope and its std at each tick (n,), NaN where the map has no road."""
        n = len(ticks)
        sine, std = np.full(n, math.nan), np.full(n, math.nan)
        if not ticks.continues:
            self._forget()
        nothing = constant(math.nan, n)
        latitude = ticks.values.get(_LATITUDE, nothing)
        longitude = ticks.values.get(_LONGITUDE, nothing)
        new = (latitude != shifted(latitude, self._held[0])) | (
            longitude != shifted(longitude, self._held[1])
        )
        new &= np.isfinite(latitude) & np.isfinite(longitude)
        steps = np.nan_to_num(np.where(samples.stopped, 0.0, np.abs(samples.raw_speed_mps))) * STEP_S
        edges = [0, *np.flatnonzero(new).tolist(), n]
        for first, end in pairwise(edges):
            if new[first:end].any():
                self._locate(float(latitude[first]), float(longitude[first]))
            if end > first:
                part = slice(first, end)
                self._go_on(steps[part], sine[part], std[part])
        self._held = float(latitude[-1]), float(longitude[-1])
        return sine, std

    def ahead(self, length_m: float = 2000.0) -> tuple[list[float], list[float]]:
        """Return distances from the vehicle and grades there; empty where it is on no road of the map."""
        if self._way is None or self._cell < 0:
            return [], []
        way = self._ahead(self._cell, float(self._way.at_m[0]), length_m + self._driven_m)
        at_m = way.at_m - self._driven_m
        grade = way.sine / np.sqrt(1.0 - way.sine**2)
        shown = at_m >= -1.0
        return np.round(at_m[shown], 1).tolist(), np.round(grade[shown], 5).tolist()

    def _go_on(self, steps: FloatColumn, sine: FloatColumn, std: FloatColumn) -> None:
        """Fill in what the map has along the way; steps: metres per tick (n,)."""
        # one sum in order of time, whatever the cut
        driven = np.concatenate(([self._driven_m], steps)).cumsum()[1:]
        ticks = self._since_ticks + np.arange(1, len(steps) + 1)
        self._driven_m, self._since_ticks = float(driven[-1]), int(ticks[-1])
        way = self._way
        if way is None:
            return
        known = (driven <= way.at_m[-1]) & (ticks <= _BLIND_S / STEP_S)
        slope = np.interp(driven, way.at_m, way.sine)
        reach = _ALONG_STD_M + _DRIFT * driven
        change = np.interp(driven + reach, way.at_m, way.sine) - np.interp(driven - reach, way.at_m, way.sine)
        own = np.interp(driven, way.at_m, way.std)
        sine[:] = np.where(known, slope, math.nan)
        std[:] = np.where(known, np.sqrt(own**2 + 0.25 * change**2), math.nan)

    def _locate(self, latitude: float, longitude: float) -> None:
        """Take a new position: the way ahead of it, if the map has one."""
        point = points_of(np.array([latitude]), np.array([longitude]))[0]
        self._way, self._cell = None, -1
        self._from_anchor_m += self._driven_m
        moved = point - (point if self._anchor is None else self._anchor)
        length = float(np.sqrt(moved @ moved))
        jumped = length > _LONGER * self._from_anchor_m + _FURTHER_M  # now or before: no direction
        if jumped or length >= _LEAST_MOVED_M:
            self._direction = None if jumped else moved / length
        if jumped or length >= _LEAST_MOVED_M or self._anchor is None:
            self._anchor, self._from_anchor_m = point, 0.0
        self._driven_m, self._since_ticks = 0.0, 0
        if self._direction is None:
            return
        found = self._cell_at(point, self._direction)
        if found is not None:
            self._cell, along = found
            self._way = self._ahead(self._cell, -along, _AHEAD_M)

    def _cell_at(self, point: Points, direction: Points) -> tuple[int, float] | None:
        """Return the cell of a position and how far beyond its middle it is; None where it is not clear."""
        x, y, z = np.floor(point / _CUBE_M).astype(np.int64).tolist()
        near = [
            cell
            for i in (x - 1, x, x + 1)
            for j in (y - 1, y, y + 1)
            for k in (z - 1, z, z + 1)
            for cell in self._cubes.get((i, j, k), ())
        ]
        if not near:
            return None
        cells = np.array(near)
        apart, forward = point - self._points[cells], self._directions[cells]
        along = (apart * forward).sum(axis=1)
        side = np.sqrt(np.square(apart - along[:, None] * forward).sum(axis=1))
        same = (forward @ direction > _TURNED) & (side <= _SIDE_M) & (np.abs(along) <= _ALONG_M)
        if not same.any():
            return None
        cells, along, side = cells[same], along[same], side[same]
        best = int(np.argmin(side + np.abs(along)))
        beside = np.abs(along - along[best]) < _LEVEL_M
        beside[best] = False
        if (side[beside] < side[best] + _APART_M).any():
            return None
        return int(cells[best]), float(along[best])

    def _ahead(self, cell: int, at_m: float, length_m: float) -> _Way:
        """Return the way from a cell on that lies at a distance from the vehicle."""
        cells, places = [cell], [at_m]
        while places[-1] < length_m and (cell := self._next[cell]) >= 0:
            step = self._points[cell] - self._points[cells[-1]]
            places.append(places[-1] + max(float(np.sqrt(step @ step)), 1.0))
            cells.append(cell)
        return _Way(np.array(places), self._sine[cells], self._std[cells])
