"""Batch total least squares (`tls`) and generalized total least squares (`gtls`) of mass and grade."""

from __future__ import annotations

from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import RATE_HZ
from canest.estimators.description import Description, option
from canest.estimators.papers.rhode2013.tls_math import NoiseScale, spread
from canest.estimators.papers.two_parameter import TwoParameter, TwoParameterOptions

#: phi2 is a known constant; W must still be positive definite, so it gets this standard deviation, m/s2
EXACT_MPS2 = 1e-4
#: rows between two solutions of the batch methods: one second
SOLVE_EVERY = round(RATE_HZ)


class GeneralizedOptions(TwoParameterOptions):
    """Noise of the two measured columns, from which W is made."""

    noise_force_N: float = option(300.0, "standard deviation of the known force", unit="N", gt=0.0)
    noise_accel_mps2: float = option(0.05, "standard deviation of the acceleration", unit="m/s²", gt=0.0)
    noise_correlation: float = option(0.0, "correlation of the two", gt=-1.0, lt=1.0)


def noise_covariance(name: str, options: Any) -> FloatColumn:
    """Return W of [phi1, phi2, y]: the identity for tls and rtls, from the options for gtls and rgtls.

    With W = I in SI units a force error of 1 N is as likely as an acceleration error of 1 m/s2, which for
    a truck comes close to plain least squares; the generalized forms state what the errors are.
    """
    if name in ("tls", "rtls"):
        return np.eye(3)
    force, accel = options.noise_force_N, options.noise_accel_mps2
    cross = options.noise_correlation * force * accel
    return np.array([[force**2, 0.0, cross], [0.0, EXACT_MPS2**2, 0.0], [cross, 0.0, accel**2]])


def prior_rows(theta: tuple[float, float], p: tuple[float, float, float]) -> FloatColumn:
    """Return two rows [U, U theta] with U^T U = P^-1: what the start knows, as data, shape (2, 3)."""
    u = np.linalg.cholesky(np.linalg.inv(np.array([[p[0], p[1]], [p[1], p[2]]]))).T
    return np.column_stack((u, u @ np.array(theta)))


class Tls(TwoParameter):
    """TLS (2013, Alg. 1) and GTLS (Alg. 2) of all rows so far, causal: solved anew every second.

    The rows are kept as their triangular factor R (orthogonal transformations from the left change neither
    singular values nor V), so a solution costs a 3 x 3 SVD whatever the length of the drive.
    """

    descriptions = (
        Description(
            "tls", "total least squares of all rows so far", "2013, Alg. 1", options=GeneralizedOptions
        ),
        Description(
            "gtls", "total least squares with a noise covariance", "2013, Alg. 2", options=GeneralizedOptions
        ),
    )

    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        self._scale = NoiseScale.of(noise_covariance(self.name, self.options))
        self._factor = self._scale.rows(prior_rows(theta, p))
        self._pending = np.empty((0, 3))
        self._count = 0
        self._now = np.array([*theta, *self._variances(*p, variance)])[:, None]

    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        rows = np.concatenate((self._pending, self._scale.rows(np.stack((phi1, phi2, y), axis=1))))
        known = np.empty((4, len(rows)))
        full = len(rows) - len(rows) % SOLVE_EVERY
        for begin in range(0, full, SOLVE_EVERY):
            known[:, begin : begin + SOLVE_EVERY] = self._now
            self._solve(rows[begin : begin + SOLVE_EVERY])
            known[:, begin + SOLVE_EVERY - 1] = self._now[:, 0]
        known[:, full:] = self._now
        skip = len(self._pending)
        self._pending = rows[full:]
        return known[:, skip:]

    def _solve(self, rows: FloatColumn) -> None:
        """Take the next rows (transformed), solve."""
        self._factor = np.asarray(np.linalg.qr(np.concatenate((self._factor, rows)), mode="r"))
        self._count += len(rows)
        _, s, vt = np.linalg.svd(self._factor)
        if vt[2, 2] == 0.0:
            return
        gram = self._factor[:, :2].T @ self._factor[:, :2]
        x = -vt[2, :2] / vt[2, 2]
        variance, inverse = spread(x, gram, s[2], np.array(float(self._count)))
        p = self._scale.covariance_back(inverse) * self._scale.c22**2
        variances = np.full(2, np.inf)
        if np.isfinite(p).all():
            variances[:] = self._variances(p[0, 0], p[0, 1], p[1, 1], variance / self._scale.c22**2)
        self._now = bounded(self, self._scale.back(x)[:, None], variances[:, None])


def bounded(method: TwoParameter, theta: FloatColumn, variances: FloatColumn) -> FloatColumn:
    """Return theta1, theta2 inside the bounds and their variances, shape (4, k), from (2, k) of each.

    The paper knows no parameter projection for its SVD-based methods; this one acts on what comes out, not on
    the state. Where there is no definite covariance, the spread of the bounds stands in.
    """
    box = method.box
    low, high, prior = (np.array(pair)[:, None] for pair in (box.low, box.high, box.variance))
    known = np.isfinite(variances)
    return np.concatenate(
        (np.clip(theta, low, high), np.where(known, np.maximum(variances, 0.0), prior)), axis=0
    )
