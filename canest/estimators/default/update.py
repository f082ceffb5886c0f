"""Update: condition a normal density on one scalar measurement z = h x + noise of variance r.

    e = z - h x,  s = h P h' + r,  K = P h' / s,  x <- x + K e,  P <- P - K s K'

Heavy tails: where e^2 > outlier s, s is raised to e^2 / outlier. The states then move by P h' outlier / e:
the larger such an innovation is, the less it moves them.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.estimators.default.model import U
from canest.estimators.default.predict import Matrix, Vector


@jit.kernel
def condition_on(
    x: Vector, P: Matrix, states: Any, h: Vector, z: float, r: float, outlier: float, K: Vector
) -> tuple[float, float]:
    """Condition on z; h holds the entries of the row at `states`, K is scratch. Returns e and s."""
    n = len(x)
    e = z
    for i in range(n):
        K[i] = 0.0
    for j in range(len(states)):
        lever, other = h[j], P[states[j]]
        e -= lever * x[states[j]]
        for i in range(n):
            K[i] += lever * other[i]
    s = r
    for j in range(len(states)):
        s += h[j] * K[states[j]]
    s = max(s, r)
    root = 1.0 / math.sqrt(max(s, e * e / outlier))
    gain = e * root
    for i in range(n):
        K[i] *= root
    for i in range(n):
        lever, own = K[i], P[i]
        x[i] += gain * lever
        for j in range(n):
            own[j] -= lever * K[j]
    return e, s


@jit.kernel
def condition_all_but_mass(
    x: Vector, P: Matrix, states: Any, h: Vector, lever_u: float, z: float, r: float, outlier: float,
    K: Vector, a: Vector,
) -> None:  # fmt: skip
    """Condition the density of the other states given u on z, and leave that of u as it is.

    x = x' + a u with a = P_xu / P_uu: x' and a are updated, P = P' + a P_uu a'. lever_u: entry of h at u.
    """
    n = len(x)
    variance = P[U][U]
    for i in range(n):
        a[i] = P[i][U] / variance
    for i in range(n):
        own, slope = P[i], a[i] * variance
        for j in range(n):
            own[j] -= slope * a[j]
    e, lever = z - lever_u * x[U], lever_u
    for i in range(n):
        K[i] = 0.0
    for j in range(len(states)):
        e -= h[j] * x[states[j]]
        lever += h[j] * a[states[j]]
        other = P[states[j]]
        for i in range(n):
            K[i] += h[j] * other[i]
    K[U] = 0.0
    s = r
    for j in range(len(states)):
        s += h[j] * K[states[j]]
    root = 1.0 / math.sqrt(max(s, r, e * e / outlier))
    gain = e * root
    lever *= root
    for i in range(n):
        K[i] *= root
    for i in range(n):
        x[i] += gain * K[i]
        a[i] -= K[i] * lever
    a[U] = 1.0
    for i in range(n):
        own, slope, taken = P[i], a[i] * variance, K[i]
        for j in range(n):
            own[j] += slope * a[j] - taken * K[j]


@jit.kernel
def log_likelihood(e: float, s: float, outlier: float) -> float:
    """Return ln N(e; 0, s) but for a constant, tails cut as in `condition_on`."""
    return -0.5 * (min(e * e / s, outlier) + math.log(s))
