"""SQL over a lake with DuckDB: the views `trips` and `samples`."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TextIO

from canest.core.errors import CanestError, UsageError
from canest.fleet.lake import Lake
from canest.fleet.packages import require
from canest.fleet.result_names import SUFFIX
from canest.fleet.tables import POSITIONS, SAMPLES, TRIPS, schema

#: tables -> their columns
TABLES: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "trips": TRIPS, "samples": {**SAMPLES, **POSITIONS}
}  # fmt: skip
#: folders of a partition -> type
_PARTITION = {"vehicle": "VARCHAR", "date": "DATE"}


@dataclass(frozen=True, slots=True)
class Answer:
    """What a query found. columns: their names."""

    columns: list[str]
    result: Any

    def rows(self) -> Iterator[list[str]]:
        """Yield the rows as text; '' for null."""
        while rows := self.result.fetchmany(10_000):
            for row in rows:
                yield [_text(value) for value in row]

    def write_csv(self, file: TextIO) -> None:
        """Write the rows below a header."""
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows())


def ask(lake: str, sql: str) -> Answer:
    """Return the answer to a query. Errors: UsageError for no lake, or a query that is wrong."""
    (duckdb,) = require("duckdb", why="canest fleet query")
    connection = connect(lake, [table for table in TABLES if table in sql.lower()] or TABLES)
    try:
        result = connection.execute(sql)
    except duckdb.Error as error:
        lines = [line for line in str(error).splitlines() if line.strip()]
        raise UsageError(lines[0], where="SQL", expected="DuckDB's SQL over trips and samples") from None
    if result is None:
        raise UsageError("is no query", where="SQL", found=sql, expected="e.g. select * from trips")
    return Answer([column[0] for column in result.description or ()], result)


def connect(lake: str, tables: Iterable[str] = TABLES) -> Any:
    """Return a DuckDB connection with views of a lake.

    tables: that are wanted, of `TABLES`; a view of samples looks into every file of theirs.
    Errors: UsageError for no lake, CanestError where it cannot be read.
    """
    duckdb, _ = require("duckdb", "fsspec", why="a lake")
    opened = Lake.open(lake)
    # a cache of files that are read once takes gigabytes of a lake of many small ones
    connection = duckdb.connect(config={"enable_external_file_cache": False})
    if not opened.storage.is_local:
        connection.register_filesystem(opened.storage.files)
    try:
        for table in tables:
            _create_view(connection, opened, table, schema(TABLES[table]))
    except duckdb.Error as error:
        raise CanestError(f"cannot be read: {str(error).splitlines()[0]}", where=lake) from None
    return connection


def _create_view(connection: Any, lake: Lake, table: str, columns: Any) -> None:
    """Make the view of a table; of one without files, an empty one."""
    files = lake.files(table)
    replaced = lake.superseded(files)
    if files:
        every = [f"{table}/*/*/*{SUFFIX}"]  # shorter for DuckDB than all their names
        wanted = [name for name in files if name not in replaced] if replaced else every
        places = ", ".join("'" + lake.storage.url(name).replace("'", "''") + "'" for name in wanted)
        types = ", ".join(f"{name}: {kind}" for name, kind in _PARTITION.items())
        by_name = "true" if table == "samples" else "false"  # with and without positions
        connection.execute(
            f"CREATE VIEW {table} AS SELECT * FROM read_parquet([{places}], hive_partitioning = true, "
            f"hive_types = {{{types}}}, union_by_name = {by_name})"
        )
        return
    connection.register(f"no_{table}", columns.empty_table())
    partition = ", ".join(f"NULL::{kind} AS {name}" for name, kind in _PARTITION.items())
    connection.execute(f"CREATE VIEW {table} AS SELECT *, {partition} FROM no_{table}")


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime):
        return value.isoformat(" ")
    return str(value)
