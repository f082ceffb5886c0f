"""Long blocks are taken in pieces that fit the processor's cache; any cut gives the same bits anyway."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from canest.core.samples import EstimateBlock, ModelBlock
from canest.estimators.base import Estimator

CHUNK_SAMPLES = 4096


class ChunkedEstimator(Estimator):
    """Splits what it is given into pieces of at most `CHUNK_SAMPLES` and joins the estimates."""

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples, return their estimates (same length)."""
        n = len(block)
        if n <= CHUNK_SAMPLES:
            return self._update(block)
        parts = [self._update(block[k : k + CHUNK_SAMPLES]) for k in range(0, n, CHUNK_SAMPLES)]
        return EstimateBlock(
            np.concatenate([p.mass_kg for p in parts]),
            np.concatenate([p.mass_std_kg for p in parts]),
            np.concatenate([p.grade for p in parts]),
            np.concatenate([p.grade_std for p in parts]),
            np.concatenate([p.status for p in parts]),
        )

    @abstractmethod
    def _update(self, block: ModelBlock) -> EstimateBlock:
        """As `update`, for a block of at most `CHUNK_SAMPLES`."""
