"""Prediction: what the states do between two windows, x <- F x, P <- F P F' + Q, one row of F at a time."""

from __future__ import annotations

from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.next.model import (
    ANSWERS, CURVATURE, GRADE, HEIGHT, RATE, RESPONSE, ROLLING, ROUGHS, U, V, WIND, Bank, Window,
)
from canest.estimators.next.windows import WINDOW_S

_LOAD = (RATE,)
_SLOPE = (GRADE, ROLLING)
_ROAD = (CURVATURE, U, RESPONSE)
_SPEED = (GRADE, WIND, U)


@jit.kernel
def propagate(bank: Bank, count: int, i: int, states: Any, f: Any, row: Any) -> None:
    """x_i <- x_i + sum_j f_j x_j in every density, and P with it. f: (j, densities)."""
    x, P = bank.x, bank.P
    n = x.shape[1]
    for d in range(count):
        for k in range(n):
            row[k] = P[d, i, k]
        for j in range(len(states)):
            gain, other = f[j, d], states[j]
            x[d, i] += gain * x[d, other]
            for k in range(n):
                row[k] += gain * P[d, other, k]
        variance = row[i]
        for j in range(len(states)):
            variance += f[j, d] * row[states[j]]
        row[i] = variance
        for k in range(n):
            P[d, i, k] = row[k]
            P[d, k, i] = row[k]


@jit.kernel
def decay(bank: Bank, count: int, i: int, left: float, fresh: float) -> None:
    """x_i <- left x_i + noise of variance `fresh`."""
    x, P = bank.x, bank.P
    for d in range(count):
        x[d, i] *= left
        for k in range(x.shape[1]):
            P[d, i, k] *= left
            P[d, k, i] *= left
        P[d, i, i] += fresh


@jit.kernel
def reset(bank: Bank, count: int, i: int, value: float, variance: float) -> None:
    """Forget x_i."""
    x, P = bank.x, bank.P
    for d in range(count):
        x[d, i] = value
        for k in range(x.shape[1]):
            P[d, i, k] = 0.0
            P[d, k, i] = 0.0
        P[d, i, i] = variance


@jit.kernel
def add_variance(bank: Bank, count: int, i: int, variance: float) -> None:
    """Add noise to x_i."""
    for d in range(count):
        bank.P[d, i, i] += variance


@jit.kernel
def drift(bank: Bank, count: int, seconds: float, f: Any, row: Any) -> None:
    """u <- u + dt rho."""
    for d in range(count):
        f[0, d] = seconds
    propagate(bank, count, U, _LOAD, f, row)


@jit.kernel
def climb(bank: Bank, count: int, metres: float, f: Any, row: Any) -> None:
    """h <- h + ds (theta - rho)."""
    for d in range(count):
        f[0, d], f[1, d] = metres, -metres
    propagate(bank, count, HEIGHT, _SLOPE, f, row)


@jit.kernel
def travel(
    bank: Bank, count: int, metres: float, answered_kg: float, scatter: float, smooth: float, rough: float, f: Any, row: Any
) -> None:
    """theta <- theta + ds kappa + (dF/g) (u + xi)."""
    for d in range(count):
        mode = int(bank.mode[d])
        change = answered_kg * ANSWERS[mode]
        f[0, d], f[1, d], f[2, d] = metres, change, change
    propagate(bank, count, GRADE, _ROAD, f, row)
    for d in range(count):
        mode = int(bank.mode[d])
        noise = scatter * answered_kg * ANSWERS[mode]
        per_m = rough if ROUGHS[mode] > 0.0 else smooth
        bank.P[d, GRADE, GRADE] += per_m * metres + noise * noise


@jit.kernel
def accelerate(
    bank: Bank, count: int, w: Window, least_u: float, most_u: float, f: Any, row: Any
) -> float:
    """v <- v + dt a; returns the mean acceleration."""
    x = bank.x
    mean = 0.0
    for d in range(count):
        u = min(max(x[d, U], least_u), most_u)
        whole = 1.0 / (1.0 + u * w.rotating_kg)
        a = (u * w.force_N - w.roll_mps2 - GRAVITY_MPS2 * x[d, GRADE] - w.drag_N_per_mps * x[d, WIND]) * whole
        f[0, d] = -WINDOW_S * GRAVITY_MPS2 * whole
        f[1, d] = -WINDOW_S * w.drag_N_per_mps * whole
        f[2, d] = WINDOW_S * (w.force_N - w.rotating_kg * a) * whole
        # propagate adds f x: what it must add to be dt a
        x[d, V] += WINDOW_S * a - (f[0, d] * x[d, GRADE] + f[1, d] * x[d, WIND] + f[2, d] * x[d, U])
        mean += bank.weight[d] * a
    propagate(bank, count, V, _SPEED, f, row)
    return mean
