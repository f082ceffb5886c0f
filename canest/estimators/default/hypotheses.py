"""Hypotheses: weighed by Bayes' rule, mixed where they meet, pruned where improbable.

The modes of a load exchange probability like a Markov chain, and each becomes the normal density with the
mean and covariance of what comes to it (interacting multiple models, Blom and Bar-Shalom 1988). Loads are
weighed by a power of their likelihood, and two alike become one (Runnalls 2007).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from canest.core import jit
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.model import (
    ANSWERED,
    ANSWERS,
    BENDS,
    CURVATURE,
    DRIFTS,
    LOADS,
    MODES,
    MOST,
    RATE,
    RESPONSE,
    ROADS,
    Mixture,
    U,
)
from canest.estimators.default.predict import column, variances

#: least variance of an inverse mass, against rounding, 1/kg2
_LEAST_VARIANCE = 1e-24


@jit.kernel
def weigh(mix: Mixture, count: int, power: float, scale: Any) -> None:
    """Weigh the densities by their log likelihoods: modes within a load fully, loads by the power.

    scale: scratch, one per load.
    """
    weight, load, found = mix.weight, mix.load, mix.found
    top = -math.inf
    for d in range(count):
        top = max(top, found[d])
    for k in range(LOADS):
        scale[k] = 0.0
    total = 0.0
    for d in range(count):
        found[d] = math.exp(found[d] - top)
    for k in range(LOADS):
        before = after = 0.0
        for d in range(count):
            if load[d] == k:
                before += weight[d]
                after += weight[d] * found[d]
        if before > 0.0 and after > 0.0:  # before (after / before)^power
            likely = before * math.exp(power * math.log(after / before))
            scale[k] = likely / after
            total += likely
    for d in range(count):
        weight[d] *= found[d] * scale[int(load[d])] / total


def _move(mix: Mixture, source: int, target: int) -> None:
    mix.x[target] = mix.x[source]
    mix.P[target] = mix.P[source]
    for values in (mix.weight, mix.load, mix.mode, mix.found):
        values[target] = values[source]


@jit.kernel_beside(_move)
def move(mix: Mixture, source: int, target: int) -> None:
    """Copy one density over another."""
    x, P = mix.x, mix.P
    for i in range(x.shape[1]):
        x[target, i] = x[source, i]
        for j in range(x.shape[1]):
            P[target, i, j] = P[source, i, j]
    mix.weight[target], mix.load[target] = mix.weight[source], mix.load[source]
    mix.mode[target], mix.found[target] = mix.mode[source], mix.found[source]


@jit.kernel
def prune(mix: Mixture, count: int, least: float) -> int:
    """Remove the densities below a weight; the last takes the place. Returns how many are left."""
    weight = mix.weight
    total, d = 0.0, 0
    while d < count:
        if weight[d] < least:
            count -= 1
            if d != count:
                move(mix, count, d)
        else:
            total += weight[d]
            d += 1
    for k in range(count):
        weight[k] /= total
    return count


@jit.kernel
def set_transitions(metres: float, driven_s: float, c: Constants, table: Any) -> None:
    """Set the probability of mode j after mode i at [i * MODES + j]: that of road, driver and load."""
    curves, straightens = 1.0 - math.exp(-metres / c.straight_m), 1.0 - math.exp(-metres / c.curved_m)
    roughens, smoothens = 1.0 - math.exp(-metres / c.roughens_m), 1.0 - math.exp(-metres / c.smoothens_m)
    drawn = 1.0 - math.exp(-metres / c.driver_m)
    begins, ends = 1.0 - math.exp(-driven_s / c.drift_begins_s), 1.0 - math.exp(-driven_s / c.drift_ends_s)
    smooth = 1.0 - roughens
    roads = (
        smooth * (1.0 - curves), smooth * curves, roughens,
        smooth * straightens, smooth * (1.0 - straightens), roughens,
        0.0, smoothens, 1.0 - smoothens,
    )  # fmt: skip
    frees, answers = drawn * (1.0 - c.answered), drawn * c.answered
    drivers = (1.0 - answers, answers, frees, 1.0 - frees)
    loads = (1.0 - begins, begins, ends, 1.0 - ends)
    for i in range(MODES):
        for j in range(MODES):
            driver = drivers[2 * (i // ROADS % 2) + j // ROADS % 2]
            load = loads[2 * (i // ANSWERED) + j // ANSWERED]
            table[i * MODES + j] = roads[ROADS * (i % ROADS) + j % ROADS] * driver * load


def _mean_of(mix: Mixture, count: int, share: Any, made: int, room: Mixture) -> None:
    shares = np.array(share[: made * MOST]).reshape(made, MOST)
    y, R = room.x[:made], room.P[:made]
    y[:], R[:] = 0.0, 0.0
    for d in range(count):
        y += shares[:, d, None] * mix.x[d]
    for d in range(count):
        off = mix.x[d] - y
        R += shares[:, d, None, None] * (mix.P[d] + off[:, :, None] * off[:, None, :])


@jit.kernel_beside(_mean_of)
def mean_of(mix: Mixture, count: int, share: Any, made: int, room: Mixture) -> None:
    """Give density t of the room mean and covariance of those of the mixture, by shares [t * MOST + d]."""
    x, P, y, R = mix.x, mix.P, room.x, room.P
    n = x.shape[1]
    for t in range(made):
        for i in range(n):
            y[t, i] = 0.0
            for j in range(n):
                R[t, i, j] = 0.0
        for d in range(count):
            part = share[t * MOST + d]
            if part > 0.0:
                for i in range(n):
                    y[t, i] += part * x[d, i]
        for d in range(count):
            part = share[t * MOST + d]
            if part > 0.0:
                for i in range(n):
                    off = x[d, i] - y[t, i]
                    for j in range(n):
                        R[t, i, j] += part * (P[d, i, j] + off * (x[d, j] - y[t, j]))


def _keep(room: Mixture, made: int, i: int, modes: Any, fresh: Any) -> None:
    has = np.array([modes[int(m)] for m in room.mode[:made]])
    room.x[:made, i] *= has
    room.P[:made, i] *= has[:, None]
    room.P[:made, :, i] *= has[:, None]
    room.P[:made, i, i] += has * fresh[:made]


@jit.kernel_beside(_keep)
def keep(room: Mixture, made: int, i: int, modes: Any, fresh: Any) -> None:
    """Keep a state where the mode has it, with the prior variance of what comes without; else forget it."""
    for t in range(made):
        has = modes[int(room.mode[t])]
        room.x[t, i] *= has
        for k in range(room.x.shape[1]):
            room.P[t, i, k] *= has
        for k in range(room.x.shape[1]):
            room.P[t, k, i] *= has
        room.P[t, i, i] += has * fresh[t]


@jit.kernel
def lacking(mix: Mixture, count: int, made: int, share: Any, modes: Any, variance: float, out: Any) -> None:
    """Set the prior variance of a state that comes from modes without it, per new density."""
    for t in range(made):
        part = 0.0
        for d in range(count):
            part += share[t * MOST + d] * (1.0 - modes[int(mix.mode[d])])
        out[t] = part * variance


@jit.kernel
def exchange(
    mix: Mixture, count: int, table: Any, fresh: Any, least: float, room: Mixture, share: Any, out: Any
) -> int:
    """Let the modes of each load exchange probability by the table; returns the number of densities.

    fresh: prior variances of curvature, response and rate. room, share, out: scratch.
    """
    made = 0
    for load in range(LOADS):
        for m in range(MODES):
            total, at = 0.0, made * MOST
            for d in range(count):
                part = 0.0
                if mix.load[d] == load:
                    part = mix.weight[d] * table[int(mix.mode[d]) * MODES + m]
                share[at + d] = part
                total += part
            if total >= least:
                for d in range(count):
                    share[at + d] /= total
                room.weight[made], room.load[made], room.mode[made] = total, float(load), float(m)
                made += 1
    mean_of(mix, count, share, made, room)
    lacking(mix, count, made, share, BENDS, fresh[0], out)
    keep(room, made, CURVATURE, BENDS, out)
    lacking(mix, count, made, share, ANSWERS, fresh[1], out)
    keep(room, made, RESPONSE, ANSWERS, out)
    lacking(mix, count, made, share, DRIFTS, fresh[2], out)
    keep(room, made, RATE, DRIFTS, out)
    take(room, made, mix)
    return prune(mix, made, least)


def _take(room: Mixture, count: int, mix: Mixture) -> None:
    mix.x[:count], mix.P[:count] = room.x[:count], room.P[:count]
    mix.weight[:count], mix.load[:count] = room.weight[:count], room.load[:count]
    mix.mode[:count] = room.mode[:count]


@jit.kernel_beside(_take)
def take(room: Mixture, count: int, mix: Mixture) -> None:
    """Copy the densities of the room into the mixture."""
    n = mix.x.shape[1]
    for d in range(count):
        for i in range(n):
            mix.x[d, i] = room.x[d, i]
            for j in range(n):
                mix.P[d, i, j] = room.P[d, i, j]
        mix.weight[d], mix.load[d], mix.mode[d] = room.weight[d], room.load[d], room.mode[d]


@jit.kernel
def set_loads(mix: Mixture, count: int, loads: Any, us: Any, u_vars: Any) -> int:
    """Set weight, mean and variance of the inverse mass of every load, at [3 k]; returns the likeliest.

    us, u_vars: set to those of every density.
    """
    column(mix.x, count, U, us)
    variances(mix.P, count, U, u_vars)
    for k in range(3 * LOADS):
        loads[k] = 0.0
    for d in range(count):
        k = 3 * int(mix.load[d])
        loads[k] += mix.weight[d]
        loads[k + 1] += mix.weight[d] * us[d]
        loads[k + 2] += mix.weight[d] * (us[d] * us[d] + u_vars[d])
    best = 0
    for k in range(0, 3 * LOADS, 3):
        if loads[k] > 0.0:
            mean = loads[k + 1] / loads[k]
            loads[k + 1], loads[k + 2] = mean, max(loads[k + 2] / loads[k] - mean * mean, _LEAST_VARIANCE)
        if loads[k] > loads[best]:
            best = k
    return best // 3


@jit.kernel
def relabel(mix: Mixture, count: int, before: int, after: int) -> None:
    """Give the densities of one load to another: the next exchange makes one of them per mode."""
    for d in range(count):
        if mix.load[d] == before:
            mix.load[d] = float(after)


@jit.kernel
def merge_alike(mix: Mixture, count: int, least: float, loads: Any, us: Any, u_vars: Any) -> None:
    """Make one load of two where that loses less than `least` nats of the density of u."""
    set_loads(mix, count, loads, us, u_vars)
    for i in range(3, 3 * LOADS, 3):
        for j in range(0, i, 3):
            if loads[i] > 0.0 and loads[j] > 0.0:
                total = loads[i] + loads[j]
                share, apart = loads[i] / total, loads[i + 1] - loads[j + 1]
                both = share * loads[i + 2] + (1.0 - share) * (loads[j + 2] + share * apart * apart)
                loss = math.log(both) - share * math.log(loads[i + 2]) - (1.0 - share) * math.log(loads[j + 2])
                if 0.5 * total * loss < least:
                    relabel(mix, count, i // 3, j // 3)
                    loads[i] = 0.0


@jit.kernel
def drop_impossible(mix: Mixture, count: int, v: Vehicle, far: float, loads: Any, us: Any, u_vars: Any) -> int:
    """Remove loads, but for the likeliest, whose inverse mass lies far beyond the bounds, in variances."""
    best = set_loads(mix, count, loads, us, u_vars)
    dropped = False
    for k in range(0, 3 * LOADS, 3):
        off = max(v.least_u - loads[k + 1], loads[k + 1] - v.most_u)
        if loads[k] > 0.0 and k != 3 * best and off > 0.0 and off * off > far * loads[k + 2]:
            dropped = True
            for d in range(count):
                if mix.load[d] == k // 3:
                    mix.weight[d] = 0.0
    return prune(mix, count, _LEAST_VARIANCE) if dropped else count
