"""Estimates as files, streamed: csv or parquet. A file appears under its name only when it is complete."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core.errors import OutputError
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS
from canest.logs import text_fields as text
from canest.logs.growing_result import GrowingResult
from canest.system.installation import how_to_add

if TYPE_CHECKING:
    from canest.core.estimates import Estimates


HEADER = b"t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate\n"
MASS_DECIMALS = 1
GRADE_DECIMALS = 6
_ROWS_AT_ONCE = 1 << 13
#: rows of one parquet row group
_ROW_GROUP = 1 << 17


class EstimateWriter(ABC):
    """Takes estimates in order; use as a context manager. An exception inside leaves no file.

    Errors: OutputError when the file cannot be written (full disk, no permission).
    """

    def __init__(self, path: Path) -> None:
        self._out = GrowingResult(path)

    @abstractmethod
    def write(self, estimates: Estimates) -> None:
        """Append the next rows."""

    def _finish(self) -> None:  # noqa: B027 - only formats that hold something back need it
        """Write what is held back."""

    def _abandon(self) -> None:  # noqa: B027 - as above
        """Let go of what cannot be finished."""

    def __enter__(self) -> EstimateWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._abandon()
            self._out.discard()
            return
        try:
            self._finish()
        except BaseException:
            self._abandon()
            self._out.discard()
            raise
        self._out.commit()


def open_writer(path: str | Path) -> EstimateWriter:
    """Open a result file: parquet when its name ends so, else csv."""
    path = Path(path)
    return ParquetEstimateWriter(path) if path.suffix.lower() == ".parquet" else CsvEstimateWriter(path)


class CsvEstimateWriter(EstimateWriter):
    """est.csv: one row per sample, numbers empty where there is none."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._out.write(HEADER)

    def write(self, estimates: Estimates) -> None:
        """Append the next rows."""
        for first in range(0, len(estimates), _ROWS_AT_ONCE):
            self._out.write(estimates_csv(estimates, slice(first, first + _ROWS_AT_ONCE)))


def estimates_csv(estimates: Estimates, rows: slice) -> bytes:
    """Return rows of est.csv."""
    t_us = estimates.t_us[rows]
    comma = text.constant(b",", len(t_us))
    numbers = [
        (estimates.mass_kg, MASS_DECIMALS),
        (estimates.mass_std_kg, MASS_DECIMALS),
        (estimates.grade, GRADE_DECIMALS),
        (estimates.grade_std, GRADE_DECIMALS),
    ]
    fields = [text.seconds(t_us)]
    for column, decimals in numbers:
        fields += [comma, text.fixed(column[rows], decimals)]
    for codes, labels in ((estimates.status, STATUS_LABELS), (estimates.gate, LABELS)):
        fields += [comma, text.labels(codes[rows], labels)]
    return text.join([*fields, text.constant(b"\n", len(t_us))])


class ParquetEstimateWriter(EstimateWriter):
    """The same columns as parquet (pyarrow, extra ``formats``), in row groups."""

    def __init__(self, path: Path) -> None:
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
            [(name, pa.float64()) for name in numbers] + [("status", names), ("gate", names)]
        )
        with self._out.errors():
            self._writer = pq.ParquetWriter(self._out.file, self._schema)
        self._held: list[Any] = []
        self._rows = 0

    def write(self, estimates: Estimates) -> None:
        """Append the next rows."""
        e = estimates
        numbers = [e.t_us / 1e6, e.mass_kg, e.mass_std_kg, e.grade, e.grade_std]
        columns = [self._pa.array(column, from_pandas=True) for column in numbers]
        columns.append(self._names(e.status, STATUS_LABELS))
        columns.append(self._names(e.gate, LABELS))
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
