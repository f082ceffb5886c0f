"""Update: condition every density on one scalar measurement z = h x + noise of variance r.

    e = z - h x,  s = h P h' + r,  K = P h' / s,  x <- x + K e,  P <- P - K s K'

Heavy tails: where e^2 > outlier s, s is raised to e^2 / outlier. The states then move by P h' outlier / e:
the larger such an innovation is, the less it moves them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from canest.core import jit
from canest.estimators.default.model import Mixture, Scratch


def _condition_on(
    mix: Mixture, count: int, states: Any, z: float, r: float, outlier: float, t: Scratch
) -> None:
    x, P, h = mix.x[:count], mix.P[:count], np.array(t.h[: len(states)])[:, None]
    K = np.add.reduce(P.take(states, axis=1) * h, axis=1)  # like all sums here one after the other
    terms = np.empty((len(states) + 1, count))
    terms[0] = z
    np.multiply(x.T.take(states, axis=0), h, out=terms[1:])
    e = np.subtract.reduce(terms)
    terms[0] = r
    np.multiply(K.T.take(states, axis=0), h, out=terms[1:])
    s = np.maximum(np.add.reduce(terms), r)
    t.e[:count], t.s[:count] = e.tolist(), s.tolist()
    root = 1.0 / np.sqrt(np.maximum(s, e * e / outlier))
    gain = e * root
    K *= root[:, None]
    x += gain[:, None] * K
    P -= K[:, :, None] * K[:, None, :]


@jit.kernel_beside(_condition_on)
def condition_on(
    mix: Mixture, count: int, states: Any, z: float, r: float, outlier: float, t: Scratch
) -> None:
    """Condition on z = h x + noise of variance r. t.h: the entries of h at `states`; all others are zero.

    Leaves the innovations in t.e and their variances in t.s.
    """
    x, P, K = mix.x, mix.P, t.K
    n = x.shape[1]
    for d in range(count):
        e = z
        for i in range(n):
            K[i] = 0.0
        for j in range(len(states)):
            lever, state = t.h[j], states[j]
            e -= lever * x[d, state]
            for i in range(n):
                K[i] += lever * P[d, state, i]
        s = r
        for j in range(len(states)):
            s += t.h[j] * K[states[j]]
        s = max(s, r)
        t.e[d], t.s[d] = e, s
        root = 1.0 / math.sqrt(max(s, e * e / outlier))
        gain = e * root
        for i in range(n):
            K[i] *= root
        for i in range(n):
            x[d, i] += gain * K[i]
            for j in range(n):
                P[d, i, j] -= K[i] * K[j]


@jit.kernel
def add_log_likelihood(mix: Mixture, count: int, r: float, floor: float, t: Scratch) -> None:
    """Add ln (N(e; 0, s) + floor / sqrt(r)) but for a constant: a gross error speaks for none."""
    least = floor / math.sqrt(r)
    for d in range(count):
        likelihood = math.exp(-0.5 * t.e[d] * t.e[d] / t.s[d]) / math.sqrt(t.s[d])
        mix.found[d] += math.log(likelihood + least)
