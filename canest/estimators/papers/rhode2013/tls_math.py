"""Total least squares as formulas: batch solutions, scaling by a noise covariance, parameter covariance.

A X ~ B with noise in both; Z = [A B] has n + 1 = q columns. Slips in the 2013 paper, put right here:
sigma^2 is the *square* of the smallest singular value over m (Alg. 1 line 6, Alg. 4 line 7 lack the
square); Alg. 2 and 5 return the covariance in the transformed space, here it is carried back; with
forgetting, m is the sum of the weights, not t (Alg. 4 line 7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canest.core.errors import ConfigError
from canest.core.frames import FloatColumn


@dataclass(frozen=True, slots=True)
class NoiseScale:
    """C^-1 for W = C^T C, cut into blocks (2013, Alg. 2 lines 2-3): c11 (n, n), c12 (n,), c22."""

    c11: FloatColumn
    c12: FloatColumn
    c22: float

    @staticmethod
    def of(noise: FloatColumn) -> NoiseScale:
        """Return the scale of the noise covariance W of [A B], shape (q, q).

        Errors: ConfigError when W is not symmetric positive definite.
        """
        noise = np.asarray(noise, np.float64)
        square = noise.ndim == 2 and noise.shape[0] == noise.shape[1]
        if not square or not np.allclose(noise, noise.T, rtol=1e-9, atol=0.0) or not _definite(noise):
            raise ConfigError(
                "noise covariance W is not usable",
                where="estimator.options",
                found=noise.tolist(),
                expected="a symmetric positive definite matrix",
            )
        inverse = np.linalg.inv(np.linalg.cholesky(noise).T)
        return NoiseScale(inverse[:-1, :-1], inverse[:-1, -1], float(inverse[-1, -1]))

    def rows(self, z: FloatColumn) -> FloatColumn:
        """Return [A' B'] = [A B] C^-1, shape (k, q); column by column: any cut gives the same bits."""
        n = len(self.c12)
        out = np.empty_like(z)
        for j in range(n):
            out[:, j] = z[:, 0] * self.c11[0, j]
            for i in range(1, j + 1):
                out[:, j] += z[:, i] * self.c11[i, j]
        out[:, n] = z[:, n] * self.c22
        for i in range(n):
            out[:, n] += z[:, i] * self.c12[i]
        return out

    def back(self, x: FloatColumn) -> FloatColumn:
        """Return X = (C11 X' - C12) / C22 (Alg. 2 line 7), shape (..., n)."""
        columns = []
        for i in range(len(self.c12)):
            total = x[..., i] * self.c11[i, i]
            for j in range(i + 1, len(self.c12)):
                total = total + x[..., j] * self.c11[i, j]
            columns.append((total - self.c12[i]) / self.c22)
        return np.stack(columns, axis=-1)

    def covariance_back(self, covariance: FloatColumn) -> FloatColumn:
        """Return cov(X) = C11 cov(X') C11^T / C22^2, which Alg. 2 and 5 leave out, shape (..., n, n).

        A covariance that is not finite stays infinite.
        """
        known = np.isfinite(covariance).all(axis=(-2, -1), keepdims=True)
        back = self.c11 @ np.where(known, covariance, 0.0) @ self.c11.T / self.c22**2
        return np.where(known, back, np.inf)


def _definite(matrix: FloatColumn) -> bool:
    return bool(np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 0.0)


def covariance(x: FloatColumn, gram: FloatColumn, smallest: FloatColumn, weight: FloatColumn) -> FloatColumn:
    """Return cov(X) ~ (1 + |X|^2) sigma^2 (A^T A - m sigma^2 I)^-1, (..., n, n); inf where not definite.

    x: (..., n). gram: A^T A, (..., n, n). smallest: the smallest singular value of [A B], (...). weight: m,
    the number of rows or, with forgetting, the sum of their weights. sigma^2 = smallest^2 / m.
    """
    variance, inverse = spread(x, gram, smallest, weight)
    product = np.full(inverse.shape, np.inf)
    np.multiply(variance[..., None, None], inverse, out=product, where=np.isfinite(inverse))
    return product


def spread(
    x: FloatColumn, gram: FloatColumn, smallest: FloatColumn, weight: FloatColumn
) -> tuple[FloatColumn, FloatColumn]:
    """Return the factors of `covariance`: a row's error variance (...), and the inverse (..., n, n)."""
    n = x.shape[-1]
    variance = smallest * smallest / np.maximum(weight, 1.0)
    core = gram - (weight * variance)[..., None, None] * np.eye(n)
    lowest = np.linalg.eigvalsh(core)[..., :1]
    definite = lowest[..., 0] > 1e-12 * np.trace(gram, axis1=-2, axis2=-1)
    safe = np.where(definite[..., None, None], core, np.eye(n))
    scale = (1.0 + np.sum(x * x, axis=-1)) * variance
    return np.asarray(scale), np.where(definite[..., None, None], np.linalg.inv(safe), np.inf)


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
