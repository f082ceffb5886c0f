"""RLSMF for any number of parameters, with projection: 2013 paper, Alg. 7 and 8."""

from __future__ import annotations

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.kernel_arrays import Container, give, room, state_in, state_out, take
from canest.estimators.papers.two_parameter import VARIANCE_ALPHA


class MultipleForgetting:
    """n parameters X of B = A X, each with its forgetting factor and bounds; the covariance is diagonal.

    x, p, forgetting: (n,) start, diagonal of P, lambdas. low, high: bounds (Alg. 8). top: ceiling of P.
    variance: of B's noise, to begin with.
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
    ) -> None:
        self._forgetting, inverse = forgetting, 1.0 / forgetting
        self._constants = (inverse, low, high, top * inverse)
        self._x, self._q, self._noise = x.tolist(), (p * inverse).tolist(), [variance]

    def add(self, a: FloatColumn, b: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
        """Take rows A (k, n), B (k,); return X and the variance of each parameter after each row, (k, n)."""
        k, n = a.shape
        out, work = room(k * n, 2), state_in([0.0] * n)
        now, q, noise = state_in(self._x), state_in(self._q), state_in(self._noise)
        joint_gain_n(*give(a, b, *self._constants), k, n, VARIANCE_ALPHA, now, q, noise, work, *out)
        self._x, self._q, self._noise = state_out(now), state_out(q), state_out(noise)
        return take(out[0]).reshape(k, n), take(out[1]).reshape(k, n) * self._forgetting


@jit.kernel
def joint_gain_n(
    rows: Container,
    output: Container,
    inverse: Container,
    low: Container,
    high: Container,
    top: Container,
    count: int,
    n: int,
    alpha: float,
    now: Container,
    q: Container,
    noise: Container,
    work: Container,
    x: Container,
    variance: Container,
) -> None:
    """2013, Alg. 7 with q_i = P_i / lambda_i: L_i = w_i / (1 + sum w_j a_j), w_i = q_i a_i; then Alg. 8.

    Line 4: P_i becomes (1 - L_i a_i) P_i / lambda_i, with the *joint* gain L_i.
    """
    s = noise[0]
    parameters = range(n)
    base = 0
    for k in range(count):
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
        s += alpha * (e * f - s)
        j = base
        for i in parameters:
            w = work[i]
            z = now[i] + w * f
            if z < low[i]:
                z = low[i]
            elif z > high[i]:
                z = high[i]
            p = q[i] * inverse[i] * (1.0 - w * rows[j] * d)
            if p > top[i]:  # noqa: PLR1730 - min() costs a call
                p = top[i]
            now[i] = z
            q[i] = p
            x[j] = z
            variance[j] = p * s
            j += 1
        base = j
    noise[0] = s
