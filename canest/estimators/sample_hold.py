"""Rows to samples: the estimate of a sample is that of the last row learned at or before it."""

from __future__ import annotations

import numpy as np

from canest.core.frames import IntColumn


def rows_until(at: IntColumn, n: int) -> IntColumn:
    """Return how many rows lie at or before each of n samples; ``at`` are the rows' positions, in order."""
    return np.cumsum(np.bincount(at, minlength=n))
