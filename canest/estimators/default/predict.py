"""Prediction: what the states do between two windows, x <- F x, P <- F P F' + Q, one row of F at a time."""

from __future__ import annotations

from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.model import (
    CURVATURE,
    GRADE,
    HEIGHT,
    RATE,
    RESPONSE,
    ROLLING,
    WIND,
    Q,
    U,
)

Vector = Any  #: (n,), list interpreted, array compiled
Matrix = Any  #: (n, n), likewise

_SLOPE = (GRADE, ROLLING)
_RATE = (RATE,)
_CURVATURE = (CURVATURE,)
_ANSWER = (U, RESPONSE)
_MOMENTUM = (GRADE, WIND, U)


@jit.kernel
def propagate(x: Vector, P: Matrix, i: int, states: Any, f: Vector, row: Vector) -> None:
    """x_i <- x_i + sum_j f_j x_j, and P with it. states: the j. row: scratch."""
    n = len(x)
    own = P[i]
    for k in range(n):
        row[k] = own[k]
    for j in range(len(states)):
        gain, other = f[j], P[states[j]]
        x[i] += gain * x[states[j]]
        for k in range(n):
            row[k] += gain * other[k]
    variance = row[i]
    for j in range(len(states)):
        variance += f[j] * row[states[j]]
    row[i] = variance
    for k in range(n):
        own[k] = row[k]
        P[k][i] = row[k]


@jit.kernel
def decay(x: Vector, P: Matrix, i: int, left: float, fresh: float) -> None:
    """x_i <- left x_i + noise of variance `fresh` (Ornstein-Uhlenbeck)."""
    x[i] *= left
    own = P[i]
    for k in range(len(x)):
        own[k] *= left
        P[k][i] *= left
    own[i] += fresh


@jit.kernel
def reset(x: Vector, P: Matrix, i: int, value: float, variance: float) -> None:
    """Forget x_i: a value, its variance, and no correlation."""
    x[i] = value
    own = P[i]
    for k in range(len(x)):
        own[k] = 0.0
        P[k][i] = 0.0
    own[i] = variance


@jit.kernel
def drift(x: Vector, P: Matrix, f: Vector, row: Vector, seconds: float) -> None:
    """Let the load drift: u <- u + dt rho."""
    f[0] = seconds
    propagate(x, P, U, _RATE, f, row)


@jit.kernel
def travel(
    x: Vector, P: Matrix, f: Vector, row: Vector, metres: float, curved: bool, height: bool, roughness: float
) -> None:
    """Let the vehicle go on.

    h <- h + ds (theta - rho),  theta <- theta + ds kappa,  Q_theta = roughness ds
    """
    if height:
        f[0], f[1] = metres, -metres
        propagate(x, P, HEIGHT, _SLOPE, f, row)
    if curved:
        f[0] = metres
        propagate(x, P, GRADE, _CURVATURE, f, row)
    P[GRADE][GRADE] += roughness * metres


@jit.kernel
def answer(x: Vector, P: Matrix, f: Vector, row: Vector, change: float, scatter: float) -> None:
    """Let the road answer a change of the force: theta <- theta + (dF/g) (u + c).

    change: dF / g, kg. scatter: std of the answer.
    """
    f[0] = f[1] = change
    propagate(x, P, GRADE, _ANSWER, f, row)
    P[GRADE][GRADE] += scatter * scatter


@jit.kernel
def accelerate(
    x: Vector, P: Matrix, f: Vector, row: Vector, seconds: float, force: float, roll: float, drag: float
) -> None:
    """Integrate momentum over a window: q <- q + dt (u F - g mu - g theta - c omega)."""
    x[Q] -= seconds * roll
    f[0], f[1], f[2] = -seconds * GRAVITY_MPS2, -seconds * drag, seconds * force
    propagate(x, P, Q, _MOMENTUM, f, row)
