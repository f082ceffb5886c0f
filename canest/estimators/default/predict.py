"""Prediction: what the states do between two windows, x <- F x, P <- F P F' + Q, one row of F at a time.

All densities have the same states, and the first `count` are alive. Interpreted, numpy takes all at once.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.model import MOST, Mixture, Scratch, Window

_EVERYWHERE = (1.0,) * m.MODES
_DRIFT = (m.RATE,)
_CLIMB = (m.GRADE, m.ROLLING)
_TRAVEL = (m.CURVATURE, m.U)
_ACCELERATE = (m.GRADE, m.WIND, m.U)


def _propagate(mix: Mixture, count: int, i: int, states: Any, t: Scratch) -> None:
    x, P = mix.x[:count], mix.P[:count]
    gains = [np.array(t.f[j * MOST : j * MOST + count]) for j in range(len(states))]
    row = P[:, i].copy()
    for gain, state in zip(gains, states, strict=True):
        x[:, i] += gain * x[:, state]
        row += gain[:, None] * P[:, state]
    variance = row[:, i].copy()
    for gain, state in zip(gains, states, strict=True):
        variance += gain * row[:, state]
    row[:, i] = variance
    P[:, i], P[:, :, i] = row, row


@jit.kernel_beside(_propagate)
def propagate(mix: Mixture, count: int, i: int, states: Any, t: Scratch) -> None:
    """x_i <- x_i + sum_j f_j x_j, and P with it. states: the j; f_j of density d at t.f[j * MOST + d]."""
    x, P, row = mix.x, mix.P, t.K
    n = x.shape[1]
    for d in range(count):
        for k in range(n):
            row[k] = P[d, i, k]
        for j in range(len(states)):
            gain, state = t.f[j * MOST + d], states[j]
            x[d, i] += gain * x[d, state]
            for k in range(n):
                row[k] += gain * P[d, state, k]
        variance = row[i]
        for j in range(len(states)):
            variance += t.f[j * MOST + d] * row[states[j]]
        row[i] = variance
        for k in range(n):
            P[d, i, k] = row[k]
            P[d, k, i] = row[k]


def _decay(mix: Mixture, count: int, i: int, left: float, fresh: float, modes: Any) -> None:
    has = [modes[int(mode)] for mode in mix.mode[:count]]
    factor = np.array([left if one > 0.0 else 1.0 for one in has])
    mix.x[:count, i] *= factor
    mix.P[:count, i] *= factor[:, None]
    mix.P[:count, :, i] *= factor[:, None]
    mix.P[:count, i, i] += [fresh * one for one in has]


@jit.kernel_beside(_decay)
def decay(mix: Mixture, count: int, i: int, left: float, fresh: float, modes: Any) -> None:
    """x_i <- left x_i + noise of variance `fresh` (Ornstein-Uhlenbeck), in the modes that have it."""
    for d in range(count):
        if modes[int(mix.mode[d])] > 0.0:
            mix.x[d, i] *= left
            for k in range(mix.x.shape[1]):
                mix.P[d, i, k] *= left
            for k in range(mix.x.shape[1]):
                mix.P[d, k, i] *= left
            mix.P[d, i, i] += fresh


def _add(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    mix.x[:count, i] += mean[:count]
    mix.P[:count, i, i] += variance[:count]


@jit.kernel_beside(_add)
def add(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    """Add noise to x_i: a mean and a variance for each density."""
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


def _restore(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    mix.x[:count, i] = mean[:count]
    mix.P[:count, i, i] = variance[:count]


@jit.kernel_beside(_restore)
def restore(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    """Give mean and variance back to x_i in every density."""
    for d in range(count):
        mix.x[d, i], mix.P[d, i, i] = mean[d], variance[d]


@jit.kernel
def fill(count: int, column: Any, value: float) -> None:
    """Give every density one number."""
    for d in range(count):
        column[d] = value


@jit.kernel
def drift(mix: Mixture, count: int, seconds: float, t: Scratch) -> None:
    """Let the load drift: u <- u + dt r."""
    fill(count, t.f, seconds)
    propagate(mix, count, m.U, _DRIFT, t)


@jit.kernel
def climb(mix: Mixture, count: int, metres: float, wander: float, t: Scratch) -> None:
    """Let the height follow the slope: h <- h + ds (theta - rho), Q = wander of the receiver."""
    for d in range(count):
        t.f[d], t.f[MOST + d] = metres, -metres
    propagate(mix, count, m.HEIGHT, _CLIMB, t)
    fill(count, t.f, wander)
    add(mix, count, m.HEIGHT, t.zeros, t.f)


@jit.kernel
def travel(
    mix: Mixture, count: int, metres: float, answered_kg: float, u: float, c: Constants, t: Scratch
) -> None:
    """Let the road go on: theta <- theta + ds kappa + (dF / g) u, Q = r ds + (u dF / g)^2.

    answered_kg: dF / g, of the modes in which the road answers.
    """
    if metres == 0.0 and answered_kg == 0.0:
        return
    for d in range(count):
        t.f[d], t.f[MOST + d] = min(metres, c.curvature_length_m), answered_kg * m.ANSWERS[int(mix.mode[d])]
    propagate(mix, count, m.GRADE, _TRAVEL, t)
    for d in range(count):
        mode = int(mix.mode[d])
        scatter = u * answered_kg * m.ANSWERS[mode]
        wander = c.rough_wander_1pm if m.IS_ROUGH[mode] > 0.0 else c.smooth_wander_1pm
        t.f[d] = min(wander * metres, c.grade_std * c.grade_std) + scatter * scatter
    add(mix, count, m.GRADE, t.zeros, t.f)


@jit.kernel
def accelerate(
    mix: Mixture, count: int, w: Window, dt: float, lacking: float, u_mean: float, v: Vehicle, t: Scratch
) -> float:
    """Let the force act: v <- v + dt a, a = (u F - g mu - g theta - c omega) / (1 + u J).

    F of this row: da/dtheta = -g / (1 + u J), da/domega = -c / (1 + u J), da/du = (F - J a) / (1 + u J).
    lacking: density of the force that the model lacks. u_mean: mean inverse mass. Returns the acceleration.
    """
    us, grades, winds, unused = t.columns
    moments(mix, count, m.U, us, unused)
    moments(mix, count, m.GRADE, grades, unused)
    moments(mix, count, m.WIND, winds, unused)
    gained, mean = t.columns[3], 0.0
    for d in range(count):
        u = min(max(us[d], v.least_u), v.most_u)
        part = dt / (1.0 + u * w.rotating_kg)
        dv = part * (u * w.force_N - w.roll_mps2 - GRAVITY_MPS2 * grades[d] - w.drag_N_per_mps * winds[d])
        t.f[d], t.f[MOST + d] = -part * GRAVITY_MPS2, -part * w.drag_N_per_mps
        t.f[2 * MOST + d] = part * (w.force_N - w.rotating_kg * dv / dt)
        # what the row adds by its states, and must not
        gained[d] = dv - (t.f[d] * grades[d] + t.f[MOST + d] * winds[d] + t.f[2 * MOST + d] * u)
        mean += mix.weight[d] * dv / dt
    propagate(mix, count, m.V, _ACCELERATE, t)
    lever = u_mean / (1.0 + u_mean * w.rotating_kg)
    fill(count, t.f, lever * lever * lacking * dt)
    add(mix, count, m.V, gained, t.f)
    return mean


@jit.kernel
def fade(mix: Mixture, count: int, metres: float, wind: float, c: Constants) -> None:
    """Let wind and curvature fade over a distance. wind: std of the wind times u."""
    left = math.exp(-metres / c.wind_length_m)
    decay(mix, count, m.WIND, left, wind * wind * (1.0 - left * left), _EVERYWHERE)
    left = math.exp(-metres / c.curvature_length_m)
    decay(
        mix,
        count,
        m.CURVATURE,
        left,
        c.curvature_std_1pm * c.curvature_std_1pm * (1.0 - left * left),
        m.BENDS,
    )


@jit.kernel
def sharpen(mix: Mixture, count: int, c: Constants, t: Scratch) -> None:
    """Let a bend be sharper than usual where innovations surprise: the other cause beside a load."""
    for d in range(count):
        t.f[d] = c.sharp_curvature_1pm * c.sharp_curvature_1pm * m.BENDS[int(mix.mode[d])]
    add(mix, count, m.CURVATURE, t.zeros, t.f)


@jit.kernel
def step_of_road(mix: Mixture, count: int, lever: float, c: Constants, t: Scratch) -> None:
    """Where no noise explains an innovation the road has a step, and the speed is what was measured.

    lever: grade per m/s of speed missing.
    """
    for d in range(count):
        missing = t.e[d]
        big = missing * missing > c.road_step_nis * t.s[d]
        step = missing * lever
        t.columns[0][d] = min(step * step, c.grade_std * c.grade_std) if big else 0.0
        t.columns[1][d] = missing * missing if big else 0.0
    add(mix, count, m.GRADE, t.zeros, t.columns[0])
    add(mix, count, m.V, t.zeros, t.columns[1])
