"""Measurements: the row h of each, its variance r, and the update with it (docs/theory.md, section 4)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.constants import Constants
from canest.estimators.default.model import (
    BIAS,
    CURVATURE,
    DELAY,
    GRADE,
    HEIGHT,
    PITCH,
    ROLLING,
    WIND,
    WINDUP,
    Mixture,
    U,
    V,
    Window,
)
from canest.estimators.default.noise import surplus
from canest.estimators.default.predict import add_noise, column, reset, variances
from canest.estimators.default.update import (
    Innovation,
    add_log_likelihood,
    condition_all_but_mass,
    condition_on,
)
from canest.estimators.default.windows import WINDOW_S

_SPEED = (V, DELAY, WINDUP)
_SENSED = (GRADE, BIAS, PITCH)
_ALTITUDE = (HEIGHT,)
_SLOPE = (GRADE, WIND)
_COASTED = (GRADE, CURVATURE, WIND, U)
_MAP = (GRADE, ROLLING)
#: bounds of the delay at which its lever is taken, s
_LONGEST_DELAY_S = 0.1
#: an altitude this many variances off begins anew
_FAR_OFF = 25.0
#: what a body does that the pitch does not follow, share of the acceleration squared
_ROCKING = 0.01


class Scratch(NamedTuple):
    """Room to work in: rows, columns (one number per density), and what a measurement left."""

    h: Any  #: (8,) entries of a row
    f: Any  #: (3 * MOST,) gains of a prediction
    columns: Any  #: four columns
    loads: Any  #: (3 * LOADS,) weight, mean and variance of u of every load
    share: Any  #: (MODES * LOADS * MOST,)
    table: Any  #: (MODES * MODES,) transition probabilities
    left: Innovation


@jit.kernel
def weighted(weight: Any, count: int, values: Any) -> float:
    """Return the mean of a column."""
    mean = 0.0
    for d in range(count):
        mean += weight[d] * values[d]
    return mean


@jit.kernel
def mean_surplus(mix: Mixture, count: int, left: Innovation, r: float, c: Constants) -> float:
    """Return the mean of e^2 - s (see `noise.surplus`)."""
    mean = 0.0
    for d in range(count):
        mean += mix.weight[d] * surplus(left.e[d], left.s[d], r, c)
    return mean


@jit.kernel
def speed(mix: Mixture, count: int, w: Window, u: float, r: float, c: Constants, t: Scratch) -> None:
    """Update with the speed at the window's end: v measured = v + delta T + gamma dT/dt.

    The lever of the delay is the traction halfway through it. u: mean inverse mass.
    """
    column(mix.x, count, DELAY, t.columns[0])
    delay_s = weighted(mix.weight, count, t.columns[0]) / u
    half_s = 0.5 * min(max(delay_s, -_LONGEST_DELAY_S), _LONGEST_DELAY_S)
    t.h[0], t.h[1], t.h[2] = 1.0, w.traction_N + half_s * w.traction_Nps, w.traction_Nps
    condition_on(mix, count, _SPEED, t.h, w.speed_mps, r, c.outlier, t.left)


@jit.kernel
def accelerometer(
    mix: Mixture, count: int, w: Window, r: float, motion: float, c: Constants, t: Scratch
) -> float:
    """Update with an accelerometer: a_x - dv/dt = g theta + b + p dv/dt. Returns the mean surplus.

    motion: dv/dt by the model; while closed, that of the speed, whose error joins the noise.
    """
    for d in range(count):
        t.f[d] = c.bias_wander * 2.0 * WINDOW_S
    add_noise(mix, count, BIAS, t.f)
    own = r
    if w.open == 0.0:
        own += _ROCKING * w.accel_mps2 * w.accel_mps2
    t.h[0], t.h[1], t.h[2] = GRAVITY_MPS2, 1.0, motion
    condition_on(mix, count, _SENSED, t.h, w.sensed_mps2 - w.accel_mps2, own, c.outlier, t.left)
    add_log_likelihood(mix.found, count, t.left, own, c.floor)
    return mean_surplus(mix, count, t.left, r, c)


@jit.kernel
def altitude(mix: Mixture, count: int, height_m: float, known: bool, c: Constants, t: Scratch) -> None:
    """Update with an altitude; begin with the first one, and with one that is far off."""
    r = c.height_m * c.height_m
    t.h[0] = 1.0
    far = not known
    if known:
        column(mix.x, count, HEIGHT, t.columns[0])
        e = height_m - weighted(mix.weight, count, t.columns[0])
        variances(mix.P, count, HEIGHT, t.columns[0])
        far = e * e > _FAR_OFF * (weighted(mix.weight, count, t.columns[0]) + r)
    if far:
        reset(mix, count, HEIGHT, height_m, r)
    else:
        condition_on(mix, count, _ALTITUDE, t.h, height_m, r, c.outlier, t.left)
        add_log_likelihood(mix.found, count, t.left, r, c.floor)


@jit.kernel
def closed_balance(
    mix: Mixture, count: int, w: Window, speed_var: float, u: float, c: Constants, t: Scratch
) -> None:
    """Update all but the mass with g theta + c omega - u (F - J a) = -a - g mu, where a gate hides a force.

    The gate is a retarder of known force, a bend, or the dwell after another gate.
    """
    hidden = c.hidden_share * u * w.force_N
    hidden = hidden * hidden + w.bend_mps2 * w.bend_mps2
    r = 2.0 * speed_var / (WINDOW_S * WINDOW_S) + c.hidden_windows * hidden
    t.h[0], t.h[1] = GRAVITY_MPS2, w.drag_N_per_mps
    lever_u = -(w.force_N - w.rotating_kg * w.accel_mps2)
    z = -w.accel_mps2 - w.roll_mps2
    condition_all_but_mass(mix, count, _SLOPE, t.h, lever_u, z, r, c.outlier, t.left)


@jit.kernel
def coasting(mix: Mixture, count: int, w: Window, c: Constants, t: Scratch) -> None:
    """Update with a coasting whose middle lies d metres back: how steep that place was.

    g (theta - d kappa) + c omega + u (J_w a - F) = -a - g mu, F without traction, J_w the wheels alone.
    """
    back_m = w.coast_back_s * w.speed_mps
    r = w.coast_var + c.open_drag_mps2 * c.open_drag_mps2
    t.h[0], t.h[1] = GRAVITY_MPS2, -GRAVITY_MPS2 * back_m
    t.h[2], t.h[3] = w.drag_N_per_mps, w.coast_kg * w.coast_mps2 - w.coast_N
    condition_on(mix, count, _COASTED, t.h, -w.coast_mps2 - w.roll_mps2, r, c.outlier, t.left)
    add_log_likelihood(mix.found, count, t.left, r, c.floor)


@jit.kernel
def mapped_slope(mix: Mixture, count: int, sine: float, r: float, c: Constants, t: Scratch) -> None:
    """Update with the slope of a road map: z = theta - rho."""
    t.h[0], t.h[1] = 1.0, -1.0
    condition_on(mix, count, _MAP, t.h, sine, r, c.outlier, t.left)
    add_log_likelihood(mix.found, count, t.left, r, c.floor)
