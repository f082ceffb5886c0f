"""Parts: files with the results of several logs of one vehicle and day, joined from files of one log each.

Which results a part has stands in its metadata. Rows are ordered by log, and those of a log stay in order.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from canest.core.errors import CanestError
from canest.fleet.packages import require
from canest.fleet.result_names import is_part, log_id, result_in
from canest.fleet.storage import Storage, plain, retried

_RESULTS, _VERSION, _SCHEMA = b"canest.results", b"canest.version", b"canest.schema"
#: rows that are compressed together
_GROUP_ROWS = 131_072


def results_in(storage: Storage, file: str) -> frozenset[str]:
    """Return the results that a file of the lake has. Errors: CanestError where it cannot be read."""
    if not is_part(file):
        return frozenset(filter(None, [result_in(file)]))
    (pq,) = require("pyarrow.parquet", why="a lake")

    def footer() -> Any:
        with storage.files.open(f"{storage.root}/{file}", "rb") as opened:
            return pq.read_metadata(opened).metadata

    try:
        said = retried(footer) or {}
    except FileNotFoundError:  # joined into another one meanwhile
        return frozenset()
    except Exception as error:
        raise CanestError(
            f"cannot be read: {plain(error)}", where=storage.url(file),
            expected="a whole file: remove it, then `canest fleet run` with --resume makes its results again",
        ) from None  # fmt: skip
    return frozenset(said.get(_RESULTS, b"").decode().split())


def read_table(content: bytes, logs: Collection[str] | None = None) -> Any:
    """Return a file of the lake as an Arrow table. logs: digests of those that are wanted, None for all."""
    pa, pq, pc = require("pyarrow", "pyarrow.parquet", "pyarrow.compute", why="a lake")
    table = pq.ParquetFile(io.BytesIO(content)).read()
    if logs is None:
        return table
    names = pc.unique(table["log"].cast(pa.string())).to_pylist()
    wanted = pa.array([name for name in names if log_id(name) in logs], pa.string())
    return table.filter(pc.is_in(table["log"].cast(pa.string()), value_set=wanted))


def write_part(tables: Sequence[Any], results: Iterable[str]) -> bytes:
    """Return a part of tables that have the same columns. results: that it has."""
    pa, pq, pc = require("pyarrow", "pyarrow.parquet", "pyarrow.compute", why="a lake")
    kept = [table.schema.metadata or {} for table in tables]
    versions = sorted({said[_VERSION].decode() for said in kept if _VERSION in said})
    metadata = {
        _SCHEMA: kept[0].get(_SCHEMA, b""),
        _VERSION: ", ".join(versions).encode(),
        _RESULTS: " ".join(sorted(results)).encode(),
    }
    schema = tables[0].schema.remove_metadata()
    plain_types = [pa.string() if pa.types.is_dictionary(kind) else kind for kind in schema.types]
    as_text = pa.schema(list(zip(schema.names, plain_types, strict=True)))
    joined = pa.concat_tables([table.replace_schema_metadata(None).cast(as_text) for table in tables])
    joined = joined.take(pc.sort_indices(joined["log"]))  # stable
    # dictionaries anew: the same rows give the same bytes, in whatever order the files came
    joined = joined.combine_chunks().cast(schema).replace_schema_metadata(metadata)
    sink = pa.BufferOutputStream()
    pq.write_table(joined, sink, compression="zstd", row_group_size=_GROUP_ROWS)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def columns_of(content: bytes) -> str:
    """Return what distinguishes files that can be joined from others: their columns and schema's version."""
    (pq,) = require("pyarrow.parquet", why="a lake")
    schema = pq.read_schema(io.BytesIO(content))
    version = (schema.metadata or {}).get(_SCHEMA, b"").decode()
    return f"{version}\n{schema.remove_metadata()}"
