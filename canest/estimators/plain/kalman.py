"""An extended Kalman filter for a model of your own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from canest.core.errors import UsageError
from canest.core.frames import FloatColumn
from canest.estimators.plain.base import P0

#: f(x, u), h(x, u) or a Jacobian of them: state (k,), input as given -> array
Function: TypeAlias = Callable[[FloatColumn, FloatColumn], ArrayLike]


class EKF:
    """Extended Kalman filter of x_n = f(x_{n-1}, u_n) + w, y_n = h(x_n, u_n) + v, w ~ (0, Q), v ~ (0, R).

        predict:  x <- f(x, u),  P <- F P F^T + Q
        correct:  S = H P H^T + R,  K = P H^T S^-1,  x <- x + K (y - h(x, u)),
                  P <- (I - K H) P (I - K H)^T + K R K^T   (Joseph form)

    Source: Kidambi et al. 2014, eqs. 6-10; `canest`'s estimator `ekf` is this filter for their vehicle model.
    f, h: functions of (x, u), x of shape (k,), u what `update` was given as ``phi``; f returns (k,), h a
    number or (m,). F, H: their Jacobians as functions of (x, u), (k, k) and (m, k), or constant matrices.
    Without f, x <- F x (F: the identity without it). Without h, y = H x; without H, y = u^T x, so that
    ``EKF(x0=..., Q=..., R=...)`` estimates the parameters of a regression as a random walk.
    Q: (k, k), k numbers of its diagonal, or one; R the same with m. x0: (k,), zeros without it: then its size
    is that of the first ``phi``. P0: as Q, 1e4 times the identity without it.
    Errors: UsageError for sizes that do not fit, f without F, h without H.

    >>> ekf = EKF(f=lambda x, u: [x[0] + 0.1 * x[1], x[1]], F=[[1, 0.1], [0, 1]], H=[[1, 0]],
    ...           Q=[0, 1e-3], R=0.01, x0=[0, 0])
    >>> ekf.update(1.0).shape
    (2,)
    """

    def __init__(
        self,
        f: Function | None = None,
        h: Function | None = None,
        *,
        F: Function | ArrayLike | None = None,
        H: Function | ArrayLike | None = None,
        Q: ArrayLike = 0.0,
        R: ArrayLike = 1.0,
        x0: ArrayLike | None = None,
        P0: ArrayLike = P0,
    ) -> None:
        if f is not None and F is None:
            _refuse("no Jacobian of f", "f without F", "F, a matrix or a function of (x, u)")
        if h is not None and H is None:
            _refuse("no Jacobian of h", "h without H", "H, a matrix or a function of (x, u)")
        self._f, self._h, self._F, self._H = f, h, F, H
        self._Q, self._R, self._P0 = Q, R, P0
        self._x, self._p = np.empty(0), np.empty((0, 0))
        self._innovation, self._S = np.empty(0), np.empty((0, 0))
        if x0 is not None:
            self._begin(np.asarray(x0, np.float64).ravel())

    @property
    def theta(self) -> FloatColumn:
        """Return the state after the last row, shape (k,); empty before the size is known."""
        return self._x.copy()

    x = theta  #: the same, under the name that filters give it

    @property
    def P(self) -> FloatColumn:
        """Return the covariance of the state, shape (k, k)."""
        return self._p.copy()

    @property
    def innovation(self) -> FloatColumn:
        """Return y - h(x, u) of the last row, before its correction, shape (m,)."""
        return self._innovation.copy()

    @property
    def S(self) -> FloatColumn:
        """Return the innovation's covariance H P H^T + R, shape (m, m)."""
        return self._S.copy()

    def update(self, y: ArrayLike, phi: ArrayLike | None = None) -> FloatColumn:
        """Predict and correct, once or for each row of a block; return the state after each row.

        One row: y a number, ``phi`` the input u of f and h (nothing, a number or (j,)); returns (k,).
        A block: y (n,), or (n, m) where m values are measured at once, ``phi`` (n, j), (n,) or nothing;
        returns (n, k). One row of m values is a block of shape (1, m). NaN in all of a row's y: not measured.
        """
        outputs = np.asarray(y, np.float64)
        if outputs.ndim == 0:
            self.predict(phi)
            if not np.isnan(outputs).all():
                self.correct(outputs, phi)
            return self.theta
        inputs = None if phi is None else np.atleast_1d(np.asarray(phi, np.float64))
        if outputs.ndim > 2 or (inputs is not None and len(inputs) != len(outputs)):
            shapes = f"y {outputs.shape}, phi {None if inputs is None else inputs.shape}"
            _refuse("shapes do not fit", shapes, "as many rows of both")
        found = []
        for n, row in enumerate(outputs):
            u = None if inputs is None else inputs[n]
            self.predict(u)
            if not np.isnan(row).all():
                self.correct(row, u)
            found.append(self.theta)
        return np.array(found).reshape(len(outputs), len(self._x))

    def predict(self, u: ArrayLike | None = None) -> None:
        """Move the state on by one step with the input u."""
        given = self._input(u)
        self._ensure_state(given)
        F = self._matrix(self._F, given, "F", len(self._x)) if self._F is not None else np.eye(len(self._x))
        x = F @ self._x if self._f is None else np.asarray(self._f(self._x, given), np.float64).ravel()
        if len(x) != len(self._x):
            _refuse("wrong size of f(x, u)", len(x), f"{len(self._x)} numbers")
        self._x = x
        self._p = F @ self._p @ F.T + self._Q_matrix

    def correct(self, y: ArrayLike, u: ArrayLike | None = None) -> None:
        """Correct the state by the measurement y, a number or (m,). Errors: UsageError for a NaN in it."""
        measured, given = np.atleast_1d(np.asarray(y, np.float64)), self._input(u)
        self._ensure_state(given)
        m, k = len(measured), len(self._x)
        if not np.isfinite(measured).all():
            _refuse("a number is not finite", measured.tolist(), "finite measurements")
        H = given[None, :] if self._H is None else self._matrix(self._H, given, "H", m)
        if H.shape[1] != k:
            _refuse("wrong size of H (phi without it)", H.shape, f"({m}, {k})")
        expected = H @ self._x if self._h is None else np.atleast_1d(self._h(self._x, given))
        R = _covariance(self._R, m, "R")
        self._innovation = measured - np.asarray(expected, np.float64)
        self._S = H @ self._p @ H.T + R  # S = H P H^T + R
        gain = np.linalg.solve(self._S, H @ self._p).T  # K = P H^T S^-1
        self._x = self._x + gain @ self._innovation
        left = np.eye(k) - gain @ H
        p = left @ self._p @ left.T + gain @ R @ gain.T
        self._p = 0.5 * (p + p.T)  # rounding would let the halves part

    def _input(self, u: ArrayLike | None) -> FloatColumn:
        return np.empty(0) if u is None else np.atleast_1d(np.asarray(u, np.float64))

    def _ensure_state(self, u: FloatColumn) -> None:
        if len(self._x):
            return
        if not len(u) or self._f is not None or self._F is not None or self._H is not None:
            _refuse("no start", "x0 left out", "x0, or a regression with phi in every row")
        self._begin(np.zeros(len(u)))

    def _begin(self, x: FloatColumn) -> None:
        p = _covariance(self._P0, len(x), "P0")
        self._x, self._p, self._Q_matrix = x.copy(), p, _covariance(self._Q, len(x), "Q")

    def _matrix(
        self, given: Function | ArrayLike | None, u: FloatColumn, name: str, rows: int
    ) -> FloatColumn:
        value = given(self._x, u) if callable(given) else given
        matrix = np.atleast_2d(np.asarray(value, np.float64))
        if matrix.shape != (rows, len(self._x)):
            _refuse(f"wrong size of {name}", matrix.shape, f"({rows}, {len(self._x)})")
        return matrix


def _covariance(value: ArrayLike, size: int, name: str) -> FloatColumn:
    """Return a covariance (size, size) from itself, its diagonal or one number. Errors: UsageError."""
    matrix = np.asarray(value, np.float64)
    if matrix.ndim < 2 and matrix.size in (1, size):
        matrix = np.diag(np.broadcast_to(matrix.ravel(), (size,)))
    if matrix.shape != (size, size) or not np.isfinite(matrix).all() or (np.diag(matrix) < 0.0).any():
        _refuse(
            f"wrong {name}", matrix.tolist(), f"a number, {size} of them or a ({size}, {size}) covariance"
        )
    return matrix.copy()


def _refuse(what: str, found: object, expected: str) -> None:
    raise UsageError(what, where="EKF", found=found, expected=expected)
