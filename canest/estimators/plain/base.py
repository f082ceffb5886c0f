"""What the plain estimators share: the shape of rows, the size of theta, the start."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from canest.core.errors import UsageError
from canest.core.frames import FloatColumn

#: diagonal of the initial covariance where none is given
P0 = 1e4


class PlainEstimator(ABC):
    """An estimator of theta in y = phi^T theta + noise.

    The number k of parameters is that of the first ``phi``. Before it, `theta` and `P` are empty.
    """

    def __init__(self) -> None:
        self._k = 0

    @property
    @abstractmethod
    def theta(self) -> FloatColumn:
        """Return the estimate after the last row, shape (k,), in units of y over those of phi."""

    @property
    @abstractmethod
    def P(self) -> FloatColumn:
        """Return the covariance after the last row, shape (k, k); the class defines its scale."""

    def update(self, y: ArrayLike, phi: ArrayLike) -> FloatColumn:
        """Learn from one row or from a block of rows, in order.

        y: a number, or shape (n,). phi: shape (k,) for one row, (n, k) for a block; with k = 1 a number, or
        (n,) beside a y of (n,). Returns theta after each row: (k,) for one row, (n, k) for a block.
        Errors: UsageError for other shapes, another k than before, or a number that is not finite; nothing
        is learned then.
        """
        output, rows, single = self._rows(y, phi)
        if not self._k:
            self._begin(rows.shape[1])
            self._k = rows.shape[1]
        found = self._learn(output, rows)
        return found[-1] if single else found

    @abstractmethod
    def _begin(self, k: int) -> None:
        """Set the start for k parameters. Errors: UsageError where what was given has another size."""

    @abstractmethod
    def _learn(self, y: FloatColumn, rows: FloatColumn) -> FloatColumn:
        """Learn from y (n,) and rows (n, k); return theta after each row, (n, k)."""

    def _rows(self, y: ArrayLike, phi: ArrayLike) -> tuple[FloatColumn, FloatColumn, bool]:
        output, rows = np.asarray(y, np.float64), np.asarray(phi, np.float64)
        single = output.ndim == 0
        if single:
            output, rows = output[None], np.atleast_1d(rows)[None]
        elif rows.ndim == 1 and output.ndim == 1 and len(rows) == len(output):
            rows = rows[:, None]
        if output.ndim != 1 or rows.ndim != 2 or len(rows) != len(output) or not rows.shape[1]:
            self._refuse(
                "shapes do not fit",
                f"y {np.shape(y)}, phi {np.shape(phi)}",
                "y a number and phi (k,), or y (n,) and phi (n, k)",
            )
        if self._k and rows.shape[1] != self._k:
            self._refuse("another number of parameters", rows.shape[1], f"{self._k}, as in the first row")
        if not (np.isfinite(output).all() and np.isfinite(rows).all()):
            self._refuse("a number is not finite", "NaN or infinity in y or phi", "finite numbers only")
        return output, rows, single

    def _refuse(self, what: str, found: object, expected: str) -> None:
        raise UsageError(what, where=type(self).__name__, found=found, expected=expected)

    def _factors(self, value: ArrayLike, k: int, name: str = "forgetting") -> FloatColumn:
        """Return k forgetting factors from one or k numbers. Errors: UsageError."""
        factors = np.asarray(value, np.float64)
        if factors.ndim > 1 or factors.size not in (1, k):
            self._refuse(f"wrong size of {name}", factors.shape, f"a number, or {k} of them")
        if not ((factors > 0.0) & (factors <= 1.0)).all():
            self._refuse(f"wrong {name}", factors.tolist(), "above 0, at most 1")
        return np.broadcast_to(factors.ravel(), (k,)).copy()

    def _start(self, theta0: ArrayLike | None, p0: ArrayLike, k: int) -> tuple[FloatColumn, FloatColumn]:
        """Return theta (k,) and P (k, k) to begin with. Errors: UsageError."""
        theta = np.zeros(k) if theta0 is None else np.asarray(theta0, np.float64).ravel()
        if len(theta) != k or not np.isfinite(theta).all():
            self._refuse("wrong theta0", theta.tolist(), f"{k} finite numbers")
        p = np.asarray(p0, np.float64)
        if p.ndim < 2 and p.size in (1, k):
            p = np.diag(np.broadcast_to(p.ravel(), (k,)))
        symmetric = p.shape == (k, k) and bool(np.isfinite(p).all()) and np.allclose(p, p.T)
        if not symmetric or np.linalg.eigvalsh(p)[0] <= 0.0:
            self._refuse(
                "wrong P0",
                np.asarray(p0).tolist(),
                f"a number, {k} of them, or a ({k}, {k}) matrix, positive definite",
            )
        return theta.copy(), p.copy()
