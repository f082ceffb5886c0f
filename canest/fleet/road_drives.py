"""The drives of a lake, for the map of their roads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from canest.core.errors import UsageError
from canest.core.frames import FloatColumn
from canest.fleet.query import connect
from canest.road.tracks import Drive

_COLUMNS = (
    "distance_m", "speed_mps", "grade", "grade_std", "altitude_m", "latitude_deg", "longitude_deg",
    "position_m",
)  # fmt: skip
_SECONDS_PER_DAY = 86_400.0


def drives_of(lake: str, progress: Callable[[float], None] | None = None) -> Iterator[Drive]:
    """Yield the drives of a lake, in order of vehicle, day and log.

    Errors: UsageError for no lake, or one without positions.
    """
    connection = connect(lake)
    known = {row[0] for row in connection.execute("describe samples").fetchall()}
    if "latitude_deg" not in known:
        raise UsageError("the lake has no positions", where=lake, expected="canest fleet run --positions")
    missing = [name for name in _COLUMNS if name not in known]
    columns = ", ".join(f"NULL::DOUBLE AS {name}" if name in missing else name for name in _COLUMNS)
    logs = connection.execute(
        "select vehicle, log, min(epoch(time)) as began from samples group by all order by all"
    ).fetchall()
    for number, (vehicle, log, began) in enumerate(logs):
        answer = connection.execute(
            f"select {columns} from samples where vehicle = ? and log = ? order by t_s",
            [vehicle, log],
        ).fetchnumpy()
        day = float(began // _SECONDS_PER_DAY) if began is not None else float("nan")
        yield Drive(log, vehicle, day, **{name: _floats(answer[name]) for name in _COLUMNS})
        if progress is not None:
            progress((number + 1) / len(logs))


def _floats(column: Any) -> FloatColumn:
    """Return a column of DuckDB, NaN for null."""
    return np.asarray(np.ma.filled(np.ma.asarray(column, np.float64), np.nan), np.float64)
