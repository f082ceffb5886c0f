"""Hypotheses: weighed by Bayes' rule, mixed where they meet, pruned (docs/theory.md, sections 6.4 and 7)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from canest.core import jit
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants
from canest.estimators.default.driver import draw_answer
from canest.estimators.default.model import LASTING, LOADS, MODES, MOST, ROADS, Mixture, Scratch, Space
from canest.estimators.default.predict import moments

#: least variance of an inverse mass, against rounding, 1/kg2
_LEAST_VARIANCE = 1e-24
#: what a density may say of load, disturbance, drift and driver
_LASTING = 2 * LOADS * LASTING
#: share of a mixture that does not change it
_NEGLIGIBLE = 1e-6


@jit.kernel
def weigh(mix: Mixture, count: int, power: float, t: Scratch) -> None:
    """Weigh the densities by their log likelihoods, and clear these: roads fully, what lasts by the power."""
    load, mode, weight, found = mix.load, mix.mode, mix.weight, mix.found
    before, after, top = t.columns[0], t.columns[1], -math.inf
    for d in range(count):
        top = found[d] if found[d] > top else top
    for k in range(_LASTING):
        before[k] = after[k] = 0.0
    for d in range(count):
        k = LASTING * load[d] + mode[d] // ROADS  # what it says of all but the road
        found[d] = math.exp(found[d] - top)
        before[k] += weight[d]
        after[k] += weight[d] * found[d]
    total = 0.0
    for k in range(_LASTING):
        if after[k] > 0.0:  # before (after / before)^power
            likely = before[k] * math.exp(power * math.log(after[k] / before[k]))
            after[k] = likely / after[k]  # by which its densities count
            total += likely
    for d in range(count):
        weight[d] *= found[d] * after[LASTING * load[d] + mode[d] // ROADS] / total
        found[d] = 0.0


@jit.kernel
def copy(source: Mixture, d: int, target: Mixture, e: int) -> None:
    """Copy density d of one mixture over density e of another, or of the same."""
    np.positive(source.A[d], target.A[e])
    target.weight[e], target.load[e], target.mode[e] = source.weight[d], source.load[d], source.mode[d]


@jit.kernel
def prune(mix: Mixture, count: int, least: float) -> int:
    """Remove the densities below a weight; the last takes the place. Returns how many are left."""
    weight = mix.weight
    total, d = 0.0, 0
    while d < count:
        if weight[d] < least:
            count -= 1
            if d != count:
                copy(mix, count, mix, d)
        else:
            total += weight[d]
            d += 1
    for k in range(count):
        weight[k] /= total
    return count


@jit.kernel
def p_changed(span: float, mean: float) -> float:
    """Return the probability that what lasts for `mean` on average has changed within a span."""
    return 1.0 - math.exp(-span / mean)


@jit.kernel
def transitions(metres: float, driven_s: float, c: Constants) -> tuple[Any, Any, Any]:
    """Return the transition probabilities of road (3 x 3), driver and load (2 x 2), row by row."""
    curves = p_changed(metres, c.straight_length_m)
    straightens = p_changed(metres, c.curved_length_m)
    roughens = p_changed(metres, c.smooth_length_m)
    smoothens = p_changed(metres, c.rough_length_m)
    drawn = p_changed(metres, c.driver_length_m)
    begins = p_changed(driven_s, c.steady_duration_s)
    ends = p_changed(driven_s, c.drift_duration_s)
    smooth, frees, answers = 1.0 - roughens, drawn * (1.0 - c.answered_share), drawn * c.answered_share
    roads = (
        smooth * (1.0 - curves), smooth * curves, roughens,
        smooth * straightens, smooth * (1.0 - straightens), roughens,
        0.0, smoothens, 1.0 - smoothens,
    )  # fmt: skip
    return roads, (1.0 - answers, answers, frees, 1.0 - frees), (1.0 - begins, begins, ends, 1.0 - ends)


def _mix(mix: Mixture, count: int, made: int, space: Space) -> None:
    x, middle, room = mix.x[:count], mix.x[0].copy(), space.room
    x -= middle
    mix.P[:count] += x[:, :, None] * x[:, None]
    sums: Any = 0.0
    for d, second in enumerate(mix.A[:count].reshape(count, -1)):
        sums = sums + np.array(space.share[d : made * MOST : MOST])[:, None] * second
    room.A[:made] = sums.reshape(made, *room.A.shape[1:])
    y = room.x[:made].copy()
    room.P[:made] -= y[:, :, None] * y[:, None]
    room.x[:made] = y + middle


@jit.kernel_beside(_mix)
def mix_densities(mix: Mixture, count: int, made: int, space: Space) -> None:
    """Give density k of the room mean and covariance of those of the mixture, by share[k * MOST + d].

    Sums second moments about the mean of the first density, and leaves these in the mixture.
    """
    A, R, share, middle = mix.A, space.room.A, space.share, space.scratch.K
    n = A.shape[1]
    seconds, sums = A.reshape(len(A), n * (n + 1)), R.reshape(len(R), n * (n + 1))
    for i in range(n):
        middle[i] = A[0, i, n]
    for d in range(count):
        for i in range(n):
            A[d, i, n] -= middle[i]
        for i in range(n):
            for j in range(n):
                A[d, i, j] += A[d, i, n] * A[d, j, n]
    for k in range(made):
        R[k] = 0.0
        for d in range(count):
            part = share[k * MOST + d]
            if part > 0.0:
                for i in range(n * (n + 1)):
                    sums[k, i] += part * seconds[d, i]
        for i in range(n):
            for j in range(n):
                R[k, i, j] -= R[k, i, n] * R[k, j, n]
        for i in range(n):
            R[k, i, n] += middle[i]


@jit.kernel
def give_priors(mix: Mixture, count: int, bend_var: float, u: float, rate: float, left: float) -> None:
    """Give densities without curvature, drift or answer the prior of a mode that has it: they may come there.

    u: mean inverse mass. rate: mean and standard deviation of its drift. left: part of an answer that is left
    where there was one; the rest is drawn anew.
    """
    for d in range(count):
        mode = mix.mode[d]
        if m.BENDS[mode] == 0.0:
            mix.P[d, m.CURVATURE, m.CURVATURE] = bend_var
        if m.DRIFTS[mode] == 0.0:
            mix.x[d, m.RATE], mix.P[d, m.RATE, m.RATE] = rate, rate * rate
        draw_answer(mix, d, left * m.ANSWERS[mode], u)


@jit.kernel
def forget(room: Mixture, made: int, i: int, modes: Any) -> None:
    """Forget a state in the modes that do not have it."""
    for k in range(made):
        if modes[room.mode[k]] == 0.0:
            room.A[k, i] = 0.0
            room.A[k, :, i] = 0.0


@jit.kernel
def exchange(mix: Mixture, count: int, chains: Any, least: float, space: Space) -> int:
    """Let the modes of each load exchange probability; returns the number of densities.

    chains: `transitions`. What a mode does not have must have been given its prior (`give_priors`).
    """
    roads, drivers, loads = chains
    room, share, load_of = space.room, space.share, mix.load
    for d in range(count):
        load_of[d] %= LOADS  # another disturbance is a mode like all of its load from here on
        own, k = mix.mode[d], MODES * load_of[d] * MOST + d
        at_road, at_driver = ROADS * (own % ROADS), 2 * (own // ROADS % 2)
        at_load = 2 * (own // m.STEADY_MODES)
        for load in range(2):
            of_load = mix.weight[d] * loads[at_load + load]
            for driver in range(2):
                part = of_load * drivers[at_driver + driver]
                for road in range(ROADS):
                    share[k] = part * roads[at_road + road]
                    k += MOST
    made, whole = 0, 0.0
    for load in range(LOADS):
        for mode in range(MODES):
            total, at, into = 0.0, (MODES * load + mode) * MOST, made * MOST
            for d in range(count):
                if load_of[d] == load:
                    total += share[at + d]
            if total >= least:
                kept = 0.0
                for d in range(count):
                    part = share[at + d] if load_of[d] == load else 0.0
                    share[into + d] = part if part > _NEGLIGIBLE * total else 0.0
                    kept += share[into + d]
                for d in range(count):
                    share[into + d] /= kept
                room.weight[made], room.load[made], room.mode[made] = total, load, mode
                whole += total
                made += 1
    for k in range(made):
        room.weight[k] /= whole
    mix_densities(mix, count, made, space)
    forget(room, made, m.CURVATURE, m.BENDS)
    forget(room, made, m.RATE, m.DRIFTS)
    forget(room, made, m.ANSWER, m.ANSWERS)
    take(room, made, mix)
    return made


@jit.kernel
def change_modes(
    mix: Mixture, count: int, metres: float, driven_s: float, u: float, bend_var: float,
    c: Constants, space: Space,
) -> int:  # fmt: skip
    """Let modes exchange probability; returns the densities. u: mean inverse mass."""
    give_priors(mix, count, bend_var, u, c.drift_1ps * u, math.exp(-metres / c.answer_length_m))
    return exchange(mix, count, transitions(metres, driven_s, c), c.least_weight, space)


@jit.kernel
def take(room: Mixture, count: int, mix: Mixture) -> None:
    """Copy the densities of the room into the mixture."""
    np.positive(room.A[:count], mix.A[:count])
    mix.weight[:count], mix.load[:count] = room.weight[:count], room.load[:count]
    mix.mode[:count] = room.mode[:count]


@jit.kernel
def set_loads(mix: Mixture, count: int, t: Scratch) -> int:
    """Set weight, mean and variance of the inverse mass of every load, t.loads[3 k]; returns the densest.

    That is the one in which the density of ln u is highest: weight * mean / std. Leaves mean and variance of
    every density in t.columns[0] and [1].
    """
    loads, us, u_vars = t.loads, t.columns[0], t.columns[1]
    moments(mix, count, m.U, us, u_vars)
    for k in range(3 * LOADS):
        loads[k] = 0.0
    for d in range(count):
        k = 3 * (mix.load[d] % LOADS)
        loads[k] += mix.weight[d]
        loads[k + 1] += mix.weight[d] * us[d]
        loads[k + 2] += mix.weight[d] * (us[d] * us[d] + u_vars[d])
    best, highest = 0, -math.inf  # a mean may be negative
    for k in range(0, 3 * LOADS, 3):
        if loads[k] > 0.0:
            mean = loads[k + 1] / loads[k]
            variance = max(loads[k + 2] / loads[k] - mean * mean, _LEAST_VARIANCE)
            loads[k + 1], loads[k + 2] = mean, variance
            height = loads[k] * mean / math.sqrt(variance)
            if height > highest:
                best, highest = k, height
    return best // 3
