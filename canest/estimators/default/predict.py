"""Prediction: what the states do between two windows, x <- F x, P <- F P F' + Q, one row of F at a time.

All densities have the same states, and the first `count` are alive. Interpreted, numpy takes them all at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.model import (
    ANSWERS,
    CURVATURE,
    GRADE,
    HEIGHT,
    IS_ROUGH,
    MOST,
    RATE,
    RESPONSE,
    ROLLING,
    WIND,
    Mixture,
    U,
    V,
    Window,
)
from canest.estimators.default.windows import WINDOW_S

_DRIFT = (RATE,)
_CLIMB = (GRADE, ROLLING)
_TRAVEL = (CURVATURE, U, RESPONSE)
_ACCELERATE = (GRADE, WIND, U)


def _propagate(mix: Mixture, count: int, i: int, states: Any, f: Any, row: Any) -> None:
    x, P = mix.x[:count], mix.P[:count]
    gains = [np.array(f[j * MOST : j * MOST + count]) for j in range(len(states))]
    line = P[:, i].copy()
    for gain, state in zip(gains, states, strict=True):
        x[:, i] += gain * x[:, state]
        line += gain[:, None] * P[:, state]
    variance = line[:, i].copy()
    for gain, state in zip(gains, states, strict=True):
        variance += gain * line[:, state]
    line[:, i] = variance
    P[:, i] = line
    P[:, :, i] = line


@jit.kernel_beside(_propagate)
def propagate(mix: Mixture, count: int, i: int, states: Any, f: Any, row: Any) -> None:
    """x_i <- x_i + sum_j f_j x_j, and P with it.

    states: the j. f: f_j of density d at [j * MOST + d]. row: scratch.
    """
    x, P = mix.x, mix.P
    n = x.shape[1]
    for d in range(count):
        for k in range(n):
            row[k] = P[d, i, k]
        for j in range(len(states)):
            gain, state = f[j * MOST + d], states[j]
            x[d, i] += gain * x[d, state]
            for k in range(n):
                row[k] += gain * P[d, state, k]
        variance = row[i]
        for j in range(len(states)):
            variance += f[j * MOST + d] * row[states[j]]
        row[i] = variance
        for k in range(n):
            P[d, i, k] = row[k]
            P[d, k, i] = row[k]


def _decay(mix: Mixture, count: int, i: int, left: float, fresh: float, modes: Any) -> None:
    has = [d for d in range(count) if modes[int(mix.mode[d])] > 0.0]
    if has:
        x, P = mix.x, mix.P
        x[has, i] *= left
        P[has, i] *= left
        P[has, :, i] *= left
        P[has, i, i] += fresh


@jit.kernel_beside(_decay)
def decay(mix: Mixture, count: int, i: int, left: float, fresh: float, modes: Any) -> None:
    """x_i <- left x_i + noise of variance `fresh` (Ornstein-Uhlenbeck), in the modes that have it."""
    x, P = mix.x, mix.P
    for d in range(count):
        if modes[int(mix.mode[d])] > 0.0:
            x[d, i] *= left
            for k in range(x.shape[1]):
                P[d, i, k] *= left
            for k in range(x.shape[1]):
                P[d, k, i] *= left
            P[d, i, i] += fresh


def _add(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    mix.x[:count, i] += mean[:count]
    mix.P[:count, i, i] += variance[:count]


@jit.kernel_beside(_add)
def add(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    """Add noise of a mean and a variance to x_i, in each density its own."""
    for d in range(count):
        mix.x[d, i] += mean[d]
        mix.P[d, i, i] += variance[d]


def _moments(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    mean[:count] = mix.x[:count, i].tolist()
    variance[:count] = mix.P[:count, i, i].tolist()


@jit.kernel_beside(_moments)
def moments(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    """Copy mean and variance of x_i in every density."""
    for d in range(count):
        mean[d], variance[d] = mix.x[d, i], mix.P[d, i, i]


@jit.kernel
def drift(mix: Mixture, count: int, seconds: float, f: Any, row: Any) -> None:
    """Let the load drift: u <- u + dt r."""
    for d in range(count):
        f[d] = seconds
    propagate(mix, count, U, _DRIFT, f, row)


@jit.kernel
def climb(mix: Mixture, count: int, metres: float, wander: float, f: Any, row: Any) -> None:
    """Let the height follow the slope: h <- h + ds (theta - rho), Q = wander of the receiver."""
    for d in range(count):
        f[d], f[MOST + d] = metres, -metres
    propagate(mix, count, HEIGHT, _CLIMB, f, row)
    for d in range(count):
        f[d] = wander
    add_noise(mix, count, HEIGHT, f)


@jit.kernel
def travel(
    mix: Mixture, count: int, metres: float, answered_kg: float, u: float, smooth: float, rough: float,
    f: Any, row: Any,
) -> None:  # fmt: skip
    """Let the road go on: theta <- theta + ds kappa + (dF / g)(u + xi), Q = r ds + (u dF / g)^2.

    answered_kg: dF / g, of the modes in which the road answers. smooth, rough: r, variance per metre.
    """
    for d in range(count):
        change = answered_kg * ANSWERS[int(mix.mode[d])]
        f[d], f[MOST + d], f[2 * MOST + d] = metres, change, change
    propagate(mix, count, GRADE, _TRAVEL, f, row)
    for d in range(count):
        mode = int(mix.mode[d])
        scatter = u * answered_kg * ANSWERS[mode]
        f[d] = (rough if IS_ROUGH[mode] > 0.0 else smooth) * metres + scatter * scatter
    add_noise(mix, count, GRADE, f)


@jit.kernel
def accelerate(mix: Mixture, count: int, w: Window, bounds: Any, f: Any, row: Any, room: Any) -> float:
    """Let the force act: v <- v + dt a, a = (u F - g mu - g theta - c omega) / (1 + u J).

    F of this row: da/dtheta = -g / (1 + u J), da/domega = -c / (1 + u J), da/du = (F - J a) / (1 + u J).
    bounds: of u. room: scratch, four columns. Returns the mean acceleration.
    """
    us, grades, winds, added = room
    column(mix.x, count, U, us)
    column(mix.x, count, GRADE, grades)
    column(mix.x, count, WIND, winds)
    mean = 0.0
    for d in range(count):
        u = min(max(us[d], bounds[0]), bounds[1])
        dt = WINDOW_S / (1.0 + u * w.rotating_kg)
        gained = dt * (u * w.force_N - w.roll_mps2 - GRAVITY_MPS2 * grades[d] - w.drag_N_per_mps * winds[d])
        f[d], f[MOST + d] = -dt * GRAVITY_MPS2, -dt * w.drag_N_per_mps
        f[2 * MOST + d] = dt * (w.force_N - w.rotating_kg * gained / WINDOW_S)
        # what the row adds by its states, and must not
        added[d] = gained - (f[d] * grades[d] + f[MOST + d] * winds[d] + f[2 * MOST + d] * us[d])
        mean += mix.weight[d] * gained / WINDOW_S
    propagate(mix, count, V, _ACCELERATE, f, row)
    shift(mix, count, V, added)
    return mean
