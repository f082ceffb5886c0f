"""What a pipeline gives: one row per 50 Hz sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, IntColumn


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimates with their ticks and gates: one row per 50 Hz sample, all columns (n,)."""

    t_us: IntColumn
    mass_kg: FloatColumn
    mass_std_kg: FloatColumn
    grade: FloatColumn
    grade_std: FloatColumn
    status: NDArray[np.uint8]
    gate: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t_us)

    @staticmethod
    def concatenate(parts: list[Estimates]) -> Estimates:
        """Join in order (an empty list gives no rows)."""
        if len(parts) == 1:
            return parts[0]
        if not parts:
            e = np.empty(0)
            return Estimates(np.empty(0, np.int64), e, e, e, e, np.empty(0, np.uint8), np.empty(0, np.uint8))
        names = Estimates.__slots__
        return Estimates(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))
