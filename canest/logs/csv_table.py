"""Tables of decoded signals as csv: separated text with a header line."""

from __future__ import annotations

import csv
import math
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import LogError
from canest.core.table_block import TableBlock
from canest.logs.base import KNOWN_LOGS
from canest.logs.cells import number_of, seconds_of
from canest.logs.line_splitting import text_lines
from canest.logs.table_reader import TableFileReader

_SEPARATORS = (",", ";", "\t")


class CsvReader(TableFileReader):
    """Separated text with a header line: comma, semicolon (then perhaps decimal commas) or tab."""

    format = "csv"
    unless_a_table = "no log format that canest knows; read as a table of decoded signals, "
    else_expected = f"; or a log: {KNOWN_LOGS}"

    def _blocks(self) -> Generator[TableBlock]:
        self._lines_seen = 0
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
