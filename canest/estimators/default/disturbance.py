"""The disturbance as a process: the wind, or the torque of accessories, may be another at once.

    P(changed in t) = 1 - exp(-t / T_j),  Var(change) = (k_j std)^2

A forest ends, a truck ahead turns off, an air conditioning switches. Without this hypothesis a load is the
only other force that changes so fast. Only an accelerometer tells it from a road: without one it is none.
"""

from __future__ import annotations

from canest.core import jit
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.hypotheses import copy
from canest.estimators.default.model import LOADS, MOST, OTHER_DISTURBANCE, Mixture


@jit.kernel
def open_disturbance(mix: Mixture, count: int, changed: float, u: float, c: Constants, v: Vehicle) -> int:
    """Give a share of every density to a copy with another disturbance; returns the densities.

    Not where it would be too improbable to live. changed: probability that it has changed.
    u: mean inverse mass.
    """
    wind, offset, made = c.jump_stds * c.wind_std_mps * u, c.jump_stds * v.offset_Nm * u, count
    for d in range(count):
        if changed * mix.weight[d] > c.least_weight and made < MOST:
            copy(mix, d, mix, made)
            mix.P[made, m.WIND, m.WIND] += wind * wind
            mix.P[made, m.OFFSET, m.OFFSET] += offset * offset
            mix.weight[made], mix.load[made] = changed * mix.weight[d], mix.load[d] + OTHER_DISTURBANCE
            mix.weight[d] *= 1.0 - changed
            made += 1
    return made


@jit.kernel
def close_disturbance(mix: Mixture, count: int) -> None:
    """Let the densities with another disturbance be modes like all of their load."""
    for d in range(count):
        mix.load[d] %= LOADS
