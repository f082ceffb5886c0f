"""RLSMF for any number of parameters, with projection: 2005 paper, eqs. 17-23; 2013 paper, Alg. 7 and 8."""

from __future__ import annotations

from typing import NamedTuple

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack
from canest.estimators.papers.prior import VARIANCE_ALPHA


class Constants(NamedTuple):
    """1 / lambda_i, bounds of each parameter, ceilings of q_i, (n,) each."""

    inverse: Container
    low: Container
    high: Container
    top: Container


class MultipleForgetting:
    """n parameters X of B = A X, each with its forgetting factor and bounds; the covariance is diagonal.

    x, p, forgetting: (n,) start, diagonal of P, lambdas. low, high: bounds (Alg. 8). top: ceiling of P.
    variance: of B's noise, to begin with. joint: covariances shrink by the joint gain (2013, Alg. 7), else
    each by its own (2005, eqs. 17-18).
    """

    def __init__(
        self,
        x: FloatColumn,
        p: FloatColumn,
        forgetting: FloatColumn,
        low: FloatColumn,
        high: FloatColumn,
        top: FloatColumn,
        variance: float,
        *,
        joint: bool = True,
    ) -> None:
        self._forgetting, inverse = forgetting, 1.0 / forgetting
        self._constants, self._joint = (inverse, low, high, top * inverse), joint
        self._x, self._q, self._noise = x.tolist(), (p * inverse).tolist(), [variance]

    @property
    def p(self) -> FloatColumn:
        """Return the diagonal of P after the last row, (n,)."""
        return unpack(self._q) * self._forgetting

    def add(self, a: FloatColumn, b: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
        """Take rows A (k, n), B (k,); return X and the variance of each parameter after each row, (k, n)."""
        k, n = a.shape
        x, variance = outputs(k * n, 2)
        now, q, noise = state_in(self._x), state_in(self._q), state_in(self._noise)
        work = state_in([0.0] * n)
        state = State(now, q, noise, work)
        forget_each_of_n(*pack(a, b), Constants(*pack(*self._constants)), self._joint, state, x, variance)
        self._x, self._q, self._noise = state_out(now), state_out(q), state_out(noise)
        return unpack(x).reshape(k, n), unpack(variance).reshape(k, n) * self._forgetting


class State(NamedTuple):
    """What the kernel carries on: X (n,), q (n,), the noise variance (1,); and room to work in, (n,)."""

    x: Container
    q: Container
    noise: Container
    work: Container


@jit.kernel
def forget_each_of_n(
    rows: Container,
    output: Container,
    constants: Constants,
    joint: bool,
    state: State,
    x: Container,
    variance: Container,
) -> None:
    """2013, Alg. 7 with q_i = P_i / lambda_i: L_i = w_i / (1 + sum w_j a_j), w_i = q_i a_i; then Alg. 8.

    Line 4: P_i becomes (1 - L_i a_i) P_i / lambda_i, with the *joint* gain L_i; in the 2005 paper (eqs.
    17-18) with each one's own, which makes it q_i / (1 + w_i a_i). rows, x, variance: row after row,
    n numbers each.
    """
    inverse, low, high, top = constants
    now, q, noise, work = state
    n = len(now)
    s = noise[0]
    parameters = range(n)
    base = 0
    for k in range(len(output)):
        total = 1.0
        e = output[k]
        j = base
        for i in parameters:
            a = rows[j]
            e -= a * now[i]
            w = q[i] * a
            work[i] = w
            total += w * a
            j += 1
        d = 1.0 / total
        f = e * d
        s += VARIANCE_ALPHA * (e * f - s)
        j = base
        for i in parameters:
            w = work[i]
            z = now[i] + w * f
            if z < low[i]:
                z = low[i]
            elif z > high[i]:
                z = high[i]
            if joint:
                p = q[i] * inverse[i] * (1.0 - w * rows[j] * d)
            else:
                p = q[i] * inverse[i] / (1.0 + w * rows[j])
            if p > top[i]:  # noqa: PLR1730 - min() costs a call
                p = top[i]
            now[i] = z
            q[i] = p
            x[j] = z
            variance[j] = p * s
            j += 1
        base = j
    noise[0] = s
