"""Two filters, two kinds of road: straight, or on a crest or sag; and how they share what they know.

Roads are built of straight grades joined by vertical curves of constant curvature. A filter told that the
grade wanders all the time would be unsure on the straights and surprised by the curves; two filters, one for
each, weighed by how well they foretold what was measured (interacting multiple models, Blom and Bar-Shalom
1988), are neither. Who goes from one to the other draws its curvature anew.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.estimators.canest_0_1.filter import OUTLIER, fade
from canest.estimators.canest_0_1.states import (
    BENT_1PM,
    BENT_M,
    CURVATURE,
    CURVED,
    GRADE,
    HELD_U,
    OUT_CURVATURE,
    OUT_GRADE,
    OUT_GRADE_VAR,
    OUT_U_VAR,
    PRESSED,
    STRAIGHT,
    STRETCH_M,
    WIND,
    U,
)

Container = Any

#: how far straights and curves go on the average, m
STRAIGHT_M, CURVED_M = 500.0, 150.0
#: distance over which the curvature within a curve changes, m
CURVE_M = 300.0
#: metres in curves that the first guess of their curvature counts for, and that are remembered
GUESS_M, ROADS_M = 400.0, 5000.0
#: distance over which the mean wind along the road changes, m
WIND_M = 5000.0
#: the filters are mixed after this distance: on a straight the filter of curves learns that there is none,
#: and left to itself is as late into the next as the other, m
MIX_M = 20.0
#: no kind of road is ever out of the question
_LEAST = 1e-9


@jit.kernel
def usual_curvature(x: Container, P: Container, memory: Container, curved: float, guess_var: float) -> float:
    """Return the mean square curvature of this country's curves, after the stretch just driven.

    x, P: of the filter of curves, whose probability is `curved`. A motorway's crests are ten times wider than
    those of a country road (expectation maximisation, Dempster, Laird and Rubin 1977).
    """
    stays = math.exp(-curved * memory[STRETCH_M] / ROADS_M)
    new_m = (1.0 - stays) * ROADS_M
    memory[BENT_M] = stays * memory[BENT_M] + new_m
    square = x[CURVATURE] * x[CURVATURE] + P[CURVATURE][CURVATURE]
    memory[BENT_1PM] = stays * memory[BENT_1PM] + new_m * square
    mean: float = (GUESS_M * guess_var + memory[BENT_1PM]) / (GUESS_M + memory[BENT_M])
    return mean


@jit.kernel
def drive_on(
    X: Container, PP: Container, weight: Container, memory: Container, ds: float, wind_var: float,
    curvature_var: float,
) -> None:  # fmt: skip
    """Let both filters forget what `ds` metres change, wind and curvature (prior variances), and mix them."""
    memory[STRETCH_M] += ds
    if memory[STRETCH_M] >= MIX_M:
        calms = math.exp(-memory[STRETCH_M] / WIND_M)
        for m in (STRAIGHT, CURVED):
            fade(X[m], PP[m], WIND, calms, wind_var * (1.0 - calms * calms))
        curvature_var = usual_curvature(X[CURVED], PP[CURVED], memory, weight[CURVED], curvature_var)
        bent = math.exp(-memory[STRETCH_M] / CURVE_M)
        fade(X[CURVED], PP[CURVED], CURVATURE, bent, curvature_var * (1.0 - bent * bent))
        mix(X, PP, weight, memory[STRETCH_M], curvature_var)
        memory[STRETCH_M] = 0.0


@jit.kernel
def mix(X: Container, PP: Container, weight: Container, far_m: float, curvature_var: float) -> None:
    """Let each filter take over from the other what went from one road to the other over `far_m` metres.

    X: two state vectors; PP: two covariances; weight: two probabilities; all change in place. curvature_var:
    of a curve just begun (a straight has none).
    """
    n = len(X[STRAIGHT])
    bends = 1.0 - math.exp(-far_m / STRAIGHT_M)
    ends = 1.0 - math.exp(-far_m / CURVED_M)
    straight = weight[STRAIGHT] * (1.0 - bends) + weight[CURVED] * ends
    curved = weight[STRAIGHT] * bends + weight[CURVED] * (1.0 - ends)
    stays = weight[STRAIGHT] * (1.0 - bends) / straight
    bent = weight[STRAIGHT] * bends / curved
    weight[STRAIGHT], weight[CURVED] = straight, curved
    between, among = stays * (1.0 - stays), bent * (1.0 - bent)
    a, b, A, B = X[STRAIGHT], X[CURVED], PP[STRAIGHT], PP[CURVED]
    kappa, keep = b[CURVATURE], 1.0 - bent
    b[CURVATURE] = 0.0
    for i in range(n):
        if i != CURVATURE:
            row, other = A[i], B[i]
            d = a[i] - b[i]
            for j in range(i + 1):
                if j != CURVATURE:
                    p, q = row[j], other[j]
                    dd = d * (a[j] - b[j])
                    p_new = q + stays * (p - q) + between * dd
                    q_new = q + bent * (p - q) + among * dd
                    A[i][j], A[j][i] = p_new, p_new
                    B[i][j], B[j][i] = q_new, q_new
            cross = keep * other[CURVATURE] - among * kappa * d
            B[i][CURVATURE], B[CURVATURE][i] = cross, cross
    B[CURVATURE][CURVATURE] = keep * B[CURVATURE][CURVATURE] + bent * curvature_var + among * kappa * kappa
    for i in range(n):
        d = a[i] - b[i]
        a[i] = b[i] + stays * d
        b[i] = b[i] + bent * d
    b[CURVATURE] = keep * kappa
    a[CURVATURE] = 0.0


@jit.kernel
def blend(
    X: Container, PP: Container, weight: Container, memory: Container, is_open: bool, row: Container
) -> float:
    """Give mass, grade and their variances of both filters together, one Gaussian, into an output row.

    Returns the mean of the inverse mass; a closed gate moves none that is given out.
    """
    p = weight[STRAIGHT]
    b, c = X[STRAIGHT], X[CURVED]
    B, C = PP[STRAIGHT], PP[CURVED]
    between = p * (1.0 - p)
    apart, steeper, beyond = b[U] - c[U], b[GRADE] - c[GRADE], memory[PRESSED]
    mean: float = c[U] + p * apart
    if is_open or memory[HELD_U] == 0.0:
        memory[HELD_U] = mean
    row[OUT_U_VAR] = C[U][U] + p * (B[U][U] - C[U][U]) + between * apart * apart + beyond * beyond
    grade_var = C[GRADE][GRADE] + p * (B[GRADE][GRADE] - C[GRADE][GRADE])
    row[OUT_GRADE], row[OUT_GRADE_VAR] = c[GRADE] + p * steeper, grade_var + between * steeper * steeper
    row[OUT_CURVATURE] = (1.0 - p) * c[CURVATURE]
    return mean


@jit.kernel
def weigh(weight: Container, straight: float, curved: float) -> None:
    """Weigh the two filters by the log-likelihoods of what they have just foretold."""
    best = max(straight, curved)
    s = weight[STRAIGHT] * math.exp(straight - best)
    c = weight[CURVED] * math.exp(curved - best)
    weight[CURVED] = min(max(c / (s + c), _LEAST), 1.0 - _LEAST)
    weight[STRAIGHT] = 1.0 - weight[CURVED]


@jit.kernel
def likelihood(e: float, s: float) -> float:
    """Return the logarithm of an innovation's likelihood (less a constant), outliers counting no more."""
    return -0.5 * (min(e * e / s, OUTLIER) + math.log(s))
