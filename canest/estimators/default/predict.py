"""Prediction: what the states do between two windows, x <- A x, P <- A P A' + Q, one row of A at a time.

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
from canest.estimators.default.model import Mixture, Scratch, Window

_DRIFT = (m.RATE,)
_CLIMB = (m.GRADE, m.ROLLING)
_TRAVEL = (m.CURVATURE, m.ANSWER)
_ACCELERATE = (m.GRADE, m.WIND, m.U, m.OFFSET)


def _propagate(mix: Mixture, count: int, i: int, states: Any, t: Scratch) -> None:
    A, at = mix.A[:count], (i, *states)
    f = np.array([1.0] * count + t.f[: count * len(states)]).reshape(-1, count)
    row = np.add.reduce(A.take(at, 1) * f.T[:, :, None], 1)  # like all sums here one after the other
    row[:, i] = np.add.reduce(row.T.take(at, 0) * f)
    A[:, i], A[:, :, i] = row, row[:, :-1]


@jit.kernel_beside(_propagate)
def propagate(mix: Mixture, count: int, i: int, states: Any, t: Scratch) -> None:
    """x_i <- x_i + sum_j f_j x_j, and P with it. states: the j; f_j of density d at t.f[j * count + d]."""
    A, row = mix.A, t.K
    n = A.shape[1]
    for d in range(count):
        for k in range(n + 1):
            row[k] = A[d, i, k]
        for j in range(len(states)):
            gain, state = t.f[j * count + d], states[j]
            for k in range(n + 1):
                row[k] += gain * A[d, state, k]
        variance = row[i]
        for j in range(len(states)):
            variance += t.f[j * count + d] * row[states[j]]
        row[i] = variance
        for k in range(n + 1):
            A[d, i, k] = row[k]
        for k in range(n):
            A[d, k, i] = row[k]


@jit.kernel
def decay(mix: Mixture, count: int, i: int, left: float, std: float, modes: Any) -> None:
    """x_i <- left x_i + noise that restores a std (Ornstein-Uhlenbeck), in the modes that have it."""
    fresh = std * std * (1.0 - left * left)
    for d in range(count):
        if modes[mix.mode[d]] > 0.0:
            mix.A[d, i] *= left
            mix.A[d, :, i] *= left
            mix.A[d, i, i] += fresh


@jit.kernel
def widen(mix: Mixture, count: int, i: int, variance: float, modes: Any) -> None:
    """Add noise of one variance to x_i, in the modes that have it."""
    for d in range(count):
        if modes[mix.mode[d]] > 0.0:
            mix.P[d, i, i] += variance


def _column(a: Any, count: int) -> Any:
    return a[:count].tolist()


@jit.kernel_beside(_column)
def column(a: Any, count: int) -> Any:
    """Return the first numbers of an array, to be read before it changes."""
    return a[:count]


@jit.kernel
def moments(mix: Mixture, count: int, i: int, mean: Any, variance: Any) -> None:
    """Copy mean and variance of x_i in every density."""
    mean[:count] = column(mix.x[:, i], count)
    variance[:count] = column(mix.P[:, i, i], count)


@jit.kernel
def restore(mix: Mixture, count: int, i: int, mean: Any, variance: Any, modes: Any) -> None:
    """Give mean and variance back to x_i in the modes that keep it (Schmidt 1966)."""
    for d in range(count):
        if modes[mix.mode[d]] > 0.0:
            mix.x[d, i], mix.P[d, i, i] = mean[d], variance[d]


@jit.kernel
def climb(mix: Mixture, count: int, metres: float, wander: float, t: Scratch) -> None:
    """Let the height follow the slope: h <- h + ds (theta - rho), Q = wander of the receiver."""
    for d in range(count):
        t.f[d], t.f[count + d] = metres, -metres
    propagate(mix, count, m.HEIGHT, _CLIMB, t)
    widen(mix, count, m.HEIGHT, wander, m.EVERYWHERE)


@jit.kernel
def travel(mix: Mixture, count: int, metres: float, answered_N: float, c: Constants, t: Scratch) -> None:
    """Let the road go on: theta <- theta + ds kappa + (dF / g) sigma, Q = q_theta ds. answered_N: dF."""
    if metres == 0.0 and answered_N == 0.0:
        return
    by_answer = answered_N / GRAVITY_MPS2
    bent_m, most = max(min(metres, c.curvature_length_m), -c.curvature_length_m), c.grade_std * c.grade_std
    way_m = abs(metres)
    smooth, rough = min(c.smooth_wander_1pm * way_m, most), min(c.rough_wander_1pm * way_m, most)
    for d in range(count):
        t.f[d], t.f[count + d] = bent_m, by_answer
        # noise of the state itself: the row adds no multiple of it, so it may come first
        mix.P[d, m.GRADE, m.GRADE] += rough if m.IS_ROUGH[mix.mode[d]] > 0.0 else smooth
    propagate(mix, count, m.GRADE, _TRAVEL, t)


@jit.kernel
def accelerate(
    mix: Mixture, count: int, w: Window, dt: float, lacking: float, u_mean: float, v: Vehicle, t: Scratch
) -> float:
    """Let the force act: v <- v + dt a, a = (u F - g mu - g theta - c omega - G xi) / (1 + u J).

    lacking: density of the force that the model lacks. u_mean: mean inverse mass. Returns the mean of a.
    """
    if mix.x.shape[1] == m.STATES:  # keep the speed where the window begins
        A = mix.A[:count]
        A[:, m.BEGIN] = A[:, m.V]
        A[:, :, m.BEGIN] = A[:, :, m.V]
    us, grades = column(mix.x[:, m.U], count), column(mix.x[:, m.GRADE], count)
    winds, offsets = column(mix.x[:, m.WIND], count), column(mix.x[:, m.OFFSET], count)
    f, least_u, most_u, mean = t.f, v.least_u, v.most_u, 0.0
    force_N, rotating_kg, drag_N_per_mps = w.force_N, w.rotating_kg, w.drag_N_per_mps
    roll_mps2, gear_1pm = w.roll_mps2, w.gear_1pm
    lever = u_mean / (1.0 + u_mean * rotating_kg)
    noise = lever * lever * lacking * dt
    for d in range(count):
        u, grade, wind, offset = us[d], grades[d], winds[d], offsets[d]
        u = least_u if u < least_u else most_u if u > most_u else u
        part = dt / (1.0 + u * rotating_kg)
        by_grade, by_wind, by_offset = -part * GRAVITY_MPS2, -part * drag_N_per_mps, -part * gear_1pm
        on_level = u * force_N - roll_mps2
        dv = part * (on_level - GRAVITY_MPS2 * grade - drag_N_per_mps * wind - gear_1pm * offset)
        by_u = part * (force_N - rotating_kg * dv / dt)
        f[d], f[count + d], f[2 * count + d], f[3 * count + d] = by_grade, by_wind, by_u, by_offset
        # less what the row adds by its states, and must not
        mix.x[d, m.V] += dv - (by_grade * grade + by_wind * wind + by_u * u + by_offset * offset)
        mix.P[d, m.V, m.V] += noise
        mean += mix.weight[d] * dv / dt
    propagate(mix, count, m.V, _ACCELERATE, t)
    return mean


@jit.kernel
def follow_bends(mix: Mixture, count: int, before: float, metres: float, c: Constants) -> float:
    """Return the variance of a curvature, 1/m2: it follows that of the curved roads there were.

    A step of expectation and maximisation (docs/theory.md, section 3.4), from country roads to streets.
    before: the variance so far. metres: since then.
    """
    least, most = c.curvature_std_1pm * c.curvature_std_1pm, c.sharp_curvature_1pm * c.sharp_curvature_1pm
    surplus = 0.0
    for d in range(count):
        if m.BENDS[mix.mode[d]] > 0.0:
            mean = mix.x[d, m.CURVATURE]
            surplus += mix.weight[d] * (mean * mean + mix.P[d, m.CURVATURE, m.CURVATURE] - before)
    followed = before + min(metres / c.straight_length_m, 1.0) * surplus
    return max(min(followed, most), least)


@jit.kernel
def fade(
    mix: Mixture, count: int, metres: float, seconds: float, stds: tuple[float, ...], c: Constants, t: Scratch
) -> None:
    """Let wind and curvature fade over a distance, and in time the crank torque that the report lacks.

    stds: of the three, those of wind and torque times u. Where the load drifts, u <- u + t r.
    """
    decay(mix, count, m.WIND, math.exp(-metres / c.wind_length_m), stds[0], m.EVERYWHERE)
    decay(mix, count, m.CURVATURE, math.exp(-metres / c.curvature_length_m), stds[1], m.BENDS)
    decay(mix, count, m.OFFSET, math.exp(-seconds / c.offset_duration_s), stds[2], m.EVERYWHERE)
    for d in range(count):
        t.f[d] = seconds
    propagate(mix, count, m.U, _DRIFT, t)
