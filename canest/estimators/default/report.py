"""The posterior that is reported: moments of the mixture, within the bounds of the vehicle.

Two standard deviations are to hold 95 % of the probability: loads that together hold less than `LEFT_OUT`
are no part of the standard deviation. The likelihood counts by a power for the mass, so the variance of u
is divided by it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.hypotheses import Filters
from canest.estimators.default.load import Standing, changed_probability
from canest.estimators.default.model import GRADE, MODES, ROLLING, U

#: probability of loads that are left out of the standard deviation
LEFT_OUT = 0.04
#: a relative spread beyond this is not described by the moments of u: the mixture is summed over masses
_WIDE = 0.1
#: windows between two such sums
_EVERY = 5.0
#: distance over which the reported grade's own slope is followed, m, and its std per metre of lead
_LEAD_M, LEAD_1PM = 40.0, 1.5e-4
#: and the most it is, 1/m
_STEEPEST_1PM = 4e-4


class Report(NamedTuple):
    """What is reported after a window, and carried to the next."""

    mass_kg: float
    mass_var: float
    grade: float
    grade_var: float
    slope_1pm: float  #: change of the reported grade per metre
    windows: float  #: until the mixture is summed again
    known: float  #: 1 once there is a grade


@jit.kernel
def left_out(weight: Any) -> float:
    """Return the weight below which loads are left out."""
    small = 0.0
    for k in range(len(weight)):
        if weight[k] < LEFT_OUT:
            small += weight[k]
    return LEFT_OUT if small < LEFT_OUT else 0.0


@jit.kernel
def summed_mixture(filters: Filters, nodes: Any, least: float, power: float) -> tuple[float, float]:
    """Return mean and variance of 1/u over the nodes (uniform in log u); zeros where all is beyond."""
    total = first = second = 0.0
    for node in nodes:
        density = 0.0
        for k in range(len(filters.weight)):
            if filters.weight[k] > least:
                mode = filters.mode[k]
                for m in range(MODES):
                    if mode[m] > 0.0:
                        variance = filters.P[k][m][U][U] / power
                        off = node - filters.x[k][m][U]
                        distance = off * off / variance
                        if distance < 40.0:
                            density += (
                                filters.weight[k] * mode[m] * math.exp(-0.5 * distance) / math.sqrt(variance)
                            )
        density *= node
        total += density
        first += density / node
        second += density / (node * node)
    if total <= 0.0:
        return 0.0, 0.0
    mean = first / total
    return mean, max(second / total - mean * mean, 0.0)


@jit.kernel
def report(
    filters: Filters, before: Report, nodes: Any, metres: float, is_open: bool, begins: bool, c: Constants,
    vehicle: Vehicle,
) -> Report:  # fmt: skip
    """Return what is reported after a window; the mass is held while a gate is closed."""
    power, least = c.noise.power, left_out(filters.weight)
    total = u1 = u2 = g1 = g2 = 0.0
    for k in range(len(filters.weight)):
        if filters.weight[k] > least:
            mode = filters.mode[k]
            for m in range(MODES):
                if mode[m] > 0.0:
                    share, x, P = filters.weight[k] * mode[m], filters.x[k][m], filters.P[k][m]
                    u, u_var = x[U], P[U][U]
                    total += share
                    u1 += share * u
                    u2 += share * (u * u + u_var / power)
                    # grade given u, at the u within bounds
                    slope = (P[GRADE][U] - P[ROLLING][U]) / u_var
                    grade = x[GRADE] - x[ROLLING]
                    grade += slope * (min(max(u, vehicle.least_u), vehicle.most_u) - u)
                    var = P[GRADE][GRADE] - 2.0 * P[GRADE][ROLLING] + P[ROLLING][ROLLING]
                    var += slope * slope * u_var * (1.0 / power - 1.0)
                    g1 += share * grade
                    g2 += share * (var + grade * grade)
    u1 /= total
    u2 /= total
    g1 /= total
    scale = max(u1, 0.1 * vehicle.least_u)
    spread = max(u2 - u1 * u1, 0.0) / (scale * scale)
    windows = before.windows - 1.0
    if not is_open:
        mass, var, windows = before.mass_kg, before.mass_var, before.windows
    elif spread < _WIDE * _WIDE and vehicle.least_u < u1 < vehicle.most_u:
        mass = (1.0 + spread) / u1
        var, windows = spread * mass * mass, 0.0
    elif windows <= 0.0 or begins:
        mass, var = summed_mixture(filters, nodes, least, power)
        windows = _EVERY
        if mass <= 0.0:
            mass = 1.0 / min(max(u1, vehicle.least_u), vehicle.most_u)
            var = spread * mass * mass
        if u1 <= vehicle.least_u or u1 >= vehicle.most_u:  # beyond the bounds nothing is narrow
            var = max(var, spread * mass * mass)
    else:
        mass, var = before.mass_kg, before.mass_var
    bend = before.slope_1pm
    if metres > 0.0 and before.known > 0.0:
        bend += min(metres / _LEAD_M, 1.0) * ((g1 - before.grade) / metres - bend)
        bend = min(max(bend, -_STEEPEST_1PM), _STEEPEST_1PM)
    return Report(mass, var, g1, max(g2 / total - g1 * g1, 1e-10), bend, windows, 1.0)


@jit.kernel
def unknown_load_var(mass: float, standing: Standing, c: Constants, vehicle: Vehicle) -> float:
    """Return what a stop adds to the variance of the mass: P(changed) E[(M' - M)^2], M' log-uniform."""
    if standing.unknown_s <= c.load.least_stop_s:
        return 0.0
    probability = changed_probability(standing.unknown_s, c.load)
    if probability < LEFT_OUT:
        return 0.0
    least, most = 1.0 / vehicle.most_u, 1.0 / vehicle.least_u
    width = math.log(most / least)
    mean, square = (most - least) / width, 0.5 * (most * most - least * least) / width
    spread: float = square - 2.0 * mass * mean + mass * mass
    var: float = probability * spread
    return var
