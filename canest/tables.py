"""Decoded tables into the pipeline: the columns that the config's signal map names, in the roles' units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.decode.signal_map import factor_and_offset
from canest.frames import FloatColumn, IntColumn
from canest.logs.blocks import TableBlock

if TYPE_CHECKING:
    from canest.config import Config


class TableMap:
    """Resolved columns of a config: role -> (column, factor, offset).

    Errors: ConfigError for a unit that does not fit its role.
    """

    def __init__(self, config: Config) -> None:
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
        """Return the samples of a block, per role; columns that the table lacks give none."""
        found = {}
        for role, (column, factor, offset) in self.roles.items():
            values = block.columns.get(column)
            if values is not None:
                found[role] = block.t_us, values * factor + offset
        return found
