"""The posterior that is reported: moments of the mixture, within the bounds of the vehicle (section 10).

The likelihood counts by a power for the mass, so the variance of u is divided by it. Loads that together hold
less than `left_out` are no part of the standard deviation: two of them are to hold 95 % of the probability.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from canest.core import jit
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.load import changed_probability
from canest.estimators.default.model import LOADS, Mixture, Scratch, Space

#: windows between two sums over the nodes
_EVERY = 5.0


class Report(NamedTuple):
    """What is reported after a window, and carried to the next."""

    mass_kg: float
    mass_var: float
    grade: float  #: sine, where the vehicle is at the window's last sample
    grade_var: float
    slope_1pm: float = 0.0  #: change of the grade per metre
    wander_1pm: float = 0.0  #: variance that the grade gains per metre
    windows: float = 0.0  #: until the mixture is summed again


@jit.kernel
def leave_out(mix: Mixture, count: int, left_out: float, t: Scratch) -> None:
    """Set t.columns[2] to the weights of the densities, zero for loads that are left out; normalised."""
    loads, share = t.loads, t.columns[2]
    small = 0.0
    for k in range(0, 3 * LOADS, 3):
        if loads[k] < left_out:
            small += loads[k]
    least = left_out if small < left_out else 0.0
    total = 0.0
    for d in range(count):
        share[d] = mix.weight[d] if loads[3 * int(mix.load[d])] >= least else 0.0
        total += share[d]
    for d in range(count):
        share[d] /= total


@jit.kernel
def sum_over_nodes(count: int, power: float, space: Space) -> tuple[float, float]:
    """Return mean and variance of 1/u over nodes uniform in ln u; zeros where all is beyond them."""
    nodes = space.nodes
    us, u_vars, share, _ = space.scratch.columns
    half = 0.5 * (nodes[1] / nodes[0] - 1.0)  # of the way between two: a narrower density would fall through
    total = first = second = 0.0
    for i in range(len(nodes)):
        density = 0.0
        for d in range(count):
            variance = u_vars[d] / power + (half * us[d]) * (half * us[d])
            off = nodes[i] - us[d]
            distance = off * off / variance
            if share[d] > 0.0 and distance < 40.0:
                density += share[d] * math.exp(-0.5 * distance) / math.sqrt(variance)
        density *= nodes[i]
        total += density
        first += density / nodes[i]
        second += density / (nodes[i] * nodes[i])
    if total <= 0.0:
        return 0.0, 0.0
    mean = first / total
    return mean, max(second / total - mean * mean, 0.0)


@jit.kernel
def report_mass(
    count: int, best: int, before: tuple[float, float, float], c: Constants, v: Vehicle, space: Space
) -> tuple[float, float, float]:
    """Return the mass of the densest load, the variance about it, and the windows until the next sum.

    Where they are narrow by the moments of u: M = (1 + V) / u, Var(M) = V M^2; else summed over the nodes.
    before: these three of the window before.
    """
    us, u_vars, share, _ = space.scratch.columns
    loads = space.scratch.loads
    best *= 3
    u1 = u2 = 0.0
    for d in range(count):
        u1 += share[d] * us[d]
        u2 += share[d] * (us[d] * us[d] + u_vars[d] / c.likelihood_power)
    centre = loads[best + 1]
    scale = max(centre, 0.1 * v.least_u)
    spread = max(u2 - 2.0 * centre * u1 + centre * centre, 0.0) / (scale * scale)
    own = loads[best + 2] / (c.likelihood_power * scale * scale)
    inside = v.least_u < centre < v.most_u
    narrow = own < c.widest_normal * c.widest_normal and inside
    if spread < c.widest_normal * c.widest_normal and inside:
        mass = (1.0 + own) / centre
        return mass, spread * mass * mass, 0.0
    if before[2] > 1.0:
        return before[0], before[1], before[2] - 1.0
    mass, var = sum_over_nodes(count, c.likelihood_power, space)
    if mass <= 0.0:
        mass = 1.0 / min(max(centre, v.least_u), v.most_u)
        var = spread * mass * mass
    if not inside:  # about this mass, of a posterior without bounds
        var = max(var, spread * mass * mass) + (mass - 1.0 / scale) * (mass - 1.0 / scale)
    if narrow:
        mean, mass = mass, (1.0 + own) / centre
        var += (mass - mean) * (mass - mean)
    return mass, var, _EVERY


def _grades(mix: Mixture, count: int, ahead_m: float, power: float, v: Vehicle, t: Scratch) -> None:
    x, P, variance = mix.x[:count], mix.P[:count], mix.P[:count, m.U, m.U]
    per_u = (P[:, m.GRADE, m.U] - P[:, m.ROLLING, m.U]) / variance
    u = np.minimum(np.maximum(x[:, m.U], v.least_u), v.most_u)
    mean = x[:, m.GRADE] - x[:, m.ROLLING] + ahead_m * x[:, m.CURVATURE] + per_u * (u - x[:, m.U])
    var = P[:, m.GRADE, m.GRADE] - 2.0 * P[:, m.GRADE, m.ROLLING] + P[:, m.ROLLING, m.ROLLING]
    var = var + 2.0 * ahead_m * (P[:, m.GRADE, m.CURVATURE] - P[:, m.ROLLING, m.CURVATURE])
    var = var + ahead_m * ahead_m * P[:, m.CURVATURE, m.CURVATURE]
    var = var + per_u * per_u * variance * (1.0 / power - 1.0)
    t.columns[0][:count], t.columns[1][:count] = mean.tolist(), var.tolist()
    t.columns[3][:count] = x[:, m.CURVATURE].tolist()


@jit.kernel_beside(_grades)
def set_grades(mix: Mixture, count: int, ahead_m: float, power: float, v: Vehicle, t: Scratch) -> None:
    """Set t.columns[0], [1] and [3] to mean and variance of the grade ahead and its change per metre.

    theta - rho + d kappa given u, at the u within bounds, d metres ahead of the filtered signals.
    """
    for d in range(count):
        x, P = mix.x, mix.P
        per_u = (P[d, m.GRADE, m.U] - P[d, m.ROLLING, m.U]) / P[d, m.U, m.U]
        u = min(max(x[d, m.U], v.least_u), v.most_u)
        mean = x[d, m.GRADE] - x[d, m.ROLLING] + ahead_m * x[d, m.CURVATURE] + per_u * (u - x[d, m.U])
        var = P[d, m.GRADE, m.GRADE] - 2.0 * P[d, m.GRADE, m.ROLLING] + P[d, m.ROLLING, m.ROLLING]
        var = var + 2.0 * ahead_m * (P[d, m.GRADE, m.CURVATURE] - P[d, m.ROLLING, m.CURVATURE])
        var = var + ahead_m * ahead_m * P[d, m.CURVATURE, m.CURVATURE]
        var = var + per_u * per_u * P[d, m.U, m.U] * (1.0 / power - 1.0)
        t.columns[0][d], t.columns[1][d], t.columns[3][d] = mean, var, x[d, m.CURVATURE]


@jit.kernel
def report_grade(
    mix: Mixture, count: int, mass: tuple[float, float, float], ahead_m: float, answer_1pm: float,
    c: Constants, v: Vehicle, t: Scratch,
) -> Report:  # fmt: skip
    """Return the grade where the vehicle is by now, and the mass.

    answer_1pm: variance that an answered grade gains per metre, by the torque of the last window.
    """
    set_grades(mix, count, ahead_m, c.likelihood_power, v, t)
    means, variances, share, bends = t.columns
    mean = square = slope = wander = 0.0
    for d in range(count):
        if share[d] > 0.0:
            mode = int(mix.mode[d])
            gains = c.rough_wander_1pm if m.IS_ROUGH[mode] > 0.0 else c.smooth_wander_1pm
            gains += answer_1pm * m.ANSWERS[mode]
            mean += share[d] * means[d]
            square += share[d] * (variances[d] + gains * ahead_m + means[d] * means[d])
            slope += share[d] * bends[d]
            wander += share[d] * gains
    return Report(mass[0], mass[1], mean, max(square - mean * mean, 1e-10), slope, wander, mass[2])


@jit.kernel
def unknown_load_var(mass: float, unknown_s: float, braked: bool, c: Constants, v: Vehicle) -> float:
    """Return what a load that may have changed adds to the variance of the mass.

    It is P(changed) E[(M' - M)^2], M' log-uniform: after a stop, or while a surprise waits for its
    explanation (braked, see `load.brakes_unseen`).
    """
    probability = changed_probability(unknown_s, c.load_stop_s)
    if braked:
        probability = max(probability, 2.0 * c.left_out_share)
    elif unknown_s <= c.shortest_stop_s:
        return 0.0
    least, most = 1.0 / v.most_u, 1.0 / v.least_u
    width = math.log(most / least)
    mean, square = (most - least) / width, 0.5 * (most * most - least * least) / width
    spread: float = square - 2.0 * mass * mean + mass * mass
    var: float = probability * spread
    return var
