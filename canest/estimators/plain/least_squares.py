"""Least squares: batch, recursive with one forgetting factor, and with one per parameter."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack
from canest.estimators.papers.rhode2013.multiple_forgetting import MultipleForgetting
from canest.estimators.plain.base import P0, PlainEstimator


class _MatrixForgetting(PlainEstimator):
    """Recursive least squares with a full covariance that is scaled element by element after each row."""

    def __init__(self, forgetting: ArrayLike, theta0: ArrayLike | None, P0: ArrayLike) -> None:
        super().__init__()
        self._forgetting, self._theta0, self._P0 = forgetting, theta0, P0
        self._theta: list[float] = []
        self._p: list[float] = []

    @property
    def theta(self) -> FloatColumn:
        """Return the estimate after the last row, shape (k,)."""
        return unpack(self._theta)

    @property
    def P(self) -> FloatColumn:
        """Return the covariance after the last row, over the variance of y's noise, shape (k, k)."""
        return unpack(self._p).reshape(self._k, self._k)

    def _scale(self, k: int) -> FloatColumn:
        """Return what the elements of P are multiplied with after a row, (k, k)."""
        raise NotImplementedError

    def _begin(self, k: int) -> None:
        self._scales = self._scale(k)
        theta, p = self._start(self._theta0, self._P0, k)
        self._theta, self._p = theta.tolist(), p.ravel().tolist()

    def _learn(self, y: FloatColumn, rows: FloatColumn) -> FloatColumn:
        n, k = rows.shape
        (out,), theta, p = outputs(n * k, 1), state_in(self._theta), state_in(self._p)
        rank_one_updates(*pack(y, rows, self._scales), theta, p, state_in([0.0] * k), out)
        self._theta, self._p = state_out(theta), state_out(p)
        return unpack(out).reshape(n, k)


class RLS(_MatrixForgetting):
    """Recursive least squares with one forgetting factor lambda.

        L = P phi / (lambda + phi^T P phi)
        theta <- theta + L (y - phi^T theta)
        P <- (I - L phi^T) P / lambda

    Source: Vahidi et al. 2005, eqs. 10-11 (lambda = 1: eqs. 6-8); Rhode and Gauterin 2013, Alg. 6.
    forgetting: lambda, above 0, at most 1; about 1 / (1 - lambda) rows count.
    theta0: (k,), zeros without it. P0: a number times the identity, k numbers for the diagonal, or (k, k), in
    theta^2 / y^2. `P` times the variance of y's noise is the covariance of theta.
    Without excitation and with lambda < 1, P grows without bound (section 4.1 of the 2005 paper).
    Errors: UsageError at the first `update` for values or sizes that do not fit.

    >>> rls = RLS(forgetting=0.99)
    >>> theta = rls.update([2.0, 4.1, 5.9], [[1.0, 0.0], [2.0, 0.1], [3.0, -0.1]])
    >>> theta.shape
    (3, 2)
    """

    def __init__(
        self, forgetting: float = 1.0, *, theta0: ArrayLike | None = None, P0: ArrayLike = P0
    ) -> None:
        super().__init__(forgetting, theta0, P0)

    def _scale(self, k: int) -> FloatColumn:
        factor = self._factors(self._forgetting, 1)[0]
        self._factor = float(factor)
        return np.full((k, k), 1.0 / factor)

    def _begin(self, k: int) -> None:
        super()._begin(k)
        # with P / lambda for P, eq. 10 becomes eq. 7
        self._p = [value / self._factor for value in self._p]

    @property
    def P(self) -> FloatColumn:
        """Return the covariance after the last row, over the variance of y's noise, shape (k, k)."""
        return super().P * (self._factor if self._k else 1.0)


class VectorRLS(_MatrixForgetting):
    """Recursive least squares with vector-type forgetting.

        L = P phi / (1 + phi^T P phi)
        theta <- theta + L (y - phi^T theta)
        P <- Lambda^-1 (I - L phi^T) P Lambda^-1,   Lambda = diag(lambda_i)

    Source: Vahidi et al. 2005, eq. 12, after Saelid and Foss.
    forgetting: lambda, one number or k of them, above 0, at most 1. Lambda stands on both sides, so a factor
    here is the square root of one of `RLS`. theta0, P0, `P`, errors: as in `RLS`; `P` is already discounted
    for the next row.
    """

    def __init__(
        self, forgetting: ArrayLike = 1.0, *, theta0: ArrayLike | None = None, P0: ArrayLike = P0
    ) -> None:
        super().__init__(forgetting, theta0, P0)

    def _scale(self, k: int) -> FloatColumn:
        inverse = 1.0 / self._factors(self._forgetting, k)
        return np.outer(inverse, inverse)


