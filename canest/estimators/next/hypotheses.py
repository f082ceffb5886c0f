"""Hypotheses: weighed by Bayes' rule, mixed where they meet, pruned where improbable."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.next.constants import Constants
from canest.estimators.next.model import (
    ANSWERS, BENDS, CURVATURE, DRIFTS, MODES, RATE, RESPONSE, ROADS, ROUGHS, U, Bank,
)

#: loads at most
LOADS = 3
#: densities at most: every mode of every load, twice
MOST = 2 * LOADS * MODES


class Prior(NamedTuple):
    """Prior variances of states that only some modes have."""

    curvature: float
    response: float
    rate: float


@jit.kernel
def weigh(bank: Bank, count: int, power: float, mode_power: float, per_load: Any) -> None:
    """Weigh the densities by their log likelihoods.

    Modes within a load by mode_power, loads by power.
    """
    weight, load, found = bank.weight, bank.load, bank.found
    top = -math.inf
    for d in range(count):
        top = max(top, found[d])
    # per load: probability before, and mean likelihood
    total = 0.0
    for l in range(LOADS):
        before, after = 0.0, 0.0
        for d in range(count):
            if load[d] == l:
                before += weight[d]
                after += weight[d] * math.exp(mode_power * (found[d] - top))
        per_load[l] = 0.0
        if before > 0.0 and after > 0.0:
            scale = before * math.exp(power / mode_power * math.log(after / before)) / after
            per_load[l] = scale
            total += scale * after
    for d in range(count):
        weight[d] *= math.exp(mode_power * (found[d] - top)) * per_load[int(load[d])] / total


@jit.kernel
def remove(bank: Bank, count: int, d: int) -> int:
    """Remove density d: the last takes its place."""
    last = count - 1
    if d != last:
        x, P = bank.x, bank.P
        for i in range(x.shape[1]):
            x[d, i] = x[last, i]
            for j in range(x.shape[1]):
                P[d, i, j] = P[last, i, j]
        bank.weight[d], bank.load[d], bank.mode[d] = bank.weight[last], bank.load[last], bank.mode[last]
    return last


@jit.kernel
def prune(bank: Bank, count: int, least: float) -> int:
    """Remove densities less probable than `least`; returns how many are left."""
    weight = bank.weight
    d = 0
    total = 0.0
    while d < count:
        if weight[d] < least:
            count = remove(bank, count, d)
        else:
            total += weight[d]
            d += 1
    for k in range(count):
        weight[k] /= total
    return count


@jit.kernel
def transition(i: int, j: int, metres: float, driven_s: float, c: Constants) -> float:
    """Return the probability of mode j after mode i."""
    bends = 1.0 - math.exp(-metres / c.straight_m)
    ends = 1.0 - math.exp(-metres / c.curved_m)
    roughens = 1.0 - math.exp(-metres / c.roughens_m)
    smoothens = 1.0 - math.exp(-metres / c.smoothens_m)
    drawn = 1.0 - math.exp(-metres / c.driver_m)
    answers = drawn * (c.answered_share if ANSWERS[i] == 0.0 else 1.0 - c.answered_share)
    p = answers if ANSWERS[i] != ANSWERS[j] else 1.0 - answers
    if ROUGHS[i] > 0.0:
        p *= 1.0 - smoothens if ROUGHS[j] > 0.0 else (smoothens if BENDS[j] > 0.0 else 0.0)
    elif ROUGHS[j] > 0.0:
        p *= roughens
    else:
        bend = bends if BENDS[i] == 0.0 else ends
        p *= (1.0 - roughens) * (bend if BENDS[i] != BENDS[j] else 1.0 - bend)
    drifts = i >= ROADS
    if drifts:
        change = 1.0 - math.exp(-driven_s / c.drift_ends_s)
    else:
        change = 1.0 - math.exp(-driven_s / c.drift_begins_s)
    return p * (change if (j >= ROADS) != drifts else 1.0 - change)


@jit.kernel
def exchange(
    bank: Bank, count: int, metres: float, driven_s: float, prior: Prior, least: float, c: Constants, table: Any, share: Any, room: Bank
) -> int:
    """Let the modes of each load exchange probability."""
    x, P, weight = bank.x, bank.P, bank.weight
    n = x.shape[1]
    for i in range(MODES):
        for j in range(MODES):
            table[i, j] = transition(i, j, metres, driven_s, c)
    made = 0
    for l in range(LOADS):
        for m in range(MODES):
            total = 0.0
            for d in range(count):
                share[d] = 0.0
                if bank.load[d] == l:
                    share[d] = weight[d] * table[int(bank.mode[d]), m]
                    total += share[d]
            if total < least:
                continue
            bent = answered = drifted = 0.0  # shares that come from modes without the state
            y, R = room.x[made], room.P[made]
            for i in range(n):
                y[i] = 0.0
                for j in range(n):
                    R[i, j] = 0.0
            for d in range(count):
                if share[d] > 0.0:
                    share[d] /= total
                    mode = int(bank.mode[d])
                    bent += share[d] * (1.0 - BENDS[mode])
                    answered += share[d] * (1.0 - ANSWERS[mode])
                    drifted += share[d] * (1.0 - DRIFTS[mode])
                    for i in range(n):
                        y[i] += share[d] * x[d, i]
            for d in range(count):
                if share[d] > 0.0:
                    for i in range(n):
                        own = x[d, i] - y[i]
                        for j in range(n):
                            R[i, j] += share[d] * (P[d, i, j] + own * (x[d, j] - y[j]))
            keep(y, R, CURVATURE, BENDS[m], bent * prior.curvature)
            keep(y, R, RESPONSE, ANSWERS[m], answered * prior.response)
            keep(y, R, RATE, DRIFTS[m], drifted * prior.rate)
            room.weight[made], room.load[made], room.mode[made] = total, float(l), float(m)
            made += 1
    total = 0.0
    for d in range(made):
        for i in range(n):
            x[d, i] = room.x[d, i]
            for j in range(n):
                P[d, i, j] = room.P[d, i, j]
        bank.load[d], bank.mode[d] = room.load[d], room.mode[d]
        weight[d] = room.weight[d]
        total += weight[d]
    for d in range(made):
        weight[d] /= total
    return made


@jit.kernel
def keep(y: Any, R: Any, i: int, has: float, fresh: float) -> None:
    """Keep state i where the mode has it, with the prior variance of what comes without; else forget it."""
    if has > 0.0:
        R[i, i] += fresh
    else:
        y[i] = 0.0
        for k in range(len(y)):
            R[i, k] = 0.0
            R[k, i] = 0.0


@jit.kernel
def load_moments(bank: Bank, count: int, l: int) -> tuple[float, float, float]:
    """Return weight, mean and variance of u of a load."""
    total = mean = square = 0.0
    for d in range(count):
        if bank.load[d] == l:
            w, u = bank.weight[d], bank.x[d, U]
            total += w
            mean += w * u
            square += w * (u * u + bank.P[d, U, U])
    if total > 0.0:
        mean /= total
        square /= total
    return total, mean, max(square - mean * mean, 1e-24)


@jit.kernel
def merge_alike(bank: Bank, count: int, least: float) -> None:
    """Make one load of two where that loses less than `least` nats (Runnalls)."""
    for l in range(LOADS):
        wl, ml, vl = load_moments(bank, count, l)
        for k in range(l):
            wk, mk, vk = load_moments(bank, count, k)
            if wl > 0.0 and wk > 0.0:
                total = wl + wk
                q = wl / total
                both = q * vl + (1.0 - q) * vk + q * (1.0 - q) * (ml - mk) * (ml - mk)
                loss = 0.5 * total * (math.log(both) - q * math.log(vl) - (1.0 - q) * math.log(vk))
                if loss < least:
                    relabel(bank, count, l, k)
                    wl = 0.0


@jit.kernel
def relabel(bank: Bank, count: int, before: int, after: int) -> None:
    """Give the densities of a load to another."""
    for d in range(count):
        if bank.load[d] == before:
            bank.load[d] = float(after)


@jit.kernel
def drop_impossible(bank: Bank, count: int, least_u: float, most_u: float) -> int:
    """Remove loads, but for the most probable, whose inverse mass lies beyond the bounds by its std."""
    best, most = 0, 0.0
    for l in range(LOADS):
        w, _, _ = load_moments(bank, count, l)
        if w > most:
            best, most = l, w
    for l in range(LOADS):
        if l != best:
            w, u, var = load_moments(bank, count, l)
            off = max(least_u - u, u - most_u)
            if w > 0.0 and off > 0.0 and off * off > 9.0 * var:
                for d in range(count):
                    if bank.load[d] == l:
                        bank.weight[d] = 0.0
    return prune(bank, count, 1e-300)
