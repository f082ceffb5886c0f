"""Measurements: the row h of each, its variance r, and the update with it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.next.constants import Constants
from canest.estimators.next.model import (
    BIAS, CURVATURE, DELAY, GRADE, HEIGHT, PITCH, SLIP, U, V, WIND, WINDUP, Bank, Window,
)
from canest.estimators.next.noise import surplus
from canest.estimators.next.predict import add_variance, reset
from canest.estimators.next.update import add_log_likelihood, condition_all_but_mass, condition_on
from canest.estimators.next.windows import WINDOW_S

_SPEED = (V, DELAY, SLIP, WINDUP)
_SENSED = (GRADE, BIAS, PITCH, SLIP)
_ALTITUDE = (HEIGHT,)
_SLOPE = (GRADE, WIND)
_COASTED = (GRADE, CURVATURE, WIND, U)
_FAR_OFF = 25.0
BIAS_WANDER = 6e-7
_CLOSED_NOISE = 0.01
UNKNOWN_V = 100.0


class Scratch(NamedTuple):
    """Room to work in."""

    h: Any
    K: Any
    a: Any
    e: Any
    s: Any
    f: Any
    share: Any
    per_load: Any
    table: Any


@jit.kernel
def speed(bank: Bank, count: int, t: Scratch, w: Window, u: float, r: float, c: Constants) -> None:
    """v measured = v + delta T + sigma v T."""
    h = t.h
    h[0] = 1.0
    delay = 0.0
    for d in range(count):
        delay += bank.weight[d] * bank.x[d, DELAY]
    half_s = 0.5 * min(max(delay / u, -0.1), 0.1)
    h[1] = w.traction_N + half_s * w.traction_Nps
    h[2] = w.speed_mps * w.traction_N
    h[3] = w.traction_Nps
    condition_on(bank, count, _SPEED, h, w.speed_mps, r, c.outlier, t.e, t.s, t.K)


@jit.kernel
def mean_surplus(bank: Bank, count: int, t: Scratch, r: float, c: Constants) -> float:
    """Return the mean of e^2 - s."""
    mean = 0.0
    for d in range(count):
        mean += bank.weight[d] * surplus(t.e[d], t.s[d], r, c.doubted, c.outlier)
    return mean


@jit.kernel
def accelerometer(
    bank: Bank, count: int, t: Scratch, w: Window, r: float, motion: float, accel_before: float, u: float, c: Constants
) -> float:
    """a_x - dv/dt = g theta + bias + pitch dv/dt - slip. Returns the surplus."""
    add_variance(bank, count, BIAS, BIAS_WANDER * 2.0 * WINDOW_S)
    slip = w.speed_mps * (w.traction_N - w.before_N) / WINDOW_S + w.traction_N * motion
    own = r
    if w.open == 0.0:
        slipped = u * slip * c.slip_per_mps2
        r += slipped * slipped
        r += _CLOSED_NOISE * w.accel_mps2 * w.accel_mps2
        slip = 0.0
    h = t.h
    h[0], h[1], h[2], h[3] = GRAVITY_MPS2, 1.0, motion, -slip
    condition_on(bank, count, _SENSED, h, w.sensed_mps2 - w.accel_mps2, r, c.outlier, t.e, t.s, t.K)
    add_log_likelihood(bank.found, count, t.e, t.s, r, c.outliers)
    return mean_surplus(bank, count, t, own, c)


@jit.kernel
def altitude(bank: Bank, count: int, t: Scratch, height_m: float, known: bool, c: Constants) -> None:
    """Update with an altitude, or begin with it."""
    r = c.height_var_m2
    e = s = 0.0
    for d in range(count):
        e += bank.weight[d] * (height_m - bank.x[d, HEIGHT])
        s += bank.weight[d] * (bank.P[d, HEIGHT, HEIGHT] + r)
    if known and e * e < _FAR_OFF * s:
        t.h[0] = 1.0
        condition_on(bank, count, _ALTITUDE, t.h, height_m, r, c.outlier, t.e, t.s, t.K)
        add_log_likelihood(bank.found, count, t.e, t.s, r, c.outliers)
    else:
        reset(bank, count, HEIGHT, height_m, r)


@jit.kernel
def closed_balance(
    bank: Bank, count: int, t: Scratch, w: Window, speed_var: float, u: float, roll_share: float, c: Constants
) -> None:
    """Update all but the mass where a gate hides a force."""
    hidden = c.closed_share * u * w.force_N
    r = 2.0 * speed_var / (WINDOW_S * WINDOW_S)
    if w.retarding > 0.0:
        r += 25.0 * hidden * hidden
    else:
        roll = roll_share * w.roll_mps2
        r += 5.0 * (hidden * hidden + roll * roll) + 25.0 * w.bend_mps2 * w.bend_mps2
    h = t.h
    h[0], h[1] = GRAVITY_MPS2, w.drag_N_per_mps
    lever_u = -(w.force_N - w.rotating_kg * w.accel_mps2)
    z = -w.accel_mps2 - w.roll_mps2
    condition_all_but_mass(bank, count, _SLOPE, h, lever_u, z, r, c.outlier, t.K, t.a)


@jit.kernel
def coasting(bank: Bank, count: int, t: Scratch, w: Window, c: Constants) -> None:
    """Update with a coasting whose middle lies some metres back."""
    back_m = w.coast_back_s * w.speed_mps
    r = w.coast_var + c.open_drag_mps2 * c.open_drag_mps2
    r += GRAVITY_MPS2 * GRAVITY_MPS2 * c.smooth_1pm * abs(back_m)
    z = -w.coast_mps2 - w.roll_mps2
    lever = w.coast_kg * w.coast_mps2 - w.coast_N
    h = t.h
    h[0], h[1], h[2], h[3] = GRAVITY_MPS2, -GRAVITY_MPS2 * back_m, w.drag_N_per_mps, lever
    condition_on(bank, count, _COASTED, h, z, r, c.outlier, t.e, t.s, t.K)
    add_log_likelihood(bank.found, count, t.e, t.s, r, c.outliers)


@jit.kernel
def has_coasted(w: Window, c: Constants) -> bool:
    """Return whether the window ends a coasting that was here."""
    back_m = w.coast_back_s * w.speed_mps
    return not math.isnan(w.coast_mps2) and -20.0 <= back_m < c.far_m