class RLSMF(PlainEstimator):
    """Recursive least squares with multiple forgetting: each parameter has its own factor and variance.

        L = [P_1 phi_1 / lambda_1, ...] / (1 + sum_j P_j phi_j^2 / lambda_j)
        theta <- theta + L (y - phi^T theta), then projected onto the bounds
        P_i <- (1 - l_i phi_i) P_i / lambda_i

    with l_i = (P_i phi_i) / (lambda_i + P_i phi_i^2) for ``gain="own"`` (Vahidi et al. 2005, eqs. 17-23,
    there for two parameters) and l_i = L_i for ``gain="joint"`` (Rhode and Gauterin 2013, Alg. 7; bounds:
    Alg. 8).

    forgetting: one number or k of them, above 0, at most 1. theta0: (k,), zeros without it. P0: a number or k
    of them, theta^2 / y^2; `P` is diagonal. low, high: bounds of theta, a number or k of them.
    Errors: UsageError at the first `update` for values or sizes that do not fit.
    """

    def __init__(
        self,
        forgetting: ArrayLike = 1.0,
        *,
        gain: Literal["own", "joint"] = "own",
        theta0: ArrayLike | None = None,
        P0: ArrayLike = P0,
        low: ArrayLike = -np.inf,
        high: ArrayLike = np.inf,
    ) -> None:
        super().__init__()
        if gain not in ("own", "joint"):
            self._refuse("wrong gain", gain, "own or joint")
        self._joint, self._forgetting = gain == "joint", forgetting
        self._theta0, self._P0, self._bounds = theta0, P0, (low, high)
        self._theta = np.empty(0)

    @property
    def theta(self) -> FloatColumn:
        """Return the estimate after the last row, shape (k,)."""
        return self._theta.copy()

    @property
    def P(self) -> FloatColumn:
        """Return the covariance after the last row, over the variance of y's noise, (k, k), diagonal."""
        return np.diag(self._learner.p) if self._k else np.empty((0, 0))

    def _begin(self, k: int) -> None:
        theta, p = self._start(self._theta0, self._P0, k)
        if np.count_nonzero(p - np.diag(np.diag(p))):
            self._refuse("wrong P0", p.tolist(), f"a number, or {k} of them: this covariance is diagonal")
        if any(np.size(bound) not in (1, k) for bound in self._bounds):
            self._refuse(
                "wrong size of low or high", [np.shape(b) for b in self._bounds], f"1 or {k} numbers"
            )
        low, high = (np.broadcast_to(np.ravel(np.asarray(b, np.float64)), (k,)).copy() for b in self._bounds)
        factors = self._factors(self._forgetting, k)
        self._learner = MultipleForgetting(
            theta, np.diag(p).copy(), factors, low, high, np.full(k, np.inf), 0.0, joint=self._joint
        )
        self._theta = theta

    def _learn(self, y: FloatColumn, rows: FloatColumn) -> FloatColumn:
        found, _ = self._learner.add(np.ascontiguousarray(rows), y)
        if len(found):
            self._theta = found[-1].copy()
        return found


class BatchLS(PlainEstimator):
    """Least squares over all rows so far: theta minimises sum (y - phi^T theta)^2.

    Source: Vahidi et al. 2005, eq. 5. The rows are kept as their triangular factor, so memory does not grow.
    There is no start value: theta is NaN until the rows determine it. `P` is (sum phi phi^T)^-1; times the
    variance of y's noise it is the covariance of theta; infinite on the diagonal before.
    """

    def __init__(self) -> None:
        super().__init__()
        self._theta = np.empty(0)

    @property
    def theta(self) -> FloatColumn:
        """Return the estimate after the last row, shape (k,); NaN while the rows do not determine it."""
        return self._theta.copy()

    @property
    def P(self) -> FloatColumn:
        """Return (sum phi phi^T)^-1, shape (k, k)."""
        if np.isnan(self._theta).any():
            return np.diag(np.full(self._k, np.inf))
        inverse = np.linalg.inv(self._factor[: self._k, : self._k]) if self._k else np.empty((0, 0))
        return np.asarray(inverse @ inverse.T)

    def _begin(self, k: int) -> None:
        self._factor, self._theta = np.empty((0, k + 1)), np.full(k, np.nan)

    def _learn(self, y: FloatColumn, rows: FloatColumn) -> FloatColumn:
        found = np.empty(rows.shape)
        for i, row in enumerate(np.column_stack((rows, y))):
            self._factor = np.asarray(np.linalg.qr(np.vstack((self._factor, row)), mode="r"))
            self._theta = self._solution()
            found[i] = self._theta
        return found

    def _solution(self) -> FloatColumn:
        k = self._k or self._factor.shape[1] - 1
        square = self._factor[:k, :k]
        diagonal = np.abs(np.diag(square))
        if len(square) < k or diagonal.min() <= 1e-13 * diagonal.max():
            return np.full(k, np.nan)
        return np.asarray(np.linalg.solve(square, self._factor[:k, k]))


@jit.kernel
def rank_one_updates(
    y: Container,
    rows: Container,
    scale: Container,
    theta: Container,
    p: Container,
    u: Container,
    out: Container,
) -> None:
    """2005, eqs. 6-8 and 12 for k parameters, row by row; what is held is P as discounted after the last row.

    u = P phi, d = 1 / (1 + phi^T u):  theta += u d e,  P_ij = (P_ij - u_i u_j d) scale_ij. Matrices are
    stored row after row; P stays symmetric because its upper half is written to both.
    """
    size = len(theta)
    parameters = range(size)
    base = 0
    for n in range(len(y)):
        d = 1.0
        e = y[n]
        for i in parameters:
            a = 0.0
            for j in parameters:
                a += p[i * size + j] * rows[base + j]
            u[i] = a
            d += rows[base + i] * a
            e -= rows[base + i] * theta[i]
        d = 1.0 / d
        for i in parameters:
            theta[i] += u[i] * e * d
            out[base + i] = theta[i]
            for j in range(i, size):
                value = (p[i * size + j] - u[i] * u[j] * d) * scale[i * size + j]
                p[i * size + j] = value
                p[j * size + i] = value
        base += size
