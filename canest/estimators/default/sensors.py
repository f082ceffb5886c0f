"""Measurements: the row h of each, its variance r, and the update with it (docs/theory.md, section 4)."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.constants import Closed, Noise, Prior, Road
from canest.estimators.default.model import (
    BIAS,
    CURVATURE,
    DELAY,
    GRADE,
    HEIGHT,
    LAG,
    PITCH,
    SLIP,
    WIND,
    WINDUP,
    Q,
    U,
    Window,
)
from canest.estimators.default.predict import Matrix, Vector, reset
from canest.estimators.default.update import condition_all_but_mass, condition_on, log_likelihood
from canest.estimators.default.windows import WINDOW_S

_SPEED = (Q, DELAY, SLIP, WINDUP, U)
_SENSED = (GRADE, BIAS, PITCH, SLIP, LAG)
_ALTITUDE = (HEIGHT,)
_SLOPE = (GRADE, WIND)
_COASTED = (GRADE, CURVATURE, WIND, U)
#: bounds of the delay at which the lever of the delay is taken, s
_LONGEST_DELAY_S = 0.1
#: an altitude this many variances off begins anew
_FAR_OFF = 25.0
#: variance that an accelerometer's offset gains per second, (m/s2)2
BIAS_WANDER = 6e-7
#: accelerations of the speed are delayed against the accelerometer by the shifting gear
_CLOSED_NOISE = 0.01


class Scratch(NamedTuple):
    """Vectors to work on, each as long as the state."""

    h: Vector
    K: Vector
    a: Vector


class Levers(NamedTuple):
    """What the measurements of one window have in common, for every hypothesis."""

    mean_u: float  #: inverse mass, mean of all
    calm_mps: float  #: slow speed: an instrument for levers, whose noise must not meet that of the innovation
    least_u: float  #: bounds of the inverse mass
    most_u: float
    speed_var: float  #: variance of a speed, oscillation of the driveline included
    sensed_var: float


@jit.kernel
def bounded_u(x: Vector, c: Levers) -> float:
    """Return the inverse mass of a density, within the bounds of the vehicle."""
    u: float = min(max(x[U], c.least_u), c.most_u)
    return u


@jit.kernel
def begin_balance(
    x: Vector, P: Matrix, scratch: Scratch, w: Window, c: Levers, began_mps: float, noise: Noise
) -> None:
    """Begin a balance of momentum with the speed before the window."""
    u = bounded_u(x, c)
    whole, mean_whole = 1.0 + u * w.rotating_kg, 1.0 + c.mean_u * w.rotating_kg
    reset(x, P, Q, w.before_mps * whole, 100.0)
    h = scratch.h
    h[0] = 1.0
    h[1] = (w.before_N + half_delay_s(x, u) * w.before_Nps) * mean_whole
    h[2] = began_mps * w.before_N * mean_whole
    h[3] = w.before_Nps
    h[4] = -w.rotating_kg * began_mps
    z = w.before_mps + w.rotating_kg * (w.before_mps - began_mps) * u
    condition_on(x, P, _SPEED, h, z, c.speed_var * whole * whole, noise.outlier, scratch.K)


@jit.kernel
def speed(x: Vector, P: Matrix, scratch: Scratch, w: Window, c: Levers, noise: Noise) -> tuple[float, float]:
    """Update with the speed at the window's end: (1 + u J) v = q - delays, slip, windup. Returns e, s.

    v measured = v + delta T + sigma v T + gamma dT/dt, with delta, sigma, gamma times u.
    """
    u = bounded_u(x, c)
    whole, mean_whole = 1.0 + u * w.rotating_kg, 1.0 + c.mean_u * w.rotating_kg
    h = scratch.h
    h[0] = 1.0
    h[1] = (w.traction_N + half_delay_s(x, u) * w.traction_Nps) * mean_whole
    h[2] = c.calm_mps * w.traction_N * mean_whole
    h[3] = w.traction_Nps
    h[4] = -w.rotating_kg * c.calm_mps
    z = w.speed_mps + w.rotating_kg * (w.speed_mps - c.calm_mps) * u
    e, s = condition_on(
        x, P, _SPEED, h, z, speed_noise(w, c, noise) * whole * whole, noise.outlier, scratch.K
    )
    return e / whole, s / (whole * whole)


@jit.kernel
def speed_noise(w: Window, c: Levers, noise: Noise) -> float:
    """Return the variance of a measured speed: its noise, and what the torque's jitter makes of it."""
    moved = w.traction_N - w.before_N
    jitter = c.mean_u * moved * noise.jitter_s / (1.0 + c.mean_u * w.rotating_kg)
    return c.speed_var + jitter * jitter


@jit.kernel
def half_delay_s(x: Vector, u: float) -> float:
    """Return half of the remaining delay: its lever is the traction halfway through it."""
    half: float = 0.5 * min(max(x[DELAY] / u, -_LONGEST_DELAY_S), _LONGEST_DELAY_S)
    return half


