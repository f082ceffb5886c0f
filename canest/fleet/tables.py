"""The tables of the lake: their columns, and Parquet files of them. docs/fleet.md describes every column.

Whoever changes a column raises `SCHEMA_VERSION`; it stands in the metadata of every file.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

from canest import __version__
from canest.fleet.packages import require
from canest.system.result_files import utf8

SCHEMA_VERSION = 3
_FLOAT, _SHORT, _INT, _TEXT, _WORD, _TIME = "float64", "float32", "int64", "string", "word", "time"

#: one row per load leg: column -> (type, meaning)
TRIPS: dict[str, tuple[str, str]] = {
    "log": (_TEXT, "path of the log below SOURCE"),
    "leg": (_INT, "number of the leg within the log, from 1; 0 for a log without any driving"),
    "load": (_INT, "number of the load within the log: 1 for the first leg with a valid mass"),
    "start": (_TIME, "start of the leg, UTC; null where the log's clock is no calendar"),
    "from_s": (_FLOAT, "start of the leg in the log's own clock, s"),
    "to_s": (_FLOAT, "end of the leg in the log's own clock, s"),
    "duration_s": (_FLOAT, "from start to end of the leg, also where the clock was set back"),
    "driving_s": (_FLOAT, "time in motion"),
    "distance_m": (_FLOAT, "distance driven"),
    "climb_m": (_FLOAT, "sum of the rises, from the estimated grade"),
    "stops": (_INT, "stops within the leg"),
    "mass_kg": (_FLOAT, "mass: the leg's last valid estimate, else its last estimate"),
    "mass_std_kg": (_FLOAT, "its standard deviation"),
    "valid_share": (_FLOAT, "share of the driving time with a valid mass, 0 to 1"),
    "status": (_WORD, "valid, converging or unestimated: the best of the leg"),
    "reason": (_TEXT, "why the mass is not valid, else empty"),
    "residual_mean_N": (_FLOAT, "mean of m (a + g sin b + g mu cos b) - F over seconds without closed gates"),
    "residual_rms_N": (_FLOAT, "its root mean square, of means over one second"),
    "torque_residual_pct": (_FLOAT, "percent by which the motion shows more traction than reported, or less"),
    "reported_mass_kg": (_FLOAT, "median of the mass that another controller sent (role reported_mass)"),
    "frames": (_INT, "frames or rows in the log"),
    "skipped_lines": (_INT, "lines of the log that could not be read"),
    "notes": (_TEXT, "what else a user should know of the log"),
    "estimator": (_WORD, "name of the estimator"),
    "config": (_WORD, "config, as the manifest names it"),
    "key": (_WORD, "digest of the log's content, its config, canest's version and the settings"),
}  # fmt: skip
#: one row per second (or as often as asked): column -> (type, meaning)
SAMPLES: dict[str, tuple[str, str]] = {
    "log": (_WORD, "path of the log below SOURCE"),
    "time": (_TIME, "UTC; null where the log's clock is no calendar"),
    "t_s": (_FLOAT, "the log's own clock, s"),
    "distance_m": (_FLOAT, "distance driven since the start of the log"),
    "speed_mps": (_SHORT, "speed"),
    "grade": (_SHORT, "estimated grade, a ratio"),
    "grade_std": (_SHORT, "its standard deviation"),
    "mass_kg": (_SHORT, "estimated mass"),
    "mass_std_kg": (_SHORT, "its standard deviation"),
    "status": (_WORD, "valid, converging or unestimated"),
    "gate": (_WORD, "why the estimator does not learn; empty while it does"),
    "altitude_m": (_SHORT, "altitude as last sent"),
}
#: more columns of the samples with --positions
POSITIONS: dict[str, tuple[str, str]] = {
    "latitude_deg": (_FLOAT, "latitude, north positive"),
    "longitude_deg": (_FLOAT, "longitude, east positive"),
    "position_m": (_FLOAT, "distance_m when this position came: a receiver reports once a second or less"),
}


def schema(columns: Mapping[str, tuple[str, str]], metadata: Mapping[str, str] | None = None) -> Any:
    """Return the Arrow schema of a table, its version in the metadata."""
    (pa,) = require("pyarrow", why="a lake")
    types = {
        _FLOAT: pa.float64(), _SHORT: pa.float32(), _INT: pa.int64(), _TEXT: pa.string(),
        _WORD: pa.dictionary(pa.int32(), pa.string()), _TIME: pa.timestamp("us"),
    }  # fmt: skip
    about = {"canest.schema": str(SCHEMA_VERSION), "canest.version": __version__, **(metadata or {})}
    return pa.schema([pa.field(name, types[kind]) for name, (kind, _) in columns.items()], about)


class TableWriter:
    """Writes a table part by part into a Parquet file in memory, compressed.

    columns: those of the table. metadata: more of it. rows: written so far.
    """

    def __init__(self, columns: Mapping[str, tuple[str, str]], metadata: Mapping[str, str]) -> None:
        self._pa, pq = require("pyarrow", "pyarrow.parquet", why="a lake")
        self._schema = schema(columns, metadata)
        self._buffer = io.BytesIO()
        self._writer = pq.ParquetWriter(self._buffer, self._schema, compression="zstd")
        self.rows = 0

    def write(self, columns: Mapping[str, Sequence[Any] | Any]) -> None:
        """Append rows: column -> values (n,), NaN and None for nothing."""
        arrays = [
            self._pa.array(_as_utf8(columns[field.name]), field.type, from_pandas=True)
            for field in self._schema
        ]
        batch = self._pa.Table.from_arrays(arrays, schema=self._schema)
        self._writer.write_table(batch)
        self.rows += batch.num_rows

    def content(self) -> bytes:
        """Complete the file and return it."""
        self._writer.close()
        return self._buffer.getvalue()


def _as_utf8(values: Sequence[Any] | Any) -> Sequence[Any] | Any:
    """Return a column with its texts as `utf8`: Arrow refuses a name that is none."""
    if not isinstance(values, list):
        return values
    return [utf8(value).decode() if isinstance(value, str) else value for value in values]


def trips_file(rows: Sequence[Mapping[str, Any]], metadata: Mapping[str, str]) -> bytes:
    """Return a Parquet file of trips, one mapping per row."""
    writer = TableWriter(TRIPS, metadata)
    writer.write({name: [row.get(name) for row in rows] for name in TRIPS})
    return writer.content()
