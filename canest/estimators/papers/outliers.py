"""Distance-based outlier detection on small batches (2013 paper, section IV-B; Knorr and Ng's nested loop).

A row is an outlier when fewer than ``neighbours`` other rows of its batch lie within ``distance`` of it,
in standard scores. The scores come from the recursive mean (eq. 12) and covariance (eq. 13) of all rows
so far. Slip in the paper: eq. 13 is not centred (it averages Z'Z, the second moment); here it is, by
Welford's update. The price is the paper's too: what is learned lags by up to one batch.
"""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.estimators.description import option


class OutlierOptions(BaseModel):
    """Options of the detector."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    batch: int = option(25, "rows per batch", ge=3, le=1000)
    distance: float = option(1.0, "radius of the neighbourhood, standard deviations", gt=0.0)
    neighbours: int = option(3, "least number of neighbours of a good row", ge=1)


class RunningMoments:
    """Recursive sample mean (2013, eq. 12) and centred variance (eq. 13, corrected) of rows, shape (q,)."""

    def __init__(self, columns: int) -> None:
        self.count = 0
        self.mean = np.zeros(columns)
        self._squares = np.zeros(columns)

    def add(self, row: FloatColumn) -> None:
        """Take one row, shape (q,)."""
        self.count += 1
        before = row - self.mean
        self.mean = self.mean + before / self.count  # (t-1)/t mean + 1/t row
        self._squares = self._squares + before * (row - self.mean)

    @property
    def std(self) -> FloatColumn:
        """Return the standard deviation per column, 1 where a column has not varied."""
        std = np.sqrt(self._squares / max(1, self.count))
        # a column that never varied to within round-off of its own size has no scale of its own
        flat = std <= 1e-9 * (np.abs(self.mean) + 1e-30)
        return np.asarray(np.where(flat, 1.0, std))


def outliers(scores: FloatColumn, distance: float, neighbours: int) -> BoolColumn:
    """Return True for each outlier among rows of standard scores, shape (m, q) -> (m,)."""
    gap = scores[:, None, :] - scores[None, :, :]
    near = np.einsum("ijk,ijk->ij", gap, gap) <= distance * distance
    return np.asarray(near.sum(axis=1) - 1 < neighbours)


class OutlierStage:
    """Cuts rows into batches of fixed size, drops outliers; rows come out when their batch is full."""

    def __init__(self, options: OutlierOptions, columns: int) -> None:
        self._options = options
        self._moments = RunningMoments(columns)
        self._rows: list[FloatColumn] = []
        self.dropped = 0

    def __call__(self, at: IntColumn, rows: FloatColumn) -> tuple[IntColumn, FloatColumn]:
        """Take rows, shape (k, q), at positions ``at``; return the kept rows of the batches they filled.

        A kept row's position is that of the row that filled its batch: only then is it known.
        """
        size = self._options.batch
        positions: list[int] = []
        kept: list[FloatColumn] = []
        for position, row in zip(at.tolist(), rows, strict=True):
            self._moments.add(row)
            self._rows.append(row)
            if len(self._rows) == size:
                batch = np.array(self._rows)
                scores = (batch - self._moments.mean) / self._moments.std
                good = batch[~outliers(scores, self._options.distance, self._options.neighbours)]
                self.dropped += size - len(good)
                kept.extend(good)
                positions.extend([position] * len(good))
                self._rows = []
        shape = (len(kept), rows.shape[1])
        return np.array(positions, np.int64), np.array(kept).reshape(shape)
