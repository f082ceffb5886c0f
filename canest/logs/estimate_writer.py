"""Estimates as files, streamed: csv or parquet. A file appears under its name only when it is complete."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core import jit
from canest.core.errors import OutputError, UsageError
from canest.core.frames import FloatColumn
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS
from canest.logs import text_fields as text
from canest.logs.estimate_file import GRADE_DECIMALS, MASS_DECIMALS, Columns, Decimals, EstimateWriter
from canest.system.installation import how_to_add

if TYPE_CHECKING:
    from canest.core.estimates import Estimates


HEADER = b"t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate\n"
#: of files that hold estimates as frames
FRAME_ENDINGS = (".log", ".blf")
#: of files that hold estimates
ESTIMATE_ENDINGS = (".csv", ".csv.gz", ".parquet", ".mf4", ".mcap", ".txt", *FRAME_ENDINGS)
_ROWS_AT_ONCE = 1 << 13
_GZIP, _GZIP_LEVEL = 31, 6  #: of zlib: a gzip file
#: rows of one parquet row group
_ROW_GROUP = 1 << 17


def refuse_other_formats(path: Path, where: str) -> None:
    """Refuse a name that ends as those of another format do (.xlsx): it would hold csv all the same.

    A name without an ending (x, /dev/stdout) is taken, for csv. Errors: UsageError.
    """
    if path.suffix and not path.name.lower().endswith(ESTIMATE_ENDINGS):
        raise UsageError(
            "no format of estimates",
            where=where,
            found=str(path),
            expected="a name that ends in .csv or .parquet, .csv.gz, .mf4, .mcap, .log or .blf",
        )


def open_writer(path: str | Path, more: Decimals | None = None) -> EstimateWriter:
    """Open a result file; the end of its name is its format: .parquet, .mf4, .mcap, .csv.gz, else csv.

    more: further columns, each with the decimals that it has in a text.
    """
    path = Path(path)
    name = path.name.lower()
    if name.endswith(".parquet"):
        return ParquetEstimateWriter(path, more)
    if name.endswith(".mf4"):
        from canest.logs.estimate_mf4 import Mf4EstimateWriter  # wanted for this format alone

        return Mf4EstimateWriter(path, more)
    if name.endswith(".mcap"):
        from canest.logs.estimate_mcap import McapEstimateWriter  # as above

        return McapEstimateWriter(path, more)
    return CsvEstimateWriter(path, more, compress=name.endswith(".csv.gz"))


class CsvEstimateWriter(EstimateWriter):
    """est.csv: one row per sample, numbers empty where there is none."""

    def __init__(self, path: Path, more: Decimals | None = None, compress: bool = False) -> None:
        super().__init__(path)
        self._more = more or {}
        self._machine = zlib.compressobj(_GZIP_LEVEL, wbits=_GZIP) if compress else None
        header = HEADER.rstrip() + "".join(f",{name}" for name in self._more).encode() + b"\n"
        self._write(header)

    def write(self, estimates: Estimates, more: Columns | None = None) -> None:
        """Append the next rows."""
        for first in range(0, len(estimates), _ROWS_AT_ONCE):
            rows = slice(first, first + _ROWS_AT_ONCE)
            others = [((more or {})[name][rows], decimals) for name, decimals in self._more.items()]
            self._write(estimates_csv(estimates, rows, others))

    def _write(self, data: bytes) -> None:
        self._out.write(data if self._machine is None else self._machine.compress(data))

    def _finish(self) -> None:
        if self._machine is not None:
            self._out.write(self._machine.flush())


def estimates_csv(estimates: Estimates, rows: slice, more: Sequence[tuple[FloatColumn, int]] = ()) -> bytes:
    """Return rows of est.csv; more: further numbers of each, with their decimals."""
    t_us = estimates.t_us[rows]
    numbers = [
        (estimates.mass_kg[rows], MASS_DECIMALS),
        (estimates.mass_std_kg[rows], MASS_DECIMALS),
        (estimates.grade[rows], GRADE_DECIMALS),
        (estimates.grade_std[rows], GRADE_DECIMALS),
    ]
    labels = [(estimates.status[rows], STATUS_LABELS), (estimates.gate[rows], LABELS)]
    if jit.enabled():
        from canest.logs.estimate_kernel import rows_csv

        return rows_csv(t_us, numbers, labels, more)
    comma = text.constant(b",", len(t_us))
    fields = [text.seconds(t_us)]
    for values, decimals in numbers:
        fields += [comma, text.fixed(values, decimals)]
    for codes, names in labels:
        fields += [comma, text.labels(codes, names)]
    for values, decimals in more:
        fields += [comma, text.fixed(values, decimals)]
    return text.join([*fields, text.constant(b"\n", len(t_us))])


class ParquetEstimateWriter(EstimateWriter):
    """The same columns as parquet (pyarrow, extra ``formats``), in row groups."""

    def __init__(self, path: Path, more: Decimals | None = None) -> None:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError:
            raise OutputError(
                "cannot write parquet",
                where=str(path),
                expected=f"the pyarrow package: {how_to_add('formats')}",
            ) from None
        super().__init__(path)
        self._pa = pa
        names = pa.dictionary(pa.int8(), pa.string())
        numbers = ("t_s", "mass_kg", "mass_std_kg", "grade", "grade_std")
        self._schema = pa.schema(
            [(name, pa.float64()) for name in numbers]
            + [("status", names), ("gate", names)]
            + [(name, pa.float64()) for name in more or {}]
        )
        with self._out.errors():
            self._writer = pq.ParquetWriter(self._out.file, self._schema, use_dictionary=["status", "gate"])
        self._held: list[Any] = []
        self._rows = 0

    def write(self, estimates: Estimates, more: Columns | None = None) -> None:
        """Append the next rows."""
        e = estimates
        numbers = [e.t_us / 1e6, e.mass_kg, e.mass_std_kg, e.grade, e.grade_std]
        columns = [self._pa.array(column, from_pandas=True) for column in numbers]
        columns.append(self._names(e.status, STATUS_LABELS))
        columns.append(self._names(e.gate, LABELS))
        columns += [self._pa.array(column, from_pandas=True) for column in (more or {}).values()]
        self._held.append(self._pa.record_batch(columns, schema=self._schema))
        self._rows += len(e)
        if self._rows >= _ROW_GROUP:
            self._flush()

    def _names(self, codes: Any, names: dict[int, str]) -> Any:
        known = [names.get(code, "") for code in range(max(names) + 1)]
        return self._pa.DictionaryArray.from_arrays(codes.astype(np.int8), known)

    def _flush(self) -> None:
        with self._out.errors():
            self._writer.write_table(self._pa.Table.from_batches(self._held, self._schema))
        self._held, self._rows = [], 0

    def _abandon(self) -> None:
        with suppress(OSError):
            self._writer.close()

    def _finish(self) -> None:
        self._flush()
        with self._out.errors():
            self._writer.close()
