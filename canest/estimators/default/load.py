"""The load as a process: it changes in stops, and where innovations surprise it may have changed in motion.

    P(changed | stood t) = 1 - exp(-t / T_l)

Where the vehicle moves off, that share of the probability goes to an unknown load.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from canest.core import jit
from canest.estimators.default.constants import Vehicle
from canest.estimators.default.hypotheses import move, relabel, set_loads
from canest.estimators.default.model import ANSWERED, ANSWERS, GRADE, LOADS, RESPONSE, ROADS, TIMES_U, Mixture, U


@jit.kernel
def changed_probability(seconds: float, stop_s: float) -> float:
    """Return the probability that a load has changed in a stop of so many seconds."""
    return 1.0 - math.exp(-seconds / stop_s)


def _reopen(mix: Mixture, d: int, free: float, u: float, u_var: float, known_u: float, net_kg: float, a: Any) -> None:
    x, P = mix.x[d], mix.P[d]
    for state in (U, RESPONSE) if free > 0.0 else (U,):
        P[state] = 0.0
        P[:, state] = 0.0
    if free > 0.0:
        x[RESPONSE] = 0.0
    lever = np.zeros(len(x))
    lever[U], lever[GRADE] = 1.0, net_kg
    for state in TIMES_U:
        lever[state] = x[state] / known_u
        P[state] *= u / known_u
        P[:, state] *= u / known_u
    x[U] = known_u
    x += lever * (u - known_u)
    P += (lever * u_var)[:, None] * lever


@jit.kernel_beside(_reopen)
def reopen(
    mix: Mixture, d: int, free: float, u: float, u_var: float, known_u: float, net_kg: float, a: Any
) -> None:
    """Open the load of one density: x(u) = x + a (u - known_u), P = P without u + a Var(u) a'.

    a: 1 for u itself; x / known_u for what is times u; net_kg = (F - J dv/dt) / g for the grade, since
    u F - g theta has been right whatever the load. free: 1 where the road shall not answer. a: scratch.
    """
    x, P = mix.x, mix.P
    n = x.shape[1]
    for i in range(n):
        P[d, U, i] = 0.0
        P[d, i, U] = 0.0
        if free > 0.0:
            P[d, RESPONSE, i] = 0.0
            P[d, i, RESPONSE] = 0.0
        a[i] = 0.0
    if free > 0.0:
        x[d, RESPONSE] = 0.0
    a[U], a[GRADE] = 1.0, net_kg
    for state in TIMES_U:
        a[state] = x[d, state] / known_u
        for i in range(n):
            P[d, state, i] *= u / known_u
        for i in range(n):
            P[d, i, state] *= u / known_u
    x[d, U] = known_u
    for i in range(n):
        x[d, i] += a[i] * (u - known_u)
        for j in range(n):
            P[d, i, j] += a[i] * u_var * a[j]


@jit.kernel
def open_load(
    mix: Mixture, count: int, probability: float, net_kg: float, v: Vehicle, loads: Any, scratch: Any, a: Any
) -> int:
    """Give a share of the probability to an unknown load, a copy of the likeliest; returns the densities.

    net_kg: (F - J dv/dt) / g in motion, zero after a stop. After a stop the loads that there are become one;
    in motion nothing is done where there is no room, and in the new load torque is the driver's own: what the
    old one takes for an answer of the road may be the new load. scratch: two columns, of u and its variance.
    """
    base = set_loads(mix, count, loads, scratch[0], scratch[1])
    known_u = min(max(loads[3 * base + 1], v.least_u), v.most_u)
    moving = net_kg != 0.0
    label = -1
    for k in range(LOADS):
        if k != base and not moving:
            relabel(mix, count, k, base)
        if k != base and (loads[3 * k] == 0.0 or not moving):
            label = k
    if label < 0:
        return count
    made, total = count, 0.0
    for d in range(count):
        mode = int(mix.mode[d])
        if mix.load[d] == base and mode < ANSWERED:
            move(mix, d, made)
            free = ANSWERS[mode] if moving else 0.0
            reopen(mix, made, free, v.unknown_u, v.unknown_var, known_u, net_kg, a)
            mix.load[made], mix.mode[made] = float(label), float(mode - ROADS * int(free))
            total += mix.weight[d]
            made += 1
    if made == count:
        return count
    for d in range(made):
        mix.weight[d] *= 1.0 - probability if d < count else probability / total
    return made
