"""The wind as a process: beside what fades over a distance it may be another at once.

    P(changed in t) = 1 - exp(-t / T_w),  Var(w' - w) = s_j^2

A forest ends, a truck ahead turns off. Without this hypothesis a load is the only other force that changes so
fast. Only an accelerometer tells such a change from a road.
"""

from __future__ import annotations

from canest.core import jit
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants
from canest.estimators.default.hypotheses import copy
from canest.estimators.default.model import LOADS, MOST, OTHER_WIND, Mixture


@jit.kernel
def open_wind(mix: Mixture, count: int, changed: float, u: float, c: Constants) -> int:
    """Give a share of every density to a copy with another wind; returns the densities.

    Not where it would be too improbable to live. changed: probability that the wind has changed.
    u: mean inverse mass.
    """
    jump, made = c.wind_jump_mps * u, count
    for d in range(count):
        if changed * mix.weight[d] > c.least_weight and made < MOST:
            copy(mix, d, mix, made)
            mix.P[made, m.WIND, m.WIND] += jump * jump
            mix.weight[made], mix.load[made] = changed * mix.weight[d], mix.load[d] + OTHER_WIND
            mix.weight[d] *= 1.0 - changed
            made += 1
    return made


@jit.kernel
def close_wind(mix: Mixture, count: int) -> None:
    """Let the densities with another wind be modes like all of their load."""
    for d in range(count):
        mix.load[d] %= LOADS
