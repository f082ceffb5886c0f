"""Hypotheses: for every load a normal density per mode of road and driver; mixed, weighed, merged and pruned.

Modes exchange probability like a Markov chain, and where two meet they become the normal density with the
mean and covariance of both (interacting multiple models, Blom and Bar-Shalom 1988). Loads are weighed by a
power of their likelihood and merged by Runnalls' bound on the loss (2007).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.default.model import MODES, RATE, U
from canest.estimators.default.predict import Matrix, Vector, reset

#: a mode less probable than this, its load's probability counted, is left out until the next exchange
PRUNE = 1e-4
#: a load less probable than this is left out until the next challenge
PRUNE_LOAD = 1e-4
#: least variance of an inverse mass, against rounding, 1/kg2
_LEAST_VARIANCE = 1e-24
#: loads are merged where that loses less than this, in nats
MERGE = 0.02


class Filters(NamedTuple):
    """Densities of the states, by load k and mode m; a load without weight is not there."""

    x: Any  #: (loads, MODES, n) means
    P: Any  #: (loads, MODES, n, n) covariances
    mode: Any  #: (loads, MODES) probability of the modes, given the load
    weight: Any  #: (loads,) probability of the loads
    pending: Any  #: (loads,) log likelihood since gates closed
    drifting: Any  #: (loads,) 1 where the load drifts, else 0


class Room(NamedTuple):
    """Room for two densities and a difference."""

    x: Vector
    P: Matrix
    y: Vector
    R: Matrix
    d: Vector


@jit.kernel
def copy_density(x: Vector, P: Matrix, y: Vector, R: Matrix) -> None:
    """Copy the density (x, P) to (y, R)."""
    for i in range(len(x)):
        y[i] = x[i]
        own, other = R[i], P[i]
        for j in range(len(x)):
            own[j] = other[j]


@jit.kernel
def join(x: Vector, P: Matrix, weight: float, y: Vector, R: Matrix, other: float, d: Vector) -> None:
    """Give (x, P) the mean and covariance of both densities, by their weights."""
    n = len(x)
    share = other / (weight + other)
    both = share * (1.0 - share)
    for i in range(n):
        d[i] = y[i] - x[i]
    for i in range(n):
        own, theirs, lever = P[i], R[i], both * d[i]
        for j in range(n):
            own[j] += share * (theirs[j] - own[j]) + lever * d[j]
        x[i] += share * d[i]


@jit.kernel
def exchange(
    filters: Filters,
    k: int,
    a: int,
    b: int,
    a_to_b: float,
    b_to_a: float,
    state: int,
    variance: float,
    room: Room,
) -> None:
    """Let modes a and b of load k exchange probability; `state` lives in b, with a prior variance."""
    mode = filters.mode[k]
    stays, comes = mode[a] * (1.0 - a_to_b), mode[b] * b_to_a
    goes, remains = mode[a] * a_to_b, mode[b] * (1.0 - b_to_a)
    if stays + comes <= 0.0 or goes + remains <= 0.0:
        return
    xa, Pa, xb, Pb = filters.x[k][a], filters.P[k][a], filters.x[k][b], filters.P[k][b]
    copy_density(xa, Pa, room.x, room.P)
    copy_density(xb, Pb, room.y, room.R)
    reset(room.y, room.R, state, 0.0, 0.0)
    join(xa, Pa, stays, room.y, room.R, comes, room.d)
    room.x[state] = 0.0
    room.P[state][state] = variance
    if remains > 0.0:
        join(xb, Pb, remains, room.x, room.P, goes, room.d)
    else:
        copy_density(room.x, room.P, xb, Pb)
    mode[a], mode[b] = stays + comes, goes + remains


@jit.kernel
def weigh_modes(mode: Vector, found: Vector, weight: float) -> float:
    """Weigh the modes of a load of this weight by their log likelihoods; return that of the load."""
    top = -math.inf
    for m in range(MODES):
        if mode[m] > 0.0:
            top = max(top, found[m])
    total = 0.0
    for m in range(MODES):
        if mode[m] > 0.0:
            mode[m] *= math.exp(found[m] - top)
            total += mode[m]
    kept, least = 0.0, min(PRUNE / weight, 0.05)
    for m in range(MODES):
        mode[m] = mode[m] / total if mode[m] >= least * total else 0.0
        kept += mode[m]
    for m in range(MODES):
        mode[m] /= kept
    return top + math.log(total)


@jit.kernel
def weigh_loads(weight: Vector, pending: Vector) -> None:
    """Weigh the loads by the log likelihoods that have gathered, and prune them."""
    top = -math.inf
    for k in range(len(weight)):
        if weight[k] > 0.0:
            top = max(top, pending[k])
    total = 0.0
    for k in range(len(weight)):
        if weight[k] > 0.0:
            weight[k] *= math.exp(pending[k] - top)
            total += weight[k]
        pending[k] = 0.0
    kept = 0.0
    for k in range(len(weight)):
        weight[k] = weight[k] / total if weight[k] >= PRUNE_LOAD * total else 0.0
        kept += weight[k]
    for k in range(len(weight)):
        weight[k] /= kept


@jit.kernel
def moments_of_u(filters: Filters, k: int) -> tuple[float, float]:
    """Return mean and variance of a load's inverse mass."""
    mean = square = 0.0
    mode = filters.mode[k]
    for m in range(MODES):
        if mode[m] > 0.0:
            u = filters.x[k][m][U]
            mean += mode[m] * u
            square += mode[m] * (u * u + filters.P[k][m][U][U])
    return mean, max(square - mean * mean, _LEAST_VARIANCE)


