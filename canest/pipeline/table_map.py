"""Decoded tables into the pipeline: the columns that the config's signal map names, in the roles' units.

And the opening of a log, table or frames, as a config wants it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.nearest_name import nearest_names
from canest.core.roles import ROLES
from canest.core.table_block import TableBlock
from canest.decode.value_table import Label, TextTable
from canest.logs.base import KNOWN_LOGS, SHOWN_CHARS
from canest.logs.cells import number_of
from canest.logs.format_detection import open_log
from canest.logs.table_in_memory import TableLog
from canest.logs.table_reader import TEXTS_KEPT
from canest.pipeline.signal_map import factor_and_offset, unit_of
from canest.pipeline.signal_timing import hold_us

if TYPE_CHECKING:
    from canest.config import Config
    from canest.logs.base import LogReader
    from canest.logs.memory import MemoryLog


#: so many rows without one that follows another would take minutes, silence by silence, to no estimate and
#: the reason that fewer get (`canest.doctor.reasons.why_no_time`)
_MANY = 5000
#: a name of a column is a slip of a role's where they are so much alike, of 1
_SLIP = 0.9
#: cells without a value that a note names
_SHOWN = 6


class TableMap:
    """Resolved columns of a config: role -> (column, factor, offset). log: the table, for messages.

    values: role -> the value table of its column. seen: role -> cell of such a column (text or number) ->
    how often, of the first `TEXTS_KEPT` that differ. without_value: role -> cells that it does not list.

    Errors: ConfigError for a unit that does not fit its role.
    """

    def __init__(self, config: Config, log: str | Path | MemoryLog = "") -> None:
        self._where = f"{log}: column" if log else "column"
        self._time_column, self._hold_s = config.sampling.time_column, hold_us(config) * 1e-6
        self._names = log.names if isinstance(log, TableLog) else ()
        self._signals = config.signals
        self.roles: dict[str, tuple[str, float, float]] = {}
        self.values: dict[str, TextTable] = {}
        self.seen: dict[str, dict[str | float, int]] = {}
        self.without_value: dict[str, int] = {}
        for role, source in config.signals.items():
            if source.column is not None:
                where = config.at(f"signals.{role}")
                factor, offset = factor_and_offset(role, source, unit_of(source), where)
                self.roles[role] = source.column, factor, offset
                if source.map:
                    self.values[role] = TextTable(source.map)

    @property
    def columns(self) -> list[str]:
        """The columns to read."""
        return [column for column, _, _ in self.roles.values()]

    @property
    def text_columns(self) -> list[str]:
        """Those of them that are read as text, since a value table gives their meaning."""
        return [self.roles[role][0] for role in self.values]

    def labels(self, role: str) -> list[Label]:
        """Return the cells of a column with a value table, commonest first, and what each counts as."""
        found = sorted(self.seen.get(role, {}).items(), key=lambda item: -item[1])
        numbers = ((cell, count, self.values[role].number(cell)) for cell, count in found)
        return [
            Label(str(cell), str(cell), count, None if np.isnan(number) else number)
            for cell, count, number in numbers
        ]

    def warnings(self) -> list[str]:
        """Return which columns of a table in memory are named by a slip, and which cells no map lists."""
        used = {*ROLES, *(source.column for source in self._signals.values())}
        warnings = [
            f"column {name} is not used: perhaps it is {role}"
            for name in self._names
            if name not in used
            for role in nearest_names(name, ROLES, cutoff=_SLIP)[:1]
            if role not in self._signals
        ]
        for role, count in self.without_value.items():
            unlisted = [cell for cell in self.seen[role] if np.isnan(self.values[role].number(cell))]
            shown = ", ".join(map(_shown, unlisted[:_SHOWN])) + (", ..." if unlisted[_SHOWN:] else "")
            warnings.append(
                f"column {self.roles[role][0]}: {count:,} cells are not in signals.{role}.map and count as "
                f"not available: {shown}"
            )
        return warnings

    def samples(self, block: TableBlock) -> dict[str, tuple[IntColumn, FloatColumn]]:
        """Return the samples of a block, per role; columns that the table lacks give none.

        Errors: LogError for rows that lie so far apart that none follows another.
        """
        steps_s = np.diff(block.t_us) * 1e-6
        if len(steps_s) >= _MANY and (apart_s := float(np.median(steps_s))) > self._hold_s:
            raise LogError(
                f"most rows come more than {self._hold_s:g} s (hold_s, period_s) after the one before",
                where=f"{self._where} {self._time_column}",
                found=f"{apart_s:g} s from row to row",
                expected="seconds, or ISO 8601",
            )
        found = {}
        for role, (column, factor, offset) in self.roles.items():
            if role in self.values:
                values = self._mapped(role, column, block)
            elif column in block.texts:  # another role has a map for it
                numbers = map(number_of, block.texts[column].tolist())
                values = np.array([math.nan if n is None else n for n in numbers], np.float64)
            else:
                values = block.columns.get(column)
            if values is not None:
                with np.errstate(over="ignore"):  # a cell may hold any number
                    converted = values * factor + offset
                found[role] = block.t_us, np.where(np.isfinite(converted), converted, np.nan)
        return found

    def _mapped(self, role: str, column: str, block: TableBlock) -> FloatColumn | None:
        """Return what the cells of a column mean (n,), NaN for those that the map does not list."""
        cells = block.texts.get(column, block.columns.get(column))
        if cells is None:
            return None
        unique, inverse, counts = np.unique(cells, return_inverse=True, return_counts=True)
        numbers = np.array([self.values[role].number(cell) for cell in unique.tolist()], np.float64)
        seen = self.seen.setdefault(role, {})
        for cell, number, count in zip(unique.tolist(), numbers.tolist(), counts.tolist(), strict=True):
            empty = not cell.strip() if isinstance(cell, str) else np.isnan(cell)
            if empty:
                continue
            if cell in seen or len(seen) < TEXTS_KEPT:
                seen[cell] = seen.get(cell, 0) + count
            if np.isnan(number):
                self.without_value[role] = self.without_value.get(role, 0) + count
        return np.asarray(numbers[inverse.reshape(-1)], np.float64)


def _shown(cell: str | float) -> str:
    return repr(cell[:SHOWN_CHARS]) if isinstance(cell, str) else f"{cell:g}"


def open_for(config: Config, log: str | Path | MemoryLog, channel: str | None = None) -> LogReader:
    """Open a log to be read with a config.

    Errors: LogError for what is no log, or is of a kind that the config has no signals for.
    """
    reader = open_whatever(config, log, channel)
    if reason := wrong_kind(config, reader):
        reader.close()
        raise LogError(reason, where=str(log))
    return reader


def open_whatever(config: Config, log: str | Path | MemoryLog, channel: str | None = None) -> LogReader:
    """Open a log of any kind, of a table the columns that a config maps. Errors: LogError."""
    table = TableMap(config)
    return open_log(
        log,
        channel=channel,
        time_column=config.sampling.time_column,
        columns=table.columns,
        as_text=table.text_columns,
    )


def wrong_kind(config: Config, log: LogReader) -> str:
    """Return why a config has no signal in a log of this kind, frames or table; '' where it may have."""
    columns = sum(source.column is not None for source in config.signals.values())
    if log.kind == "table" and not columns:
        if log.format == "csv":  # any text may be read as one
            return (
                f"no log of frames ({KNOWN_LOGS}). Is it a table of decoded signals? Name its columns in "
                "the config (signals.ROLE.column), which maps only DBC signals"
            )
        estimate = " (canest.estimate takes it by the names of roles)" if log.format == "memory" else ""
        return f"the config maps only DBC signals, and this log holds a decoded table{estimate}"
    if log.kind == "frames" and columns == len(config.signals):
        return "the config maps only table columns, and this log holds frames"
    return ""
