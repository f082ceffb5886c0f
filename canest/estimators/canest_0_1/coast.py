"""Coasting with the driveline open: how steep the road is, whatever the vehicle weighs.

    a (1 + u J) = u F - g mu - g theta - c omega     F air, J the wheels alone

Gates are closed then, so the filter takes it when they open, at the place where it was; the grade that is
given out knows it at once.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.canest_0_1.filter import OUTLIER, correct
from canest.estimators.canest_0_1.roads import likelihood
from canest.estimators.canest_0_1.states import (
    COAST_BACK_M,
    COAST_KG,
    COAST_MPS2,
    COAST_N,
    COAST_VAR,
    CURVATURE,
    GRADE,
    WIND,
    Q,
    U,
)

Container = Any  #: list interpreted, array compiled

#: what an open driveline drags, and the vehicle rocks on its tyres, m/s2
DRAGS_MPS2 = 0.03
#: further back the road is another one, m; and windows lag so little behind
FAR_M, NEAR_M = 100.0, -20.0
#: a coasting that tells the slope to a percent is a witness of the road, m/s2
SHOWN_MPS2 = 0.1


@jit.kernel
def note(memory: Container, accel: float, var: float, force: float, wheels: float, back_m: float) -> bool:
    """Remember a coasting (NaN: there is none) until gates open; return whether there is a new one.

    back_m: travelled since its middle. What is far, or was before the clock was set, is no coasting here.
    """
    known = not math.isnan(accel) and NEAR_M <= back_m < FAR_M
    if known:
        memory[COAST_MPS2], memory[COAST_N], memory[COAST_KG] = accel, force, wheels
        memory[COAST_VAR] = var + DRAGS_MPS2 * DRAGS_MPS2
        memory[COAST_BACK_M] = back_m
    return known


@jit.kernel
def coasted_here(memory: Container) -> bool:
    """Return whether a remembered coasting tells of the road here."""
    return bool(memory[COAST_VAR] > 0.0 and memory[COAST_BACK_M] < FAR_M)


@jit.kernel
def shows(memory: Container) -> bool:
    """Return whether a remembered coasting tells the slope to a percent."""
    return bool(memory[COAST_VAR] < SHOWN_MPS2 * SHOWN_MPS2)


@jit.kernel
def doubt_road(x: Container, P: Container, memory: Container, roll: float, drag: float) -> None:
    """Doubt the grade by what a remembered coasting denies of it; arguments as in `roll_back`.

    It is no outlier: where nothing was heard of the road, under the brake say, the road has become another.
    """
    a = memory[COAST_MPS2]
    bare = -a - roll - (memory[COAST_KG] * a - memory[COAST_N]) * x[U] - drag * x[WIND]
    e = bare / GRAVITY_MPS2 - x[GRADE] + memory[COAST_BACK_M] * x[CURVATURE]
    if e * e > OUTLIER * (P[GRADE][GRADE] + memory[COAST_VAR] / (GRAVITY_MPS2 * GRAVITY_MPS2)):
        P[GRADE][GRADE] += e * e


@jit.kernel
def roll_back(
    x: Container, P: Container, w: Container, memory: Container, roll: float, drag: float, uneven: float
) -> float:
    """Take a remembered coasting into a filter, where it was; return its log-likelihood.

    roll: g mu. drag: aerodynamic force per m/s of wind. uneven: variance that the grade gains per metre.
    """
    a, back_m = memory[COAST_MPS2], memory[COAST_BACK_M]
    r = memory[COAST_VAR] + GRAVITY_MPS2 * GRAVITY_MPS2 * uneven * abs(back_m)
    lever = memory[COAST_KG] * a - memory[COAST_N]
    e, s = correct(
        x, P, w, 0, -a - roll, r,
        GRADE, GRAVITY_MPS2, CURVATURE, -GRAVITY_MPS2 * back_m, U, lever, WIND, drag, Q, 0.0,
    )  # fmt: skip
    told: float = likelihood(e, s)
    return told


@jit.kernel
def rolling_grade(
    memory: Container, u: float, u_var: float, wind: float, roll: float, drag: float, kappa: float,
    wind_var: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the grade that a remembered coasting tells of here, and its variance; see `roll_back`."""
    a = memory[COAST_MPS2]
    lever = memory[COAST_N] - memory[COAST_KG] * a
    grade = (u * lever - a - roll - drag * wind) / GRAVITY_MPS2 + kappa * memory[COAST_BACK_M]
    var = memory[COAST_VAR] + lever * lever * u_var + drag * drag * wind_var
    return grade, var / (GRAVITY_MPS2 * GRAVITY_MPS2)