@jit.kernel
def merge_loads(filters: Filters, kl: int, ki: int, d: Vector) -> None:
    """Merge load kl into load ki, mode by mode."""
    weight = filters.weight
    total = weight[ki] + weight[kl]
    for m in range(MODES):
        own, other = weight[ki] * filters.mode[ki][m], weight[kl] * filters.mode[kl][m]
        if own > 0.0 and other > 0.0:
            join(filters.x[ki][m], filters.P[ki][m], own, filters.x[kl][m], filters.P[kl][m], other, d)
        elif other > 0.0:
            copy_density(filters.x[kl][m], filters.P[kl][m], filters.x[ki][m], filters.P[ki][m])
        if other > 0.0 and filters.drifting[ki] < filters.drifting[kl]:  # a steady load has no rate
            reset(filters.x[ki][m], filters.P[ki][m], RATE, 0.0, 0.0)
        filters.mode[ki][m] = (own + other) / total
    filters.pending[ki] = (weight[ki] * filters.pending[ki] + weight[kl] * filters.pending[kl]) / total
    weight[ki], weight[kl] = total, 0.0


@jit.kernel
def merge_alike(filters: Filters, means: Vector, variances: Vector, d: Vector) -> None:
    """Merge the pair of loads that loses least, while it loses less than `MERGE`."""
    weight = filters.weight
    for k in range(len(weight)):
        if weight[k] > 0.0:
            means[k], variances[k] = moments_of_u(filters, k)
    while True:
        best, first, second = MERGE, -1, -1
        for i in range(len(weight)):
            for j in range(i):
                if weight[i] > 0.0 and weight[j] > 0.0 and filters.drifting[i] == filters.drifting[j]:
                    total = weight[i] + weight[j]
                    share, apart = weight[i] / total, means[i] - means[j]
                    both = share * variances[i] + (1.0 - share) * variances[j]
                    both += share * (1.0 - share) * apart * apart
                    loss = math.log(both) - share * math.log(variances[i])
                    loss = 0.5 * total * (loss - (1.0 - share) * math.log(variances[j]))
                    if loss < best:
                        best, first, second = loss, i, j
        if first < 0:
            return
        merge_loads(filters, second, first, d)
        means[first], variances[first] = moments_of_u(filters, first)


@jit.kernel
def most_probable(weight: Vector) -> int:
    """Return the load with the largest weight."""
    best = 0
    for k in range(len(weight)):
        if weight[k] > weight[best]:
            best = k
    return best


@jit.kernel
def prune_impossible(filters: Filters, least: float, most: float) -> None:
    """Leave out loads, but for the most probable, whose inverse mass lies beyond the bounds by its std."""
    weight = filters.weight
    best = most_probable(weight)
    left = 1.0
    for k in range(len(weight)):
        if k != best and weight[k] > 0.0:
            u, var = moments_of_u(filters, k)
            off = max(least - u, u - most)
            if off > 0.0 and off * off > var:
                left -= weight[k]
                weight[k] = 0.0
    if left < 1.0:
        for k in range(len(weight)):
            weight[k] /= left


@jit.kernel
def mean_inverse_mass(filters: Filters, least: float, most: float) -> float:
    """Return the mean of u over all hypotheses, each within the vehicle's bounds."""
    mean = 0.0
    for k in range(len(filters.weight)):
        if filters.weight[k] > 0.0:
            mode = filters.mode[k]
            for m in range(MODES):
                if mode[m] > 0.0:
                    u = min(max(filters.x[k][m][U], least), most)
                    mean += filters.weight[k] * mode[m] * u
    return mean
