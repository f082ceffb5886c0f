"""The block of a decoded table, the counterpart of `canest.core.frames.FrameBlock`."""

from __future__ import annotations

from dataclasses import dataclass

from canest.core.frames import FloatColumn, IntColumn


@dataclass(frozen=True, slots=True)
class TableBlock:
    """Rows of a table of already decoded signals, in the order of the file.

    t_us: int64 (n,), event time in integer microseconds of the log's clock.
    columns: column name -> float64 (n,), in the units of the file; NaN where the cell holds no number.
    """

    t_us: IntColumn
    columns: dict[str, FloatColumn]

    def __len__(self) -> int:
        return len(self.t_us)
