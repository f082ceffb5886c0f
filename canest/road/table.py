"""A road map as a table: one row per cell of 25 m and direction, in a Parquet file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest import __version__
from canest.core.errors import ConfigError, UsageError
from canest.core.frames import FloatColumn, IntColumn
from canest.system.installation import how_to_add

VERSION = 1
#: column -> what it holds; docs/road_map.md has the same
COLUMNS: dict[str, str] = {
    "latitude_deg": "middle of the cell, north positive",
    "longitude_deg": "middle of the cell, east positive",
    "altitude_m": "mean of the altitudes that drives reported; NaN without",
    "heading_deg": "direction of travel, from north, clockwise",
    "next": "row of the cell that most drives went on to, -1 for none",
    "grade": "in the direction of travel, a ratio: 0.03 is 3 % uphill",
    "grade_std": "its standard deviation",
    "passes": "passes over the cell that count",
    "vehicles": "vehicles they were made by",
    "first_day": "day (UTC) of the oldest, in days since 1970-01-01; NaN where no clock is a calendar",
    "last_day": "day of the newest, likewise: the age of the cell",
}
_COUNTS, _SCHEMA = b"canest.counts", b"canest.road_map"


@dataclass(frozen=True, slots=True, eq=False)
class RoadMap:
    """The columns of `COLUMNS`, all (cells,). counts: what was taken and left out when it was built."""

    latitude_deg: FloatColumn
    longitude_deg: FloatColumn
    altitude_m: FloatColumn
    heading_deg: FloatColumn
    next: IntColumn
    grade: FloatColumn
    grade_std: FloatColumn
    passes: IntColumn
    vehicles: IntColumn
    first_day: FloatColumn
    last_day: FloatColumn
    counts: Mapping[str, int]

    def __len__(self) -> int:
        return len(self.grade)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RoadMap):
            return NotImplemented
        return all(
            np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True) for name in COLUMNS
        )

    __hash__ = None  # type: ignore[assignment]

    def selected(self, kept: NDArray[np.bool_]) -> RoadMap:
        """Return the map of some cells (cells,); links to others end."""
        rows = np.where(kept, np.cumsum(kept) - 1, -1)
        columns = {f.name: getattr(self, f.name)[kept] for f in fields(self) if f.name != "counts"}
        columns["next"] = np.where(columns["next"] >= 0, rows[columns["next"]], -1)
        return RoadMap(**columns, counts=self.counts)


def write_map(road: RoadMap) -> bytes:
    """Return a map as the content of a Parquet file."""
    pa, pq = _pyarrow("a road map")
    arrays = {name: pa.array(getattr(road, name)) for name in COLUMNS}
    table = pa.table(arrays).replace_schema_metadata(
        {
            _SCHEMA: str(VERSION).encode(),
            b"canest.version": __version__.encode(),
            _COUNTS: json.dumps(dict(road.counts)).encode(),
        }
    )
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


def read_map(path: str | Path) -> RoadMap:
    """Return the map of a file. Errors: ConfigError for no map, UsageError without pyarrow."""
    pa, pq = _pyarrow("a road map")
    try:
        table = pq.read_table(Path(path), memory_map=False)
    except FileNotFoundError:
        raise ConfigError("no such file", where=str(path), expected="a map of `canest map build`") from None
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ConfigError(
            f"cannot be read ({str(error).splitlines()[0]})", where=str(path), expected="a Parquet file"
        ) from None
    metadata = table.schema.metadata or {}
    version = metadata.get(_SCHEMA, b"").decode()
    missing = [name for name in COLUMNS if name not in table.column_names]
    if version != str(VERSION) or missing:
        found = f"version {version}" if version else "another table"
        raise ConfigError(
            "no road map",
            where=str(path),
            found=found,
            expected=f"a map of version {VERSION} by `canest map build`",
        )
    columns = {name: _column(table, name) for name in COLUMNS}
    if len(columns["next"]) and not (columns["next"] < len(table)).all():
        raise ConfigError("a cell leads out of the map", where=str(path), expected="rows of this file")
    return RoadMap(**columns, counts=json.loads(metadata.get(_COUNTS, b"{}")))


def _column(table: Any, name: str) -> Any:
    kind = np.int64 if name in ("next", "passes", "vehicles") else np.float64
    return np.asarray(table.column(name).to_numpy(), kind)


def _pyarrow(why: str) -> tuple[Any, Any]:
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError(f"{why} needs the package pyarrow", expected=how_to_add("map")) from None