@jit.kernel
def accelerometer(
    x: Vector, P: Matrix, scratch: Scratch, w: Window, c: Levers, motion: float, accel_before: float,
    prior: Prior, noise: Noise,
) -> tuple[float, float, float]:  # fmt: skip
    """Update with an accelerometer: a_x - dv/dt = g theta + bias + pitch dv/dt - lag d2v/dt2 - slip.

    motion: dv/dt by the model. Returns e, s and r.
    """
    P[BIAS][BIAS] += BIAS_WANDER * 2.0 * WINDOW_S
    rate = (w.traction_N - w.before_N) / WINDOW_S
    slip = c.calm_mps * rate + w.traction_N * motion
    r = c.sensed_var
    if w.open == 0.0:
        jerk = (w.accel_mps2 - accel_before) / WINDOW_S
        u = bounded_u(x, c)
        slipped, late = u * slip * prior.slip_per_mps2, jerk * prior.lag_s
        r += slipped * slipped + late * late
        r += _CLOSED_NOISE * w.accel_mps2 * w.accel_mps2
        rate = slip = 0.0
    h = scratch.h
    h[0], h[1], h[2], h[3], h[4] = GRAVITY_MPS2, 1.0, motion, -slip, -rate
    e, s = condition_on(x, P, _SENSED, h, w.sensed_mps2 - w.accel_mps2, r, noise.outlier, scratch.K)
    return e, s, r


@jit.kernel
def altitude(
    x: Vector, P: Matrix, scratch: Scratch, height_m: float, known: bool, prior: Prior, noise: Noise
) -> float:
    """Update with an altitude, or begin with it; return the log likelihood."""
    r = prior.height_var_m2
    e, s = height_m - x[HEIGHT], P[HEIGHT][HEIGHT] + r
    found = log_likelihood(e, s, noise.outlier) if known else 0.0
    if known and e * e < _FAR_OFF * s:
        scratch.h[0] = 1.0
        condition_on(x, P, _ALTITUDE, scratch.h, height_m, r, noise.outlier, scratch.K)
    else:
        reset(x, P, HEIGHT, height_m, r)
    return found


@jit.kernel
def closed_balance(
    x: Vector,
    P: Matrix,
    scratch: Scratch,
    w: Window,
    c: Levers,
    closed: Closed,
    roll_share: float,
    noise: Noise,
) -> None:
    """Update all but the mass with a = u (F - J a) - g mu - g theta - c omega, where a gate hides a force.

    The gate is a retarder of known force, a bend, or the dwell after another gate.
    """
    hidden = closed.force_share * bounded_u(x, c) * w.force_N
    r = 2.0 * c.speed_var / (WINDOW_S * WINDOW_S)
    if w.retarding > 0.0:
        r += 25.0 * hidden * hidden
    else:
        roll = roll_share * w.roll_mps2
        r += 5.0 * (hidden * hidden + roll * roll) + 25.0 * w.bend_mps2 * w.bend_mps2
    h = scratch.h
    h[0], h[1] = GRAVITY_MPS2, w.drag_N_per_mps
    lever_u = -(w.force_N - w.rotating_kg * w.accel_mps2)
    z = -w.accel_mps2 - w.roll_mps2
    condition_all_but_mass(x, P, _SLOPE, h, lever_u, z, r, noise.outlier, scratch.K, scratch.a)


@jit.kernel
def coasting(
    x: Vector, P: Matrix, scratch: Scratch, w: Window, closed: Closed, road: Road, noise: Noise
) -> float:
    """Update with a coasting whose middle lies some metres back: how steep that place was.

    a (1 + u J) = u F - g mu - g theta - c omega, F without traction, J the wheels alone. Where it denies
    the grade, the road has become another while nothing was measured of it. Returns the log likelihood.
    """
    back_m = w.coast_back_s * w.speed_mps
    r = w.coast_var + closed.drag_mps2 * closed.drag_mps2
    r += GRAVITY_MPS2 * GRAVITY_MPS2 * road.roughness_1pm * abs(back_m)
    z = -w.coast_mps2 - w.roll_mps2
    lever = w.coast_kg * w.coast_mps2 - w.coast_N
    off = (z - lever * x[U]) / GRAVITY_MPS2 - x[GRADE] + back_m * x[CURVATURE]
    if off * off > noise.outlier * (P[GRADE][GRADE] + r / (GRAVITY_MPS2 * GRAVITY_MPS2)):
        P[GRADE][GRADE] += off * off
    h = scratch.h
    h[0], h[1], h[2], h[3] = GRAVITY_MPS2, -GRAVITY_MPS2 * back_m, w.drag_N_per_mps, lever
    e, s = condition_on(x, P, _COASTED, h, z, r, noise.outlier, scratch.K)
    found: float = log_likelihood(e, s, noise.outlier)
    return found


@jit.kernel
def has_coasted(w: Window, closed: Closed) -> bool:
    """Return whether the window ends a coasting that was here."""
    back_m = w.coast_back_s * w.speed_mps
    return not math.isnan(w.coast_mps2) and -20.0 <= back_m < closed.far_m
