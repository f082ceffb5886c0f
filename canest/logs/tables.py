"""Tables of already decoded signals as csv, since many people hold only those."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Generator, Mapping
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import LogError
from canest.core.table_block import TableBlock
from canest.logs.base import LogReader
from canest.logs.candump import SHOWN_CHARS, SKIPPED_SHOWN
from canest.logs.compression import Source
from canest.logs.line_splitting import text_lines

#: where int64 microseconds end, with room to spare
_SECONDS_MAX = 9e12
#: different texts of a column that are counted
TEXTS_KEPT = 64
_SEPARATORS = (",", ";", "\t")
_NO_TIME = "no time, neither in seconds nor as 2026-03-01T08:15:00.020Z"
_TRUTH = {"false": 0.0, "true": 1.0}


class TableReader(LogReader):
    """What csv and parquet share: cells that hold no number become NaN and are counted per column.

    columns: names in the file. bad_cells: column -> cells without a number (blank, NaN, text, infinite).
    text_cells: column -> those of them that hold text; the line number and the text of the first.
    texts: column -> text -> how many cells hold it, of the first texts that differ.
    as_text: columns that are delivered as text, for their value tables.
    """

    kind = "table"

    def __init__(
        self,
        source: Source,
        time_column: str,
        wanted: Collection[str] | None,
        as_text: Collection[str] = (),
    ) -> None:
        super().__init__(source)
        self._as_text = frozenset(as_text)
        self._time_column, self._wanted = time_column, wanted
        self._rows = self._skipped_lines = 0
        self._skipped: list[tuple[int, str, str]] = []
        self.columns: list[str] = []
        self.bad_cells: dict[str, int] = {}
        self.text_cells: dict[str, tuple[int, int, str]] = {}
        self.texts: dict[str, dict[str, int]] = {}
        self._text_times: dict[int, str] = {}  #: of the block that is being read

    @property
    def frames(self) -> int:
        """Rows so far."""
        return self._rows

    @property
    def skipped_lines(self) -> int:
        """Rows without a time, or with too few or too many cells."""
        return self._skipped_lines

    @property
    def skipped(self) -> list[tuple[int, str, str]]:
        """The first unreadable rows: (line number, text, reason)."""
        return self._skipped

    @property
    def remarks(self) -> list[str]:
        """Which columns hold text where a number is expected."""
        return [
            f"column {name}: {count:,} cells hold text and count as not available, first in row {number}: "
            f"{text[:SHOWN_CHARS]!r}"
            for name, (count, number, text) in self.text_cells.items()
        ]

    def _note_text(self, name: str, number: int, text: str) -> None:
        if name == self._time_column:
            self._text_times[number] = text
            return
        count, first, shown = self.text_cells.get(name, (0, number, text))
        self.text_cells[name] = count + 1, first, shown
        texts = self.texts.setdefault(name, {})
        if text in texts or len(texts) < TEXTS_KEPT:
            texts[text] = texts.get(text, 0) + 1

    def _skip(self, number: int, text: str, reason: str) -> None:
        self._skipped_lines += 1
        if len(self._skipped) < SKIPPED_SHOWN:
            self._skipped.append((number, text[:SHOWN_CHARS], reason))

    def _choose(self) -> list[int]:
        """Return the positions of the columns to read, that of the time first."""
        if self._time_column not in self.columns:
            raise LogError(
                f"the table has no time column {self._time_column!r}",
                where=str(self.path),
                found=", ".join(self.columns[:12]),
                expected="a column of seconds of this name (of a drive's own table the config names it: "
                "sampling.time_column)",
            )
        names = list(dict.fromkeys(name for name in self.columns if name and name != self._time_column))
        chosen = [name for name in names if self._wanted is None or name in self._wanted]
        twice = [name for name in (self._time_column, *chosen) if self.columns.count(name) > 1]
        if twice and self._wanted is not None:
            raise LogError(
                "the table has columns of one name",
                where=str(self.path),
                found=twice[0],
                expected="one of each",
            )
        return [self.columns.index(name) for name in (self._time_column, *chosen)]

    def _block(
        self,
        names: list[str],
        values: NDArray[np.float64],
        numbers: NDArray[np.int64],
        texts: Mapping[str, NDArray[np.str_]],
    ) -> TableBlock:
        """Make a block of rows (n, columns), time first; ``numbers`` are their line numbers.

        texts: the cells (n,) of the columns that go as text, whatever stands for them in ``values``.
        """
        timed = np.isfinite(values[:, 0]) & (np.abs(values[:, 0]) < _SECONDS_MAX)
        for row in np.flatnonzero(~timed).tolist():
            found = self._text_times.get(int(numbers[row]), values[row, 0])
            self._skip(int(numbers[row]), f"{self._time_column} = {found}", _NO_TIME)
        self._text_times.clear()
        if not timed.all():
            values = values[timed]
            texts = {name: cells[timed] for name, cells in texts.items()}
        self._rows += len(values)
        columns = {}
        for index, name in enumerate(names[1:], 1):
            if name in texts:
                continue
            column = np.ascontiguousarray(values[:, index])
            bad = ~np.isfinite(column)
            count = int(bad.sum())
            if count:
                self.bad_cells[name] = self.bad_cells.get(name, 0) + count
                column[bad] = np.nan
            columns[name] = column
        return TableBlock(np.rint(values[:, 0] * 1e6).astype(np.int64), columns, dict(texts))


class CsvReader(TableReader):
    """Separated text with a header line: comma, semicolon (then perhaps decimal commas) or tab."""

    format = "csv"

    def __init__(
        self,
        source: Source,
        head: bytes,
        time_column: str,
        wanted: Collection[str] | None,
        block_rows: int,
        as_text: Collection[str] = (),
    ) -> None:
        super().__init__(source, time_column, wanted, as_text)
        self._head, self._block_rows = head, block_rows
        self._lines_seen = 0

    def _blocks(self) -> Generator[TableBlock]:
        pending: list[str] = []
        header: list[str] | None = None
        for line in text_lines(self._source, self._head, self._cut_off):
            self._lines_seen += 1
            if header is None:
                if line.strip():
                    header = self._read_header(line)
                    chosen = self._choose()
            else:
                pending.append(line)
                if len(pending) >= self._block_rows:
                    yield self._parse(pending, chosen)
                    pending = []
        if pending:
            yield self._parse(pending, chosen)

    def _cut_off(self, line: str) -> None:
        self._skip(self._lines_seen + 1, line, "cut off by the archive's end")

    def _read_header(self, line: str) -> list[str]:
        self._separator = max(_SEPARATORS, key=line.count)
        try:
            names = next(csv.reader([line], delimiter=self._separator))
        except csv.Error as error:
            raise LogError(f"the header cannot be read ({error})", where=str(self.path)) from error
        self.columns = [name.strip() for name in names]
        return self.columns

    def _parse(self, lines: list[str], chosen: list[int]) -> TableBlock:
        """Parse lines at once where numpy can, cell by cell where something stands in the way."""
        first = self._lines_seen - len(lines) + 1
        names = [self.columns[position] for position in chosen]
        if self._separator == ";":
            lines = [line.replace(",", ".") for line in lines]
        found = self._parse_at_once(lines, chosen, names)
        if found is not None:
            values, texts = found
            return self._block(names, values, np.arange(first, first + len(lines)), texts)
        return self._block(names, *self._parse_cells(lines, chosen, names, first))

    def _parse_at_once(
        self, lines: list[str], chosen: list[int], names: list[str]
    ) -> tuple[NDArray[np.float64], dict[str, NDArray[np.str_]]] | None:
        width = len(self.columns) - 1
        if any(not line or line.count(self._separator) != width for line in lines):
            return None
        numeric = [at for at, name in enumerate(names) if name not in self._as_text]
        texts = [at for at, name in enumerate(names) if name in self._as_text]
        if texts and any('"' in line for line in lines):
            return None
        values = np.full((len(lines), len(chosen)), math.nan)
        try:
            values[:, numeric] = np.loadtxt(
                lines,
                delimiter=self._separator,
                usecols=[chosen[at] for at in numeric],
                ndmin=2,
                comments=None,
            )
        except ValueError:
            return None
        cells = [line.split(self._separator) for line in lines] if texts else []
        return values, {names[at]: np.array([row[chosen[at]] for row in cells], np.str_) for at in texts}

    def _parse_cells(
        self, lines: list[str], chosen: list[int], names: list[str], first: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], dict[str, NDArray[np.str_]]]:
        rows: list[list[float]] = []
        numbers: list[int] = []
        texts: dict[str, list[str]] = {name: [] for name in names if name in self._as_text}
        for number, line in enumerate(lines, first):
            if not line.strip():
                continue
            try:
                cells = next(csv.reader([line], delimiter=self._separator))
            except csv.Error as error:
                self._skip(number, line, str(error))
                continue
            if len(cells) != len(self.columns):
                self._skip(number, line, f"{len(cells)} cells where the header has {len(self.columns)}")
                continue
            row = [seconds_of(cells[chosen[0]]), *(number_of(cells[position]) for position in chosen[1:])]
            for position, name, value in zip(chosen, names, row, strict=True):
                if name in texts:
                    texts[name].append(cells[position])
                elif value is None and cells[position].strip():
                    self._note_text(name, number, cells[position])
            rows.append([math.nan if value is None else value for value in row])
            numbers.append(number)
        values = np.array(rows, np.float64).reshape(-1, len(chosen))
        return values, np.array(numbers, np.int64), {n: np.array(t, np.str_) for n, t in texts.items()}


def number_of(cell: str) -> float | None:
    """Return the number in a cell (of a truth value 0 or 1, as parquet has it), None for text and nothing."""
    try:
        return float(cell)
    except ValueError:
        return _TRUTH.get(cell.strip().lower())


def seconds_of(cell: str) -> float | None:
    """Return the time in a cell: a number, or the seconds since 1970 of a date and time (ISO 8601).

    Without a zone it is UTC, as it is in parquet. None for other text and for nothing.
    """
    seconds = number_of(cell)
    if seconds is not None:
        return seconds
    try:
        when = datetime.fromisoformat(cell.strip())
    except ValueError:
        return None
    return (when if when.tzinfo is not None else when.replace(tzinfo=UTC)).timestamp()
