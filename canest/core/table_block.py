"""The block of a decoded table, the counterpart of `canest.core.frames.FrameBlock`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, IntColumn


@dataclass(frozen=True, slots=True, eq=False)
class TableBlock:
    """Rows of a table of already decoded signals, in the order of the file.

    t_us: int64 (n,), event time in integer microseconds of the log's clock.
    columns: column name -> float64 (n,), in the units of the file; NaN where the cell holds no number.
    texts: column name -> the cells of a column that was asked for as text (n,); it is not among ``columns``.
    """

    t_us: IntColumn
    columns: dict[str, FloatColumn]
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_us)
