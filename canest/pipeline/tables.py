"""Decoded tables into the pipeline: the columns that the config's signal map names, in the roles' units.

And the opening of a log, table or frames, as a config wants it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.table_block import TableBlock
from canest.logs.reader import open_log
from canest.pipeline.signal_map import factor_and_offset

if TYPE_CHECKING:
    from canest.config import Config
    from canest.logs.base import LogReader


#: so many rows without one that follows another would take minutes, silence by silence, to no estimate and
#: the reason that fewer get (`canest.doctor.reasons.why_no_time`)
_MANY = 5000


class TableMap:
    """Resolved columns of a config: role -> (column, factor, offset). log: the table, for messages.

    Errors: ConfigError for a unit that does not fit its role.
    """

    def __init__(self, config: Config, log: str | Path = "") -> None:
        self._where = f"{log}: column" if log else "column"
        self._time_column, self._hold_s = config.sampling.time_column, config.sampling.hold_s
        self.roles: dict[str, tuple[str, float, float]] = {}
        for role, source in config.signals.items():
            if source.column is not None:
                factor, offset = factor_and_offset(
                    role, source, source.unit or "", config.at(f"signals.{role}")
                )
                self.roles[role] = source.column, factor, offset

    @property
    def columns(self) -> list[str]:
        """The columns to read."""
        return [column for column, _, _ in self.roles.values()]

    def samples(self, block: TableBlock) -> dict[str, tuple[IntColumn, FloatColumn]]:
        """Return the samples of a block, per role; columns that the table lacks give none.

        Errors: LogError for rows that lie so far apart that none follows another.
        """
        steps_s = np.diff(block.t_us) * 1e-6
        if len(steps_s) >= _MANY and (apart_s := float(np.median(steps_s))) > self._hold_s:
            raise LogError(
                "most rows come more than sampling.hold_s after the one before",
                where=f"{self._where} {self._time_column}",
                found=f"{apart_s:g} s from row to row",
                expected="seconds, or ISO 8601",
            )
        found = {}
        for role, (column, factor, offset) in self.roles.items():
            values = block.columns.get(column)
            if values is not None:
                found[role] = block.t_us, values * factor + offset
        return found


def open_for(config: Config, log: str | Path, channel: str | None = None) -> LogReader:
    """Open a log to be read with a config.

    Errors: LogError for what is no log, or is of a kind that the config has no signals for.
    """
    reader = open_whatever(config, log, channel)
    if reason := wrong_kind(config, reader):
        reader.close()
        raise LogError(reason, where=str(log))
    return reader


def open_whatever(config: Config, log: str | Path, channel: str | None = None) -> LogReader:
    """Open a log of any kind, of a table the columns that a config maps. Errors: LogError."""
    columns = TableMap(config).columns
    return open_log(log, channel=channel, time_column=config.sampling.time_column, columns=columns)


def wrong_kind(config: Config, log: LogReader) -> str:
    """Return why a config has no signal in a log of this kind, frames or table; '' where it may have."""
    columns = sum(source.column is not None for source in config.signals.values())
    if log.kind == "table" and not columns:
        return "the config maps only DBC signals, and this log holds a decoded table"
    if log.kind == "frames" and columns == len(config.signals):
        return "the config maps only table columns, and this log holds frames"
    return ""
