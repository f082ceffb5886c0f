"""The posterior that is reported."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.next.constants import Constants, Vehicle
from canest.estimators.next.hypotheses import LOADS, load_moments
from canest.estimators.next.load import Standing, changed_probability
from canest.estimators.next.model import CURVATURE, GRADE, ROLLING, ROUGHS, U, Bank

LEFT_OUT = 0.04
_WIDE = 0.1
LIKELY = 0.5
_EVERY = 5.0
_LEAD_M, LEAD_1PM = 40.0, 1.5e-4
_STEEPEST_1PM = 4e-4


class Report(NamedTuple):
    """What is reported after a window, and carried to the next."""

    mass_kg: float
    mass_var: float
    grade: float
    grade_var: float
    slope_1pm: float
    windows: float
    known: float


@jit.kernel
def counted(bank: Bank, count: int, share: Any) -> None:
    """share[d]: weight of density d, zero for loads that are left out; normalised."""
    small = 0.0
    for l in range(LOADS):
        w, _, _ = load_moments(bank, count, l)
        if w < LEFT_OUT:
            small += w
    total = 0.0
    for d in range(count):
        share[d] = bank.weight[d]
    if small < LEFT_OUT:
        for l in range(LOADS):
            w, _, _ = load_moments(bank, count, l)
            if w < LEFT_OUT:
                for d in range(count):
                    if bank.load[d] == l:
                        share[d] = 0.0
    for d in range(count):
        total += share[d]
    for d in range(count):
        share[d] /= total


@jit.kernel
def summed_mixture(bank: Bank, count: int, share: Any, nodes: Any, power: float) -> tuple[float, float]:
    """Return mean and variance of 1/u over the nodes (uniform in log u); zeros where all is beyond."""
    total = first = second = 0.0
    for k in range(len(nodes)):
        node = nodes[k]
        density = 0.0
        for d in range(count):
            if share[d] > 0.0:
                variance = bank.P[d, U, U] / power
                off = node - bank.x[d, U]
                distance = off * off / variance
                if distance < 40.0:
                    density += share[d] * math.exp(-0.5 * distance) / math.sqrt(variance)
        density *= node
        total += density
        first += density / node
        second += density / (node * node)
    if total <= 0.0:
        return 0.0, 0.0
    mean = first / total
    return mean, max(second / total - mean * mean, 0.0)


@jit.kernel
def best_load(bank: Bank, count: int) -> int:
    """Return the load with the largest weight."""
    best, most = 0, 0.0
    for l in range(LOADS):
        w, _, _ = load_moments(bank, count, l)
        if w > most:
            best, most = l, w
    return best


@jit.kernel
def report(
    bank: Bank, count: int, share: Any, before: Report, nodes: Any, lead_m: float, is_open: bool, begins: bool, c: Constants, v: Vehicle
) -> Report:
    """Return what is reported after a window; the mass is held while a gate is closed."""
    power = c.power
    x, P = bank.x, bank.P
    counted(bank, count, share)
    u1 = u2 = g1 = g2 = b1 = r1 = 0.0
    for d in range(count):
        if share[d] > 0.0:
            w, u, u_var = share[d], x[d, U], P[d, U, U]
            u1 += w * u
            u2 += w * (u * u + u_var / power)
            slope = (P[d, GRADE, U] - P[d, ROLLING, U]) / u_var
            bend = x[d, CURVATURE]
            grade = x[d, GRADE] - x[d, ROLLING] + lead_m * bend + slope * (min(max(u, v.least_u), v.most_u) - u)
            var = P[d, GRADE, GRADE] - 2.0 * P[d, GRADE, ROLLING] + P[d, ROLLING, ROLLING]
            var += slope * slope * u_var * (1.0 / power - 1.0)
            var += 2.0 * lead_m * (P[d, GRADE, CURVATURE] - P[d, ROLLING, CURVATURE]) + lead_m * lead_m * P[d, CURVATURE, CURVATURE]
            rough = c.rough_1pm if ROUGHS[int(bank.mode[d])] > 0.0 else c.smooth_1pm
            var += rough * lead_m
            b1 += w * bend
            r1 += w * rough
            g1 += w * grade
            g2 += w * (var + grade * grade)
    likely, centre, own = load_moments(bank, count, best_load(bank, count))
    if likely < LIKELY:
        centre = u1
    scale = max(centre, 0.1 * v.least_u)
    spread = max(u2 - 2.0 * centre * u1 + centre * centre, 0.0) / (scale * scale)
    windows = before.windows - 1.0
    if not is_open:
        mass, mass_var, windows = before.mass_kg, before.mass_var, before.windows
    elif spread < _WIDE * _WIDE and v.least_u < centre < v.most_u:
        mass = (1.0 + (spread if likely < LIKELY else own / (power * centre * centre))) / centre
        mass_var, windows = spread * mass * mass, 0.0
    elif windows <= 0.0 or begins:
        mass, mass_var = summed_mixture(bank, count, share, nodes, power)
        windows = _EVERY
        if mass <= 0.0:
            mass = 1.0 / min(max(u1, v.least_u), v.most_u)
            mass_var = spread * mass * mass
        if u1 <= v.least_u or u1 >= v.most_u:
            mass_var = max(mass_var, spread * mass * mass)
        own /= power * centre * centre
        if likely >= LIKELY and own < _WIDE * _WIDE and v.least_u < centre < v.most_u:
            mean = mass
            mass = (1.0 + own) / centre
            mass_var += (mass - mean) * (mass - mean)
    else:
        mass, mass_var = before.mass_kg, before.mass_var
    return Report(mass, mass_var, g1, max(g2 - g1 * g1, 1e-10), b1, windows, r1)


@jit.kernel
def unknown_load_var(mass: float, standing: Standing, c: Constants, v: Vehicle) -> float:
    """Return what a stop adds to the variance of the mass: P(changed) E[(M' - M)^2], M' log-uniform."""
    if standing.unknown_s <= c.least_stop_s:
        return 0.0
    probability = changed_probability(standing.unknown_s, c.stop_s)
    if probability < LEFT_OUT:
        return 0.0
    least, most = 1.0 / v.most_u, 1.0 / v.least_u
    width = math.log(most / least)
    mean, square = (most - least) / width, 0.5 * (most * most - least * least) / width
    spread: float = square - 2.0 * mass * mean + mass * mass
    var: float = probability * spread
    return var
