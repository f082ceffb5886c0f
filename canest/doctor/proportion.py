"""How many times as large one quantity is as another, over a stream of both."""

from __future__ import annotations

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn

#: pairs needed before a comparison counts
MIN_PAIRS = 100


class Proportion:
    """Least squares through zero; memory does not grow with the log."""

    def __init__(self) -> None:
        self._pairs, self._product, self._square = 0, 0.0, 0.0

    def add(self, values: FloatColumn, of: FloatColumn, kept: BoolColumn) -> None:
        """Take simultaneous values of both quantities (n,), those that are kept and known."""
        both = np.isfinite(values) & np.isfinite(of) & kept
        self._pairs += int(np.count_nonzero(both))
        self._product += float(values[both] @ of[both])
        self._square += float(of[both] @ of[both])

    @property
    def times(self) -> float | None:
        """By which the values are larger, None where too few pairs have come."""
        if self._pairs < MIN_PAIRS or not self._square:
            return None
        return self._product / self._square
