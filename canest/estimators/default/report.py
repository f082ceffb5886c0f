"""The posterior that is reported: moments of the mixture within the bounds (docs/theory.md, section 10)."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.hypotheses import p_changed
from canest.estimators.default.model import LOADS, Mixture, Scratch, Space
from canest.estimators.default.predict import column

#: std of ln u below which 1/u is nearly linear in u, and normal
_WIDEST = 0.1
#: windows between two sums over the nodes
_EVERY = 5.0
#: places among the states from the grade to the rolling resistance
_U, _BEND, _ROLL = m.U - m.GRADE, m.CURVATURE - m.GRADE, m.ROLLING - m.GRADE


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
    loads, share, small, rest = t.loads, t.columns[2], 0.0, 0.0
    for k in range(0, 3 * LOADS, 3):
        if loads[k] < left_out:
            small += loads[k]
        else:
            rest += loads[k]
    least = left_out if small < left_out else 0.0
    total = rest if least > 0.0 else rest + small
    for d in range(count):
        share[d] = mix.weight[d] / total if loads[3 * (mix.load[d] % LOADS)] >= least else 0.0


@jit.kernel
def sum_over_nodes(count: int, power: float, space: Space) -> tuple[float, float]:
    """Return mean and variance of 1/u over nodes uniform in ln u; zeros where all is beyond them."""
    nodes = space.nodes
    us, u_vars, share = space.scratch.columns
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

    Where they are narrow by the moments of u, M = (1 + V_own) / u_l and Var(M) = V_all M^2; else by nodes.
    before: these three of the window before.
    """
    us, u_vars, share = space.scratch.columns
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
    narrow = own < _WIDEST * _WIDEST and inside
    if spread < _WIDEST * _WIDEST and inside:
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


@jit.kernel
def report_grade(
    mix: Mixture, count: int, mass: tuple[float, ...], ahead_m: float, c: Constants, v: Vehicle, t: Scratch
) -> Report:
    """Return the grade where the vehicle is by now, and the mass."""
    share, wider = t.columns[2], 1.0 / c.likelihood_power - 1.0
    means = column(mix.x[:, m.GRADE : m.ROLLING + 1], count)
    covariances = column(mix.P[:, m.GRADE : m.ROLLING + 1, m.GRADE : m.ROLLING + 1], count)
    mean = square = slope = wander = 0.0
    for d in range(count):
        if share[d] > 0.0:
            mode = mix.mode[d]
            gains = c.rough_wander_1pm if m.IS_ROUGH[mode] > 0.0 else c.smooth_wander_1pm
            x, P = means[d], covariances[d]
            grades, rollings, u, bend = P[0], P[_ROLL], x[_U], x[_BEND]
            per_u = (grades[_U] - rollings[_U]) / P[_U][_U]
            grade = x[0] - x[_ROLL] + ahead_m * bend + per_u * (min(max(u, v.least_u), v.most_u) - u)
            var = grades[0] - 2.0 * grades[_ROLL] + rollings[_ROLL]
            var += 2.0 * ahead_m * (grades[_BEND] - rollings[_BEND])
            var += ahead_m * ahead_m * P[_BEND][_BEND] + per_u * per_u * P[_U][_U] * wider
            mean += share[d] * grade
            square += share[d] * (var + gains * ahead_m + grade * grade)
            slope += share[d] * bend
            wander += share[d] * gains
    return Report(mass[0], mass[1], mean, max(square - mean * mean, 1e-10), slope, wander, mass[2])


@jit.kernel
def unknown_load_var(mass: float, unknown_s: float, braked: bool, c: Constants, v: Vehicle) -> float:
    """Return what a load that may have changed adds to Var(M): P(changed) E[(M_new - M)^2].

    M_new is log-uniform. This holds after a stop, or while a surprise waits for its explanation (braked, see
    `load.brakes_unseen`).
    """
    probability = p_changed(unknown_s, c.load_stop_s)
    if braked:
        probability = max(probability, 2.0 * c.left_out_share)
    elif unknown_s < c.shortest_stop_s:
        return 0.0
    least, most = 1.0 / v.most_u, 1.0 / v.least_u
    width = math.log(most / least)
    mean, square = (most - least) / width, 0.5 * (most * most - least * least) / width
    return probability * (square - 2.0 * mass * mean + mass * mass)
