"""Linear least squares on windows: in and out of sample, with standard errors that respect chunks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, IntColumn

Matrix = NDArray[np.float64]
FOLDS = 6


@dataclass(frozen=True)
class Fit:
    """Coefficients of -residual on the regressors, their chunk-robust covariance, and what is left."""

    values: FloatColumn
    covariance: Matrix
    left: FloatColumn


def solve(residual: FloatColumn, regressors: Matrix, chunk: IntColumn) -> Fit:
    """Minimise |residual + regressors p|; sandwich covariance with chunks as clusters."""
    scale = np.sqrt((regressors**2).sum(axis=0))
    scale[scale == 0] = 1.0
    X = regressors / scale
    inverse = np.linalg.pinv(X.T @ X, rcond=1e-10, hermitian=True)
    p = -inverse @ (X.T @ residual)
    left = residual + X @ p
    clusters = int(chunk.max()) + 1 if len(chunk) else 0
    scores = np.zeros((clusters, X.shape[1]))
    np.add.at(scores, chunk, X * left[:, None])
    small_sample = clusters / max(clusters - X.shape[1], 1)
    covariance = small_sample * inverse @ (scores.T @ scores) @ inverse
    return Fit(p / scale, covariance / np.outer(scale, scale), left)


def held_out(
    residual: FloatColumn, regressors: Matrix, chunk: IntColumn, prior: Matrix | None = None
) -> FloatColumn:
    """Return what is left on each window when its fold was not used for the fit (n,).

    prior: further rows (k, columns) of regressors with nothing left over, in every fit: what is known before.
    """
    known = np.zeros((0, regressors.shape[1])) if prior is None else prior
    folds = min(FOLDS, int(chunk.max()) + 1)
    left = residual.copy()
    if regressors.shape[1] == 0 or folds < 2:
        return left
    for fold in range(folds):
        test = chunk % folds == fold
        if test.all() or not test.any():
            continue
        X = np.vstack([regressors[~test], known])
        scale = np.sqrt((X**2).sum(axis=0))
        scale[scale == 0] = 1.0
        wanted = np.append(-residual[~test], np.zeros(len(known)))
        p, *_ = np.linalg.lstsq(X / scale, wanted, rcond=1e-8)
        left[test] = residual[test] + regressors[test] @ (p / scale)
    return left


def chunk_sums(squared: FloatColumn, chunk: IntColumn) -> FloatColumn:
    """Return the sum of a column over each chunk."""
    return np.asarray(np.bincount(chunk, weights=squared), np.float64)
