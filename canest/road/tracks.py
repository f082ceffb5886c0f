"""One drive to tracks: points every few metres with the grade there, without what a receiver invents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.road.sphere import Points, points_of, unit

STEP_M = 5.0  #: spacing of a track's points
#: a report may lie further from the one before than the wheels turned by this share, and by this
_LONGER, _FURTHER_M = 1.05, 25.0
_CLOSEST_M = 3.0  #: nearer reports are the receiver's noise
_LOST_M = 250.0  #: without reports for so far, the way between is not known
_AGREEING = 10  #: reports that agree with each other, and not with those before, begin a new track
_DECEIVED_M = 1000.0  #: a receiver that came back from further was right
_SHORTEST_M = 100.0
_REACH = 3  #: points before and after that give the direction
_MOVING_MPS = 1.0
_FARTHEST_M = 60.0  #: between samples of the grade, for one in between
_WORST_STD = 0.03  #: a grade that is not better known than that of any road

#: what is counted of drives and positions
NO_POSITIONS, JUMPS, LOST, SHORT = "passes without positions", "satellite jumps", "gaps", "pieces too short"


@dataclass(frozen=True, slots=True)
class Drive:
    """The samples of one log, all columns (n,); NaN for nothing.

    day: of its begin, in days since 1970, NaN where unknown. position_m: the distance at which the position
    came. Names and units otherwise as in the lake.
    """

    log: str
    vehicle: str
    day: float
    distance_m: FloatColumn
    speed_mps: FloatColumn
    grade: FloatColumn
    grade_std: FloatColumn
    altitude_m: FloatColumn
    latitude_deg: FloatColumn
    longitude_deg: FloatColumn
    position_m: FloatColumn


class Track(NamedTuple):
    """One piece of a drive, n points `STEP_M` apart. points, directions: (n, 3).

    sine: of the slope, NaN where not known. std: its standard deviation.
    """

    way_m: FloatColumn
    points: Points
    directions: Points
    sine: FloatColumn
    std: FloatColumn
    altitude_m: FloatColumn


def tracks_of(drive: Drive, counts: Counter[str]) -> list[Track]:
    """Return the tracks of a drive; what is left out is counted."""
    known = np.isfinite(drive.latitude_deg) & np.isfinite(drive.longitude_deg)
    came_m = np.where(np.isfinite(drive.position_m), drive.position_m, drive.distance_m)
    known &= np.isfinite(came_m)
    if np.count_nonzero(known) < 2:
        counts[NO_POSITIONS] += 1
        return []
    came_m = came_m[known]
    points = points_of(drive.latitude_deg[known], drive.longitude_deg[known])
    tracks = []
    for picked in _pieces(came_m, points, counts):
        if came_m[picked[-1]] - came_m[picked[0]] < _SHORTEST_M:
            counts[SHORT] += 1
            continue
        tracks.append(_track(drive, came_m[picked], points[picked]))
    return tracks


def _pieces(came_m: FloatColumn, points: Points, counts: Counter[str]) -> list[NDArray[np.int64]]:
    """Return the reports of each piece, by index: those that the distance driven explains."""
    pieces: list[list[int]] = [[]]
    contradicting: list[int] = []  # reports that agree with each other, and not with those before

    def fits(before: int, now: int) -> bool:
        driven = float(came_m[now] - came_m[before])
        moved = float(np.linalg.norm(points[now] - points[before]))
        return moved <= _LONGER * driven + _FURTHER_M

    for now in range(len(came_m)):
        piece = pieces[-1]
        if not piece:
            piece.append(now)
            continue
        driven = came_m[now] - came_m[piece[-1]]
        if driven < _CLOSEST_M:
            continue
        # first of all: the way driven explains any jump after a while
        if contradicting and fits(contradicting[-1], now):
            if came_m[now] - came_m[contradicting[-1]] >= _CLOSEST_M:
                contradicting.append(now)
            if len(contradicting) >= _AGREEING:
                pieces.append(contradicting)
                contradicting = []
            continue
        counts[JUMPS] += len(contradicting)
        contradicting = []
        if driven > _LOST_M:
            counts[LOST] += 1
            pieces.append([now])
        elif fits(piece[-1], now):
            piece.append(now)
        else:
            contradicting = [now]
    counts[JUMPS] += len(contradicting)
    return [np.array(piece, np.int64) for piece in _returned(pieces, came_m, fits, counts) if len(piece) > 1]


def _returned(
    pieces: list[list[int]], came_m: FloatColumn, fits: Callable[[int, int], bool], counts: Counter[str]
) -> list[list[int]]:
    """Leave out a piece from which the receiver came back to where the vehicle could have driven by then."""
    kept: list[list[int]] = []
    for number, piece in enumerate(pieces):
        after = pieces[number + 1] if number + 1 < len(pieces) else []
        short = came_m[piece[-1]] - came_m[piece[0]] < _DECEIVED_M if piece else True
        if kept and after and short and not fits(kept[-1][-1], piece[0]) and fits(kept[-1][-1], after[0]):
            counts[JUMPS] += len(piece)
        elif (
            kept
            and piece
            and came_m[piece[0]] - came_m[kept[-1][-1]] <= _LOST_M
            and fits(kept[-1][-1], piece[0])
        ):
            kept[-1] = [*kept[-1], *piece]
        elif piece:
            kept.append(piece)
    return kept


def _track(drive: Drive, came_m: FloatColumn, points: Points) -> Track:
    way_m = np.arange(came_m[0], came_m[-1], STEP_M)
    line = np.stack([np.interp(way_m, came_m, points[:, k]) for k in range(3)], axis=1)
    ahead = np.minimum(np.arange(len(line)) + _REACH, len(line) - 1)
    behind = np.maximum(np.arange(len(line)) - _REACH, 0)
    usable = np.isfinite(drive.grade) & (drive.grade_std < _WORST_STD) & (drive.speed_mps > _MOVING_MPS)
    sine = np.sin(np.arctan(drive.grade))
    return Track(
        way_m,
        line,
        unit(line[ahead] - line[behind]),
        _between(way_m, drive.distance_m, sine, usable),
        _between(way_m, drive.distance_m, drive.grade_std, usable),
        _between(way_m, drive.distance_m, drive.altitude_m, np.isfinite(drive.altitude_m)),
    )


def _between(
    way_m: FloatColumn, at_m: FloatColumn, values: FloatColumn, usable: NDArray[np.bool_]
) -> FloatColumn:
    """Return values at distances, linear between usable samples that lie near enough, else NaN."""
    at_m, values = at_m[usable], values[usable]
    if len(at_m) < 2:
        return np.full(len(way_m), np.nan)
    after = np.clip(np.searchsorted(at_m, way_m), 1, len(at_m) - 1)
    near = (at_m[after] - at_m[after - 1] <= _FARTHEST_M) & (way_m >= at_m[0]) & (way_m <= at_m[-1])
    return np.where(near, np.interp(way_m, at_m, values), np.nan)
