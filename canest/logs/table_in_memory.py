"""Tables that a program holds: pandas, polars, pyarrow, or a mapping of arrays, none of them imported.

What a column is asked for is one thing only: `numpy.asarray` of it, which all of these libraries answer.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import LogError
from canest.core.frames import FloatColumn
from canest.core.table_block import TableBlock
from canest.logs.base import BLOCK_FRAMES, LogReader
from canest.logs.cells import number_of, seconds_of, seconds_since_1970
from canest.logs.memory import MemoryLog, MemorySource
from canest.logs.table_reader import TableReader

_EXPECTED = "a pandas, polars or pyarrow table, or a mapping of names to arrays"


class TableLog(MemoryLog):
    """A table as a log.

    names: its columns. A pandas table without a column for the time has it in its index, if that holds
    dates, durations or bears the name of the time column.

    Errors: LogError for what is no table, or has columns of different lengths.
    """

    no_channel = "a table has no interfaces"

    def __init__(self, table: Any, name: str = "table") -> None:
        self.name = name
        self._table = table
        self._keys = {str(key): key for key in _keys_of(table, name)}
        self.names = list(self._keys)
        lengths = {column: self._length(column) for column in self.names}
        if len(set(lengths.values())) > 1:
            raise LogError(
                "the columns differ in length", where=name, found=str(lengths), expected="one length"
            )
        self._rows = next(iter(lengths.values()), 0)

    def __len__(self) -> int:
        return self._rows

    def reader(
        self, time_column: str, columns: Collection[str] | None, as_text: Collection[str]
    ) -> LogReader:
        """Return a reader."""
        return TableLogReader(self, time_column, columns, as_text)

    def holds_time(self, time_column: str) -> bool:
        """Return whether a column of this name, or the index, holds the time."""
        return time_column in self.names or self._index(time_column) is not None

    def column(self, name: str, time_column: str = "") -> FloatColumn | list[str]:
        """Return a column: float64 (n,), times in seconds, NaN for nothing; n texts, '' for nothing.

        time_column: the name under which the index goes too. Errors: LogError for what is no column.
        """
        found = self._index(name) if name not in self.names and name == time_column else self._of(name)
        return _cells(found, f"{self.name}: column {name}")

    def _index(self, time_column: str) -> Any:
        index = getattr(self._table, "index", None)
        kind = getattr(getattr(index, "dtype", None), "kind", "")  # M: dates, m: durations
        return index if kind in ("M", "m") or getattr(index, "name", None) == time_column else None

    def _length(self, name: str) -> int:
        try:
            return len(self._of(name))
        except TypeError:
            raise LogError(
                "no column", where=f"{self.name}: {name}", expected="values, one per row"
            ) from None

    def _of(self, name: str) -> Any:
        try:
            return self._table[self._keys.get(name, name)]
        except Exception as error:  # of each library another
            raise LogError("cannot take a column", where=f"{self.name}: {name}", found=str(error)) from None


class TableLogReader(TableReader):
    """Reads a table in memory, so many rows at a time."""

    format = "memory"

    def __init__(
        self, log: TableLog, time_column: str, wanted: Collection[str] | None, as_text: Collection[str]
    ) -> None:
        super().__init__(MemorySource(log.name), time_column, wanted, as_text)
        self._log = log

    def _blocks(self) -> Generator[TableBlock]:
        self.columns = list(self._log.names)
        if self._time_column not in self.columns and self._log.holds_time(self._time_column):
            self.columns.insert(0, self._time_column)
        names = [self.columns[position] for position in self._choose()]
        values = np.full((len(self._log), len(names)), np.nan)
        texts: dict[str, NDArray[np.str_]] = {}
        for position, name in enumerate(names):
            cells = self._log.column(name, self._time_column)
            if not isinstance(cells, list):
                values[:, position] = cells
            elif name in self._as_text:
                texts[name] = np.array(cells, np.str_)
            else:
                values[:, position] = self._numbers(name, cells)
        for first in range(0, len(values), BLOCK_FRAMES):
            rows = slice(first, first + BLOCK_FRAMES)
            numbers = np.arange(first + 1, first + 1 + len(values[rows]))
            yield self._block(names, values[rows], numbers, {name: texts[name][rows] for name in texts})

    def _numbers(self, name: str, cells: list[str]) -> FloatColumn:
        """Return text as numbers, NaN where it is none; what is no number is counted."""
        read = seconds_of if name == self._time_column else number_of
        numbers = np.full(len(cells), np.nan)
        for row, cell in enumerate(cells):
            value = read(cell)
            if value is not None:
                numbers[row] = value
            elif cell.strip():
                self._note_text(name, row + 1, cell)
        return numbers


def _keys_of(table: Any, where: str) -> list[Any]:
    if isinstance(table, Mapping):
        return list(table)
    names = None
    # what can be collected or fetched is a query, no table
    if not (isinstance(table, type) or hasattr(table, "collect") or hasattr(table, "fetchall")):
        # pyarrow's `columns` are the columns, not their names
        names = getattr(table, "column_names", None) or getattr(table, "columns", None)
    if names is None:
        raise LogError("no table", where=where, found=type(table).__name__, expected=_EXPECTED)
    return list(names)


def _cells(column: Any, where: str) -> FloatColumn | list[str]:
    """Return a column as float64, or as text where it is no numbers. Errors: LogError."""
    found = np.asarray(column)
    if found.ndim != 1 or found.dtype.kind == "c":
        shown = f"{found.dtype} of shape {found.shape}"
        raise LogError("no column of numbers, times or text", where=where, found=shown, expected="shape (n,)")
    if found.dtype.kind in "fiub":
        return found.astype(np.float64)
    if found.dtype.kind in "Mm":
        return _seconds(found)
    cells = [None if _is_missing(cell) else cell for cell in found.tolist()]
    first = next((cell for cell in cells if cell is not None), None)
    if isinstance(first, datetime):  # pandas' dates of a time zone are such
        return _floats([None if cell is None else seconds_since_1970(cell) for cell in cells])
    if not isinstance(first, str):
        try:
            return _floats(cells)
        except (TypeError, ValueError):  # numbers and text
            pass
    return ["" if cell is None else str(cell) for cell in cells]


def _floats(cells: list[Any]) -> FloatColumn:
    return np.array([np.nan if cell is None else float(cell) for cell in cells], np.float64)


def _seconds(times: NDArray[Any]) -> FloatColumn:
    """Return dates (since 1970) or durations in seconds, as parquet's are read: to the microsecond."""
    seconds = times.astype(f"{times.dtype.kind}8[us]").astype(np.int64) / 1e6
    seconds[np.isnat(times)] = np.nan
    return np.asarray(seconds)


def _is_missing(cell: Any) -> bool:
    """Return whether a cell holds nothing: None, NaN, NaT, or pandas' NA, which is not even unequal."""
    try:
        return cell is None or bool(cell != cell)  # noqa: PLR0124
    except TypeError:
        return True
