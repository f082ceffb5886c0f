"""Total least squares of a whole batch by numpy's SVD: what the recursive forms are held against."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.estimators.papers.rhode2013.tls_math import NoiseScale, covariance


def solve(a: FloatColumn, b: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
    """Basic TLS (2013, Alg. 1): return X (n,) and cov(X) (n, n) of A (m, n), B (m,).

    X is inf where there is no generic solution (V22 = 0).
    """
    z = np.column_stack((a, b))
    _, s, vt = np.linalg.svd(z, full_matrices=len(z) < z.shape[1])
    v = vt[-1]
    smallest = s[-1] if len(s) == z.shape[1] else 0.0
    x = -v[:-1] / v[-1] if v[-1] != 0.0 else np.full(a.shape[1], np.inf)
    if not np.isfinite(x).all():
        return x, np.full((a.shape[1], a.shape[1]), np.inf)
    return x, covariance(x, a.T @ a, np.array(smallest), np.array(float(len(z))))


def solve_generalized(a: FloatColumn, b: FloatColumn, noise: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
    """GTLS (2013, Alg. 2; W diagonal: WTLS): return X (n,) and cov(X) (n, n), both in original units."""
    scale = NoiseScale.of(noise)
    z = scale.rows(np.column_stack((a, b)))
    x, cov = solve(z[:, :-1], z[:, -1])
    return scale.back(x), scale.covariance_back(cov)


def correction(a: FloatColumn, b: FloatColumn) -> FloatColumn:
    """Return the TLS data correction [dA dB] = [A B] v v^T of 2013, eq. 6 (no U needed), shape (m, q)."""
    z = np.column_stack((a, b))
    v = np.linalg.svd(z)[2][-1]
    return np.asarray(np.outer(z @ v, v))
