"""Update: condition every density on one scalar measurement z = h x + noise of variance r."""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.estimators.next.model import U, Bank


@jit.kernel
def condition_on(
    bank: Bank, count: int, states: Any, h: Any, z: float, r: float, outlier: float, e: Any, s: Any, K: Any
) -> None:
    """Condition on z; h holds the entries of the row at `states`. e, s: innovations and their variances."""
    x, P = bank.x, bank.P
    n = x.shape[1]
    for d in range(count):
        off = z
        for i in range(n):
            K[i] = 0.0
        for j in range(len(states)):
            lever, other = h[j], states[j]
            off -= lever * x[d, other]
            for i in range(n):
                K[i] += lever * P[d, other, i]
        var = r
        for j in range(len(states)):
            var += h[j] * K[states[j]]
        var = max(var, r)
        e[d], s[d] = off, var
        root = 1.0 / math.sqrt(max(var, off * off / outlier))
        gain = off * root
        for i in range(n):
            K[i] *= root
        for i in range(n):
            x[d, i] += gain * K[i]
            for j in range(n):
                P[d, i, j] -= K[i] * K[j]


@jit.kernel
def condition_all_but_mass(
    bank: Bank, count: int, states: Any, h: Any, lever_u: float, z: float, r: float, outlier: float, K: Any, a: Any
) -> None:
    """Condition the density of the other states given u on z, and leave that of u as it is."""
    x, P = bank.x, bank.P
    n = x.shape[1]
    for d in range(count):
        variance = P[d, U, U]
        for i in range(n):
            a[i] = P[d, i, U] / variance
        for i in range(n):
            for j in range(n):
                P[d, i, j] -= a[i] * variance * a[j]
        off, lever = z - lever_u * x[d, U], lever_u
        for i in range(n):
            K[i] = 0.0
        for j in range(len(states)):
            off -= h[j] * x[d, states[j]]
            lever += h[j] * a[states[j]]
            for i in range(n):
                K[i] += h[j] * P[d, states[j], i]
        K[U] = 0.0
        s = r
        for j in range(len(states)):
            s += h[j] * K[states[j]]
        root = 1.0 / math.sqrt(max(s, r, off * off / outlier))
        gain = off * root
        lever *= root
        for i in range(n):
            K[i] *= root
        for i in range(n):
            x[d, i] += gain * K[i]
            a[i] -= K[i] * lever
        a[U] = 1.0
        for i in range(n):
            for j in range(n):
                P[d, i, j] += a[i] * variance * a[j] - K[i] * K[j]


@jit.kernel
def add_log_likelihood(found: Any, count: int, e: Any, s: Any, r: float, outliers: float) -> None:
    """found += ln (N(e; 0, s) + outliers / sqrt(r)) but for a constant: an outlier may be anything."""
    floor = outliers / math.sqrt(r)
    for d in range(count):
        found[d] += math.log(math.exp(-0.5 * e[d] * e[d] / s[d]) / math.sqrt(s[d]) + floor)
