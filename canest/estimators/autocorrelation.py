"""Inflation of variances by autocorrelation, from how often the innovations change their sign.

P times the noise variance (Ljung) counts every row as independent. Rows at 50 Hz behind a low-pass of a
few hertz are not: the innovation stays on one side of zero for many rows. White noise has one run of a
sign per two rows; so a stretch with fewer runs holds as many independent rows as twice its runs, and
variances grow by rows / (2 runs). Signs do not care how large an outlier is.
"""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn


class AutocorrelationInflation:
    """Counts rows and runs of one sign since the start of learning; carries both over blocks."""

    def __init__(self) -> None:
        self._rows, self._runs, self._positive = 0, 1, False

    def __call__(self, innovation: FloatColumn) -> FloatColumn:
        """Return the factor (at least 1) for the variances after each row, shape (k,)."""
        k = len(innovation)
        positive = innovation > 0.0
        before = np.concatenate(([self._positive], positive))[:k]
        runs = self._runs + np.cumsum(positive != before)
        rows = self._rows + np.arange(1, k + 1)
        if k:
            self._rows, self._runs, self._positive = int(rows[-1]), int(runs[-1]), bool(positive[-1])
        return np.maximum(rows / (2.0 * runs), 1.0)
