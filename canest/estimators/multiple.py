"""RLSMF for any number of parameters, with projection: 2013 paper, Alg. 7 and 8."""

from __future__ import annotations

from canest import fast
from canest.estimators.columns import Container, give, room, state_in, state_out, take
from canest.estimators.two_parameter import VARIANCE_ALPHA
from canest.frames import FloatColumn


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
        # x, then P / lambda, then the noise variance
        self._state = [*x.tolist(), *(p * inverse).tolist(), variance]

    def add(self, a: FloatColumn, b: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
        """Take rows A (k, n), B (k,); return X and the variance of each parameter after each row, (k, n)."""
        k, n = a.shape
        out, state = room(k * n, 2), state_in(self._state)
        work = state_in([0.0] * n)
        joint_gain_n(*give(a, b, *self._constants), k, n, VARIANCE_ALPHA, state, work, *out)
        self._state = state_out(state)
        return take(out[0]).reshape(k, n), take(out[1]).reshape(k, n) * self._forgetting


@fast.kernel
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
    state: Container,
    work: Container,
    x: Container,
    variance: Container,
) -> None:
    """2013, Alg. 7 with q_i = P_i / lambda_i: L_i = q_i a_i / (1 + sum w), w_j = q_j a_j^2; then Alg. 8.

    Line 4: P_i becomes (1 - L_i a_i) P_i / lambda_i, with the *joint* gain L_i.
    """
    s = state[2 * n]
    base = 0
    for k in range(count):
        total = 1.0
        e = output[k]
        for i in range(n):
            a = rows[base + i]
            e -= a * state[i]
            u = state[n + i] * a
            work[i] = u
            total += u * a
        d = 1.0 / total
        f = e * d
        s += alpha * (e * f - s)
        for i in range(n):
            u = work[i]
            z = state[i] + u * f
            if z < low[i]:
                z = low[i]
            elif z > high[i]:
                z = high[i]
            state[i] = z
            q = state[n + i] * inverse[i] * (1.0 - u * rows[base + i] * d)
            q = min(q, top[i])
            state[n + i] = q
            x[base + i] = z
            variance[base + i] = q * s
        base += n
    state[2 * n] = s
