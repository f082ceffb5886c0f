"""Total least squares, plain or with a noise covariance, over all rows or with forgetting."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from canest.core.errors import ConfigError
from canest.core.frames import FloatColumn
from canest.estimators.papers.rhode2013.rsvd import Rsvd
from canest.estimators.papers.rhode2013.tls_math import NoiseScale, covariance
from canest.estimators.plain.base import P0, PlainEstimator


class _RowByRow(PlainEstimator):
    """The decomposition of [phi y], updated row by row; a start value enters as k rows [U, U theta0]."""

    def __init__(
        self, forgetting: float, noise: ArrayLike | None, start: tuple[ArrayLike | None, ArrayLike] | None
    ) -> None:
        super().__init__()
        self._forgetting, self._noise, self._given = forgetting, noise, start
        self._theta, self._p = np.empty(0), np.empty((0, 0))

    @property
    def theta(self) -> FloatColumn:
        """Return the estimate after the last row, shape (k,); NaN while the rows do not determine it."""
        return self._theta.copy()

    @property
    def P(self) -> FloatColumn:
        """Return the covariance of theta, shape (k, k); infinite while there is no definite one."""
        return self._p.copy()

    def _begin(self, k: int) -> None:
        noise = np.eye(k + 1) if self._noise is None else np.asarray(self._noise, np.float64)
        if noise.shape != (k + 1, k + 1):
            self._refuse("wrong noise", noise.shape, f"a ({k + 1}, {k + 1}) covariance of [phi, y]")
        try:
            scale = NoiseScale.of(noise)
        except ConfigError as error:
            self._refuse("wrong noise", error.found, error.expected)
        factor = float(self._factors(self._forgetting, 1)[0])
        svd, theta = Rsvd(k, factor), np.full(k, np.nan)
        if self._given is not None:
            theta, p = self._start(*self._given, k)
            root = np.linalg.cholesky(np.linalg.inv(p)).T
            svd.add(scale.rows(np.column_stack((root, root @ theta))))
        self._scale, self._svd = scale, svd
        self._theta, self._p = theta, np.full((k, k), np.inf)

    def _learn(self, y: FloatColumn, rows: FloatColumn) -> FloatColumn:
        if not len(y):
            return np.empty(rows.shape)
        x, smallest, gram, weight = self._svd.add(self._scale.rows(np.column_stack((rows, y))))
        found = self._scale.back(x)
        undetermined = np.abs(x).max(axis=1) >= 1e150
        if self._given is None:  # rank below k: any direction of the null space could come out
            undetermined |= np.linalg.eigvalsh(gram)[:, 0] <= 1e-13 * np.linalg.norm(gram, axis=(-2, -1))
        found[undetermined] = np.nan
        last = (x[-1], gram[-1], smallest[-1], weight[-1])
        self._theta = found[-1].copy()
        self._p = self._scale.covariance_back(covariance(*last))
        return found


class TLS(_RowByRow):
    """Total least squares over all rows so far: noise of equal variance in every column of phi and in y.

    theta = -v12 / v22, v the right singular vector of [phi y] with the smallest singular value.
    Source: Rhode and Gauterin 2013, Alg. 1, kept up to date by Alg. 4 with lambda = 1. There is no start
    value: theta is NaN until the rows determine it. `P` is the covariance of theta, noise included:
    (1 + |theta|^2) s^2 (A^T A - m s^2 I)^-1 with s^2 the smallest singular value squared over m rows.
    """

    def __init__(self) -> None:
        super().__init__(1.0, None, None)


class GTLS(_RowByRow):
    """Generalized total least squares over all rows so far: noise of covariance W in [phi y].

    The rows are scaled by C^-1, W = C^T C, solved as in `TLS`, and carried back.
    Source: Rhode and Gauterin 2013, Alg. 2 (W diagonal: WTLS). noise: W, (k + 1, k + 1), symmetric positive
    definite, the columns of phi first and y last; only its proportions matter. theta, `P`: as in `TLS`.
    Errors: UsageError at the first `update` for a W of another size or not positive definite.
    """

    def __init__(self, noise: ArrayLike) -> None:
        super().__init__(1.0, noise, None)


class RTLS(_RowByRow):
    """Recursive total least squares with forgetting.

    As `TLS`, the square of a row weighing lambda times that of the next.
    Source: Rhode and Gauterin 2013, Alg. 4. Their lambda scales rows and so is the square root of this one,
    which is that of `RLS`. theta0: (k,), zeros without it; P0: as in `RLS`, entering as k rows of data.
    `P`: the covariance of theta, as in `TLS`; infinite while there is no definite one.
    """

    def __init__(
        self, forgetting: float = 1.0, *, theta0: ArrayLike | None = None, P0: ArrayLike = P0
    ) -> None:
        super().__init__(forgetting, None, (theta0, P0))


class RGTLS(_RowByRow):
    """Recursive generalized total least squares with forgetting.

    As `GTLS`, the square of a row weighing lambda times that of the next.
    Source: Rhode and Gauterin 2013, Alg. 5. noise: as in `GTLS`; forgetting, theta0, P0, `P`: as in `RTLS`.
    """

    def __init__(
        self,
        noise: ArrayLike,
        forgetting: float = 1.0,
        *,
        theta0: ArrayLike | None = None,
        P0: ArrayLike = P0,
    ) -> None:
        super().__init__(forgetting, noise, (theta0, P0))
