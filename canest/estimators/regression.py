"""The two-parameter regression of the 2005 paper, differentiated (eq. 2) or integrated (eq. 24).

theta = [1/M, sin(beta + beta_mu)] with tan(beta_mu) = mu. Only additions, multiplications, divisions
and square roots, so that a column gives the same bits however it is cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ, STEP_S, ModelBlock

#: samples beyond these are no vehicle's and are never learned from (they also keep products finite)
ACCEL_LIMIT_MPS2 = 50.0
FORCE_LIMIT_N = 1e6
SPEED_LIMIT_MPS = 150.0
MU_LIMIT = 0.5


@dataclass(frozen=True, slots=True)
class Regression:
    """Rows the estimator may learn from: y = phi1 theta1 + phi2 theta2, all shape (k,).

    at: positions of these rows in the block, shape (k,). mu: rolling resistance, to get the grade back.
    """

    at: IntColumn
    y: FloatColumn
    phi1: FloatColumn
    phi2: FloatColumn
    mu: FloatColumn


def usable(block: ModelBlock) -> BoolColumn:
    """Return True where the gates are open and the sample is finite and physically possible."""
    good: BoolColumn = (
        (block.gate == 0)
        & (np.abs(block.accel_mps2) < ACCEL_LIMIT_MPS2)
        & (np.abs(block.force_N) < FORCE_LIMIT_N)
        & (np.abs(block.speed_mps) < SPEED_LIMIT_MPS)
        & (np.abs(block.mu) < MU_LIMIT)
    )
    return good


def secant(mu: FloatColumn) -> FloatColumn:
    """Return 1 / cos(beta_mu) for tan(beta_mu) = mu."""
    return np.asarray(np.sqrt(1.0 + mu * mu))


def differentiated(block: ModelBlock) -> Regression:
    """Rows of eq. 2: y = dv/dt, phi1 = F, phi2 = -g / cos(beta_mu)."""
    at = np.flatnonzero(usable(block))
    mu = block.mu[at]
    return Regression(at, block.accel_mps2[at], block.force_N[at], -GRAVITY_MPS2 * secant(mu), mu)


class Integrator:
    """Rows of eq. 24 over a sliding window that starts anew after every gate.

    theta2 is the *mean* of sin(beta + beta_mu) since t0 (2005 paper, below eq. 24), so a t0 fixed at the
    start of the drive would give the mean grade of the trip. Here t0 is ``window_s`` ago, or the first
    sample after the last gate where that is later. y and both regressors are divided by the length of a
    full window: a constant scale, which leaves the estimates as they are and gives y the unit m/s2.
    """

    def __init__(self, window_s: float) -> None:
        self._window = max(1, round(window_s * RATE_HZ))
        self._v = np.empty(0)  # speed, integral of F and open flags of the samples a window may reach back to
        self._sum = np.empty(0)
        self._since = np.empty(0, np.int64)  # open samples since t0's restart, 0 at the restart itself

    def __call__(self, block: ModelBlock) -> Regression:
        """Return the rows of this block; a restart sample has none (its window is empty)."""
        n, window = len(block), self._window
        ok = usable(block)
        restart = block.restart.copy()
        restart[1:] |= ~ok[:-1]
        if n and (not len(self._since) or self._since[-1] < 0):
            restart[0] = True
        index = np.arange(n)
        carried = int(self._since[-1]) if len(self._since) else -1
        begin = np.maximum.accumulate(np.where(restart & ok, index, -carried - 1)) if n else index
        since = np.where(ok, index - begin, -1)

        force = np.where(ok & (since > 0), block.force_N, 0.0)
        total = np.cumsum(np.concatenate((self._sum[-1:], force)))[len(self._sum[-1:]) :]
        v_all = np.concatenate((self._v, block.speed_mps))
        sum_all = np.concatenate((self._sum, total))
        at = np.flatnonzero(since > 0)
        length = np.minimum(since[at], window)
        now = at + len(self._v)
        then = now - length

        scale = 1.0 / (window * STEP_S)
        y = (v_all[now] - v_all[then]) * scale
        phi1 = (sum_all[now] - sum_all[then]) * (STEP_S * scale)
        mu = block.mu[at]
        phi2 = -GRAVITY_MPS2 * secant(mu) * (length * (STEP_S * scale))

        self._v, self._sum = v_all[-window:], sum_all[-window:]
        self._since = np.concatenate((self._since, since))[-1:]
        return Regression(at, y, phi1, phi2, mu)


def theta2_range(grade_limit: float) -> tuple[float, float]:
    """Return the bounds of sin(beta + beta_mu) for grades within +-limit (rolling resistance above)."""
    sine = grade_limit / float(np.sqrt(1.0 + grade_limit * grade_limit))
    return -sine, min(0.99, sine + 0.05)


def grade_of(theta2: FloatColumn, mu: FloatColumn, limit: float) -> FloatColumn:
    """Return tan(beta) from sin(beta + beta_mu): tan of a difference, clipped to +-limit."""
    tangent = theta2 / np.sqrt(1.0 - theta2 * theta2)
    return np.asarray(np.clip((tangent - mu) / (1.0 + tangent * mu), -limit, limit))


def theta2_of(grade: float, mu: float) -> float:
    """Return sin(beta + beta_mu) of a grade."""
    tangent = (grade + mu) / (1.0 - grade * mu)
    return tangent / float(np.sqrt(1.0 + tangent * tangent))


def grade_std_of(grade: FloatColumn, theta2: FloatColumn, theta2_std: FloatColumn) -> FloatColumn:
    """Return the grade's standard deviation, first order: d tan(beta) / d sin(beta + beta_mu)."""
    return np.asarray(theta2_std * (1.0 + grade * grade) / np.sqrt(1.0 - theta2 * theta2))
