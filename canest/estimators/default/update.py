"""Update: condition every density on one scalar measurement, with heavy tails (docs/theory.md, section 5)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from canest.core import jit
from canest.estimators.default.constants import Constants
from canest.estimators.default.model import Mixture, Scratch


def _condition_on(
    mix: Mixture, count: int, states: Any, h: Any, z: float, r: float, outlier: float, t: Scratch
) -> None:
    A = mix.A[:count]
    n = A.shape[1]
    K = np.add.reduce(A.take(states, 1) * np.array(h)[:, None], 1)  # one after the other, as all sums here
    pairs, roots, gains = tuple(zip(h, states, strict=True)), [], []
    for d, row in enumerate(K.tolist()):
        e, s = z - row[n], r
        for lever, state in pairs:
            s += lever * row[state]
        s = s if s > r else r
        t.e[d], t.s[d] = e, s
        least = e * e / outlier
        root = 1.0 / math.sqrt(s if s > least else least)
        roots.append(root)
        gains.append(-e * root)
    K *= np.array(roots)[:, None]
    K[:, n] = gains
    A -= K[:, :n, None] * K[:, None]


@jit.kernel_beside(_condition_on)
def condition_on(
    mix: Mixture, count: int, states: Any, h: Any, z: float, r: float, outlier: float, t: Scratch
) -> None:
    """Condition on z = h x + noise of variance r. h: its entries at `states`; all others are zero.

    Leaves the innovations in t.e and their variances in t.s.
    """
    A, K = mix.A, t.K
    n = A.shape[1]
    for d in range(count):
        for i in range(n + 1):
            K[i] = 0.0
        for j in range(len(states)):
            lever, state = h[j], states[j]
            for i in range(n):
                K[i] += lever * A[d, state, i]
            K[n] += lever * A[d, state, n]
        e, s = z - K[n], r
        for j in range(len(states)):
            s += h[j] * K[states[j]]
        s = max(s, r)
        t.e[d], t.s[d] = e, s
        root = 1.0 / math.sqrt(max(s, e * e / outlier))
        for i in range(n):
            K[i] *= root
        K[n] = -e * root
        for i in range(n):
            for j in range(n):
                A[d, i, j] -= K[i] * K[j]
            A[d, i, n] -= K[i] * K[n]


@jit.kernel
def judge(mix: Mixture, count: int, r: float, level: float, c: Constants, t: Scratch) -> tuple[float, float]:
    """Add ln (N(e; 0, s) + floor / sqrt(r)) but for a constant: a gross error speaks for none.

    Returns the means of the normalised innovation squared and of its surplus e^2 - s: outliers cut, less
    where s is mostly the states' own uncertainty. level: the part of r that follows the surplus.
    """
    least, nis, surplus = c.likelihood_floor / math.sqrt(r), 0.0, 0.0
    own, outlier = c.noise_dominates * level, c.outlier_nis
    for d in range(count):
        s, weight, square = t.s[d], mix.weight[d], t.e[d] * t.e[d]
        ratio = square / s
        mix.found[d] += math.log(math.exp(-0.5 * ratio) / math.sqrt(s) + least)
        nis += weight * ratio
        over = square - s if square < outlier * s else outlier * s - s
        surplus += weight * over if own > s else weight * over * own / s
    return nis, surplus
