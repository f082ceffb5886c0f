"""Update: condition every density on one scalar measurement z = h x + noise of variance r.

    e = z - h x,  s = h P h' + r,  K = P h' / s,  x <- x + K e,  P <- P - K s K'

Heavy tails: where e^2 > outlier s, s is raised to e^2 / outlier. The states then move by P h' outlier / e:
the larger such an innovation is, the less it moves them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from canest.core import jit
from canest.estimators.default.model import Mixture, U


class Innovation(NamedTuple):
    """What a measurement left, one number per density, and room to work in."""

    e: Any  #: innovations
    s: Any  #: their variances
    K: Any  #: (n,) scratch
    a: Any  #: (n,) scratch


def _condition_on(
    mix: Mixture, count: int, states: Any, h: Any, z: float, r: float, outlier: float, out: Innovation
) -> None:
    x, P = mix.x[:count], mix.P[:count]
    e = np.full(count, z)
    K = np.zeros(x.shape)
    for lever, state in zip(h, states, strict=False):
        e -= lever * x[:, state]
        K += lever * P[:, state]
    s = np.full(count, r)
    for lever, state in zip(h, states, strict=False):
        s += lever * K[:, state]
    np.maximum(s, r, out=s)
    out.e[:count], out.s[:count] = e.tolist(), s.tolist()
    root = 1.0 / np.sqrt(np.maximum(s, e * e / outlier))
    gain = e * root
    K *= root[:, None]
    x += gain[:, None] * K
    P -= K[:, :, None] * K[:, None, :]


@jit.kernel_beside(_condition_on)
def condition_on(
    mix: Mixture, count: int, states: Any, h: Any, z: float, r: float, outlier: float, out: Innovation
) -> None:
    """Condition on z. h: the entries of the row at `states`; all others are zero."""
    x, P, K = mix.x, mix.P, out.K
    n = x.shape[1]
    for d in range(count):
        e = z
        for i in range(n):
            K[i] = 0.0
        for j in range(len(states)):
            lever, state = h[j], states[j]
            e -= lever * x[d, state]
            for i in range(n):
                K[i] += lever * P[d, state, i]
        s = r
        for j in range(len(states)):
            s += h[j] * K[states[j]]
        s = max(s, r)
        out.e[d], out.s[d] = e, s
        root = 1.0 / math.sqrt(max(s, e * e / outlier))
        gain = e * root
        for i in range(n):
            K[i] *= root
        for i in range(n):
            x[d, i] += gain * K[i]
            for j in range(n):
                P[d, i, j] -= K[i] * K[j]


def _condition_all_but_mass(
    mix: Mixture, count: int, states: Any, h: Any, lever_u: float, z: float, r: float, outlier: float,
    out: Innovation,
) -> None:  # fmt: skip
    x, P = mix.x[:count], mix.P[:count]
    variance = P[:, U, U].copy()
    a = P[:, :, U] / variance[:, None]
    P -= (a * variance[:, None])[:, :, None] * a[:, None, :]
    e = z - lever_u * x[:, U]
    lever = np.full(count, lever_u)
    K = np.zeros(x.shape)
    for own, state in zip(h, states, strict=False):
        e -= own * x[:, state]
        lever += own * a[:, state]
        K += own * P[:, state]
    K[:, U] = 0.0
    s = np.full(count, r)
    for own, state in zip(h, states, strict=False):
        s += own * K[:, state]
    root = 1.0 / np.sqrt(np.maximum(np.maximum(s, r), e * e / outlier))
    gain = e * root
    K *= root[:, None]
    x += gain[:, None] * K
    a -= K * (lever * root)[:, None]
    a[:, U] = 1.0
    P += (a * variance[:, None])[:, :, None] * a[:, None, :] - K[:, :, None] * K[:, None, :]


@jit.kernel_beside(_condition_all_but_mass)
def condition_all_but_mass(
    mix: Mixture, count: int, states: Any, h: Any, lever_u: float, z: float, r: float, outlier: float,
    out: Innovation,
) -> None:  # fmt: skip
    """Condition the density of the other states given u on z, and leave that of u as it is.

    x = x' + a u with a = P_xu / P_uu: x' and a are updated, P = P' + a P_uu a'. lever_u: entry of h at u.
    """
    x, P, K, a = mix.x, mix.P, out.K, out.a
    n = x.shape[1]
    for d in range(count):
        variance = P[d, U, U]
        for i in range(n):
            a[i] = P[d, i, U] / variance
        for i in range(n):
            for j in range(n):
                P[d, i, j] -= a[i] * variance * a[j]
        e, lever = z - lever_u * x[d, U], lever_u
        for i in range(n):
            K[i] = 0.0
        for j in range(len(states)):
            own, state = h[j], states[j]
            e -= own * x[d, state]
            lever += own * a[state]
            for i in range(n):
                K[i] += own * P[d, state, i]
        K[U] = 0.0
        s = r
        for j in range(len(states)):
            s += h[j] * K[states[j]]
        root = 1.0 / math.sqrt(max(max(s, r), e * e / outlier))
        gain = e * root
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
def add_log_likelihood(found: Any, count: int, innovation: Innovation, r: float, floor: float) -> None:
    """Add ln (N(e; 0, s) + floor / sqrt(r)) but for a constant: a gross error says nothing of a hypothesis."""
    e, s = innovation.e, innovation.s
    least = floor / math.sqrt(r)
    for d in range(count):
        found[d] += math.log(math.exp(-0.5 * e[d] * e[d] / s[d]) / math.sqrt(s[d]) + least)
