"""The load as a process."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.next.constants import Constants, Vehicle
from canest.estimators.next.hypotheses import LOADS, load_moments, relabel
from canest.estimators.next.model import (
    ANSWERS, BENDS, CURVATURE, DELAY, GRADE, MODES, RATE, RESPONSE, ROADS, SLIP, STRAIGHT_ANSWERED, U, WIND, WINDUP, Bank, Window,
)
from canest.estimators.next.windows import WINDOW_S

_TIMES_U = (WIND, DELAY, SLIP, WINDUP)


class Standing(NamedTuple):
    """How long the load has not been seen."""

    unknown_s: float = 0.0


@jit.kernel
def stand(standing: Standing, w: Window) -> Standing:
    """Return the standing time after a window."""
    still_s = WINDOW_S if w.stopped > 0.0 else 0.0
    return Standing(standing.unknown_s + w.gap_s + still_s)


@jit.kernel
def changed_probability(seconds: float, stop_s: float) -> float:
    """Return the probability that a load has changed in a stop of so many seconds."""
    return 1.0 - math.exp(-seconds / stop_s)


@jit.kernel
def most_probable(bank: Bank, count: int) -> int:
    """Return the load with the largest weight."""
    best, most = 0, 0.0
    for l in range(LOADS):
        w, _, _ = load_moments(bank, count, l)
        if w > most:
            best, most = l, w
    return best


@jit.kernel
def free_label(bank: Bank, count: int) -> int:
    """Return a label that no load has, -1 where all are taken."""
    for l in range(LOADS):
        taken = False
        for d in range(count):
            if bank.load[d] == l:
                taken = True
        if not taken:
            return l
    return -1


@jit.kernel
def open_load(
    bank: Bank, count: int, probability: float, moving: bool, net_kg: float, c: Constants, v: Vehicle, a: Any
) -> int:
    """Give a share of the probability to an unknown load; returns the number of densities."""
    base = most_probable(bank, count)
    if not moving:
        for l in range(LOADS):
            if l != base:
                relabel(bank, count, l, base)
    if free_label(bank, count) < 0:
        return count
    total, known_u, _ = load_moments(bank, count, base)
    known_u = min(max(known_u, v.least_u), v.most_u)
    x, P = bank.x, bank.P
    n = x.shape[1]
    made = count
    label = free_label(bank, count)
    u, u_var = v.mean_u, v.var_u
    ratio = u / known_u
    for d in range(count):
        mode = int(bank.mode[d])
        if bank.load[d] != base or mode >= ROADS:
            continue
        k = made
        made += 1
        for i in range(n):
            x[k, i] = x[d, i]
            for j in range(n):
                P[k, i, j] = P[d, i, j]
        for i in range(n):
            P[k, U, i] = 0.0
            P[k, i, U] = 0.0
        if moving and ANSWERS[mode] > 0.0:  # what the base takes for an answer of the road may be the new load
            mode -= STRAIGHT_ANSWERED
            x[k, RESPONSE] = 0.0
            for i in range(n):
                P[k, RESPONSE, i] = 0.0
                P[k, i, RESPONSE] = 0.0
        for i in range(n):
            a[i] = 0.0
        a[U], a[GRADE] = 1.0, net_kg
        for state in _TIMES_U:
            a[state] = x[k, state] / known_u
            for j in range(n):
                P[k, state, j] *= ratio
                P[k, j, state] *= ratio
        x[k, U] = known_u
        for i in range(n):
            x[k, i] += a[i] * (u - known_u)
            for j in range(n):
                P[k, i, j] += a[i] * u_var * a[j]
        bank.weight[k], bank.load[k], bank.mode[k] = bank.weight[d], float(label), float(mode)
    if made == count:
        return count
    fresh = 0.0
    for d in range(count, made):
        fresh += bank.weight[d]
    for d in range(count):
        bank.weight[d] *= 1.0 - probability
    for d in range(count, made):
        bank.weight[d] *= probability / fresh
    return made
