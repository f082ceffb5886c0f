"""Tables of already decoded signals: what csv and parquet share, since many people hold only those."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import LogError
from canest.core.table_block import TableBlock
from canest.logs.base import SHOWN_CHARS, CountingReader
from canest.logs.compression import Source

#: where int64 microseconds end, with room to spare
_SECONDS_MAX = 9e12
#: different texts of a column that are counted
TEXTS_KEPT = 64
_NO_TIME = "no time, neither in seconds nor as 2026-03-01T08:15:00.020Z"


class TableReader(CountingReader):
    """What csv and parquet share: cells that hold no number become NaN and are counted per column.

    columns: names in the file. bad_cells: column -> cells without a number (blank, NaN, text, infinite).
    text_cells: column -> those of them that hold text; the line number and the text of the first.
    texts: column -> text -> how many cells hold it, of the first texts that differ.
    as_text: columns that are delivered as text, for their value tables.
    """

    kind = "table"
    #: what else may be wrong where a file that is read as a table is none, and what else it might be
    unless_a_table = else_expected = ""

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
        self.columns: list[str] = []
        self.bad_cells: dict[str, int] = {}
        self.text_cells: dict[str, tuple[int, int, str]] = {}
        self.texts: dict[str, dict[str, int]] = {}
        self._text_times: dict[int, str] = {}  #: of the block that is being read

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

    def _choose(self) -> list[int]:
        """Return the positions of the columns to read, that of the time first."""
        if self._time_column not in self.columns:
            raise LogError(
                f"{self.unless_a_table}the table has no time column {self._time_column!r}",
                where=str(self.path),
                found=", ".join(self.columns[:12]),
                expected="a column of seconds of this name (of a drive's own table the config names it: "
                f"sampling.time_column){self.else_expected}",
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
        self._frames += len(values)
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


class TableFileReader(TableReader):
    """A table in a file. head: its first bytes, already read. block_rows: how many make a block."""

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
