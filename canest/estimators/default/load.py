"""The load as a process: it changes in stops, sometimes in motion, and sometimes it drifts.

P(changed | stood t) = 1 - exp(-t / stop_s): where the vehicle moves off, that share of the probability goes
to an unknown load, log-uniform between the bounds of the mass. In motion the same happens with a small
probability every few seconds (a challenge); most challengers are pruned within a second.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.estimators.default.constants import Constants, Load, Vehicle
from canest.estimators.default.hypotheses import (
    Filters,
    Room,
    copy_density,
    merge_loads,
    moments_of_u,
    most_probable,
)
from canest.estimators.default.model import (
    BIAS,
    CURVATURE,
    CURVED_ANSWERED,
    CURVED_FREE,
    DELAY,
    GRADE,
    LAG,
    MODES,
    PITCH,
    RATE,
    RESPONSE,
    SLIP,
    STRAIGHT_ANSWERED,
    WIND,
    WINDUP,
    Q,
    U,
    Window,
)
from canest.estimators.default.predict import reset
from canest.estimators.default.windows import WINDOW_S

_TIMES_U = (WIND, DELAY, SLIP, WINDUP, LAG)
_LOOSENED = (DELAY, SLIP, WINDUP, BIAS, PITCH, LAG)
#: a momentum that is not known at all, (m/s)2
_UNKNOWN_Q = 100.0


class Standing(NamedTuple):
    """How long the load has not been seen."""

    unknown_s: float = 0.0  #: standing and missing time since the load was last taken up


@jit.kernel
def stand(standing: Standing, w: Window) -> Standing:
    """Return the standing time after a window; while nothing is received the vehicle may have stood."""
    still_s = WINDOW_S if w.stopped > 0.0 else 0.0
    return Standing(standing.unknown_s + w.gap_s + still_s)


@jit.kernel
def changed_probability(seconds: float, load: Load) -> float:
    """Return the probability that a load has changed in a stop of so many seconds."""
    return 1.0 - math.exp(-seconds / load.stop_s)


@jit.kernel
def new_density(
    filters: Filters, base: int, like: int, k: int, m: int, u: float, u_std: float, known_u: float,
    loosened: float, prior_var: Any, moving: bool, rotating_kg: float,
) -> None:  # fmt: skip
    """Make mode m of load k like the mode `like` of the base, for another inverse mass u."""
    x, P = filters.x[k][m], filters.P[k][m]
    copy_density(filters.x[base][like], filters.P[base][like], x, P)
    if like != m:
        reset(x, P, RESPONSE, 0.0, 0.0)
    reset(x, P, U, u, u_std * u_std)
    reset(x, P, RATE, 0.0, 0.0)
    ratio = u / known_u
    n = len(x)
    for state in _TIMES_U:
        if state < n:
            x[state] *= ratio
            own = P[state]
            for j in range(n):
                own[j] *= ratio
                P[j][state] *= ratio
    for state in _LOOSENED:
        if state < n:
            unit = 1.0 if state in (BIAS, PITCH) else u * u
            P[state][state] += loosened * prior_var[state] * unit
    if moving:  # the base may have taken the change of the load for one of the road
        # the speed is known, so q = (1 + u J) v is as unknown as u
        lever = rotating_kg * x[Q] / (1.0 + known_u * rotating_kg)
        x[Q] += (u - known_u) * lever
        P[Q][U] = P[U][Q] = lever * u_std * u_std
        P[Q][Q] += lever * lever * u_std * u_std
        P[GRADE][GRADE] += prior_var[GRADE]
        if m in (CURVED_FREE, CURVED_ANSWERED):
            P[CURVATURE][CURVATURE] += prior_var[CURVATURE]
    else:
        reset(x, P, Q, x[Q], _UNKNOWN_Q)


@jit.kernel
def open_load(
    filters: Filters, probability: float, loosened: float, centres: Any, prior_var: Any, moving: bool,
    rotating_kg: float, c: Constants, vehicle: Vehicle, room: Room,
) -> None:  # fmt: skip
    """Give a share of the probability to an unknown load: `centres` are the inverse masses of its densities.

    Where there is no room the loads that there are become one; in motion nothing is done then.
    """
    weight = filters.weight
    base = most_probable(weight)
    free = 0
    for k in range(len(weight)):
        if weight[k] <= 0.0:
            free += 1
    if free < len(centres):
        if moving:
            return
        for k in range(len(weight)):
            if k != base and weight[k] > 0.0:
                merge_loads(filters, k, base, room.d)
    known_u, _ = moments_of_u(filters, base)
    known_u = min(max(known_u, vehicle.least_u), vehicle.most_u)
    spacing = math.log(vehicle.most_u / vehicle.least_u) / len(centres)
    for k in range(len(weight)):
        weight[k] *= 1.0 - probability
    j = 0
    for k in range(len(weight)):
        if weight[k] <= 0.0 and j < len(centres):
            u = centres[j]
            std = c.load.spread * u * spacing
            for m in range(MODES):
                mode, like = filters.mode[base][m], m
                if moving:  # what the base takes for an answer of the road may be the new load
                    answered = m + STRAIGHT_ANSWERED
                    if m >= STRAIGHT_ANSWERED:
                        mode = 0.0
                    else:
                        if mode <= 0.0:
                            like = answered
                        mode += filters.mode[base][answered]
                filters.mode[k][m] = mode
                if mode > 0.0:
                    new_density(
                        filters, base, like, k, m, u, std, known_u, loosened, prior_var, moving, rotating_kg
                    )
            weight[k], filters.pending[k], filters.drifting[k] = probability / len(centres), 0.0, 0.0
            j += 1


@jit.kernel
def question_drift(filters: Filters, load: Load) -> None:
    """Give a share of the probability to the same load drifting, or to one whose drift has ended."""
    weight, drifting = filters.weight, filters.drifting
    base = most_probable(weight)
    free = -1
    for k in range(len(weight)):
        if weight[k] <= 0.0:
            free = k
        elif drifting[k] != drifting[base]:
            return
    if free < 0:
        return
    begins = drifting[base] == 0.0
    probability = load.drift_probability
    for m in range(MODES):
        filters.mode[free][m] = filters.mode[base][m]
        if filters.mode[free][m] > 0.0:
            x, P = filters.x[free][m], filters.P[free][m]
            copy_density(filters.x[base][m], filters.P[base][m], x, P)
            if begins:
                rate = load.drift_1ps * x[U]
                rate_var, since = rate * rate, load.drifted_s
                P[RATE][RATE] = rate_var
                P[RATE][U] = P[U][RATE] = since * rate_var
                P[U][U] += since * since * rate_var
            else:
                reset(x, P, RATE, 0.0, 0.0)
    drifting[free] = 1.0 - drifting[base]
    filters.pending[free] = filters.pending[base]
    weight[free] = probability * weight[base]
    weight[base] *= 1.0 - probability
