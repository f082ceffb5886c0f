"""The decoded signals of a log, held on the 50 Hz grid."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import FloatColumn, FrameBlock, IntColumn
from canest.grid.grid import Grid, GridBlock
from canest.pipeline.build import grid_spec, intake_spec
from canest.pipeline.intake import Intake
from canest.pipeline.table_map import TableMap, open_for

if TYPE_CHECKING:
    from canest.config import Config
    from canest.logs.base import LogReader
    from canest.logs.memory import MemoryLog
    from canest.offline.log_run import Progress


def read_signals(
    log: str | Path | MemoryLog, config: Config, channel: str | None = None
) -> tuple[IntColumn, dict[str, FloatColumn]]:
    """Return t_us int64 (n,) and role -> float64 (n,), NaN where there is no value. Errors: LogError."""
    ticks = list(_ticks(log, config, channel))
    t_us = np.concatenate([block.t_us for block in ticks]) if ticks else np.empty(0, np.int64)
    return t_us, {
        role: np.concatenate([block.values[role] for block in ticks]) if ticks else np.empty(0)
        for role in config.signals
    }


def _ticks(log: str | Path | MemoryLog, config: Config, channel: str | None) -> Iterator[GridBlock]:
    spec = grid_spec(config)
    grid = Grid(spec.channels, spec.hold_us)
    reader = open_for(config, log, channel)
    yield from ticks_of(reader, TableMap(config, log), Intake(intake_spec(config)), grid)


def ticks_of(
    reader: LogReader, tables: TableMap, intake: Intake, grid: Grid, progress: Progress | None = None
) -> Iterator[GridBlock]:
    """Yield the ticks of a log, and close its reader. progress: takes bytes done, and bytes in all."""
    with closing(reader):
        for block in reader:
            if isinstance(block, FrameBlock):
                feeds = intake.frames(block)
            else:
                feeds = intake.table(tables.samples(block), block.t_us)
            for feed in feeds:
                yield from grid.take(feed)
            if progress is not None:
                progress(reader.bytes_done, reader.bytes_total)
    if intake.clock.last_us is not None:
        left = grid.ticks_until(intake.clock.last_us, inclusive=True)
        if left is not None:
            yield left
