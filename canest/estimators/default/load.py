"""Load and disturbance as processes: either may be another at once (docs/theory.md, section 8).

Where the vehicle moves off, every 20 s of driving and after a surprise a share of the probability goes to an
unknown load; every second another share to another wind and another torque of accessories.
"""

from __future__ import annotations

import math

import numpy as np

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.hypotheses import copy, set_loads
from canest.estimators.default.model import LOADS, MOST, OTHER_DISTURBANCE, Mixture, Scratch, Window

#: divergence of two loads, in nats, below which one stands for both
_SAME = 0.1


@jit.kernel
def in_overrun(w: Window) -> bool:
    """Return whether the vehicle drives its engine at begin and end of a window."""
    return w.begin_N <= 0.0 and w.traction_N <= 0.0


@jit.kernel
def brakes_unseen(w: Window, surprise: float, innovation: float, c: Constants) -> bool:
    """Return whether a surprise may be a brake that nobody reports: the vehicle is too slow in overrun.

    innovation: of the speed, over its std. A lighter load is as slow, but surprises when driven as well.
    """
    return surprise > c.gross_nis and innovation < 0.0 and in_overrun(w)


@jit.kernel
def reopen(mix: Mixture, d: int, net_N: float, v: Vehicle) -> None:
    """Open the load of one density: x(u) = x + a (u - known_u), P = P without u + a Var(u) a'.

    a: 1 for u itself; x / known_u for what is times u; net_N / g for the grade, since u F - g theta has been
    right whatever the load. net_N: F - J dv/dt.
    """
    x, P = mix.x[d], mix.P[d]
    known_u = min(max(x[m.U], v.least_u), v.most_u)
    P[m.U] = 0.0
    P[:, m.U] = 0.0
    a = np.zeros(len(x))
    a[m.U], a[m.GRADE] = 1.0, net_N / GRAVITY_MPS2
    for state in m.TIMES_U:
        a[state] = x[state] / known_u
        P[state] *= v.unknown_u / known_u
        P[:, state] *= v.unknown_u / known_u
    x[m.U] = known_u
    x += a * (v.unknown_u - known_u)
    for i in range(len(x)):
        P[i] += a[i] * v.unknown_var * a


@jit.kernel
def merge_loads(mix: Mixture, count: int, t: Scratch) -> None:
    """Give loads that say the same of u as the densest its number, so that theirs are free again.

    That is what their divergence says (Kullback and Leibler). An exchange has to follow.
    """
    loads, base = t.loads, set_loads(mix, count, t)
    mean, var = loads[3 * base + 1], loads[3 * base + 2]
    for d in range(count):
        k = 3 * (mix.load[d] % LOADS)
        off, ratio = loads[k + 1] - mean, loads[k + 2] / var
        if ratio > 0.0 and 0.5 * (off * off / var + ratio - 1.0 - math.log(ratio)) < _SAME:
            mix.load[d] = base


@jit.kernel
def open_load(
    mix: Mixture, count: int, share: float, moving: bool, net_N: float, c: Constants, v: Vehicle, t: Scratch
) -> int:
    """Give a share of the probability to an unknown load; returns the densities.

    In motion it is a copy of the densest, and nothing is done where there is no number for another load.
    After a stop all loads become one and all are copied: an exchange has to follow. What there is no room for
    is not copied.
    """
    base, label = set_loads(mix, count, t), -1
    for k in range(LOADS):
        if k != base and (t.loads[3 * k] == 0.0 or not moving):
            label = k
    if label < 0 or count >= MOST:
        return count
    made, total = count, 0.0
    for d in range(count):
        if not moving:
            mix.load[d] = base
        if mix.load[d] % LOADS == base and made < MOST:
            copy(mix, d, mix, made)
            reopen(mix, made, net_N, v)
            if mix.x.shape[1] == m.STATES:  # a frame tilts under another load
                mix.P[made, m.BIAS, m.BIAS] += c.load_tilt_mps2 * c.load_tilt_mps2
            mix.load[made] = label
            total += mix.weight[d]
            made += 1
    for d in range(made):
        mix.weight[d] *= 1.0 - share if d < count else share / total
    return made


@jit.kernel
def open_disturbance(mix: Mixture, count: int, changed: float, u: float, c: Constants, v: Vehicle) -> int:
    """Give a share of every density to a copy with another disturbance; returns the densities.

    Not where it would be too improbable to live. changed: probability. u: mean inverse mass.
    """
    wind, offset, made = c.jump_stds * c.wind_std_mps * u, c.jump_stds * v.offset_Nm * u, count
    for d in range(count):
        if changed * mix.weight[d] > c.least_weight and made < MOST:
            copy(mix, d, mix, made)
            mix.P[made, m.WIND, m.WIND] += wind * wind
            mix.P[made, m.OFFSET, m.OFFSET] += offset * offset
            mix.weight[made], mix.load[made] = changed * mix.weight[d], mix.load[d] + OTHER_DISTURBANCE
            mix.weight[d] *= 1.0 - changed
            made += 1
    return made
