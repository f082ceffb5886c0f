"""One window, one hypothesis: predict, update, and what the innovations say."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.constants import Constants
from canest.estimators.default.model import (
    CURVED_ANSWERED,
    CURVED_FREE,
    GRADE,
    HEIGHT,
    STRAIGHT_ANSWERED,
    WIND,
    Q,
    Window,
)
from canest.estimators.default.noise import surplus
from canest.estimators.default.predict import Matrix, Vector, accelerate, answer, drift, travel
from canest.estimators.default.road_map import known_slope
from canest.estimators.default.sensors import (
    Levers,
    Scratch,
    accelerometer,
    altitude,
    begin_balance,
    bounded_u,
    closed_balance,
    coasting,
    has_coasted,
    speed,
    speed_noise,
)
from canest.estimators.default.update import log_likelihood
from canest.estimators.default.windows import WINDOW_S


class Common(NamedTuple):
    """What all hypotheses share in one window."""

    levers: Levers
    begins: bool  #: the first open window after closed ones
    began_mps: float  #: slow speed before it
    metres: float  #: since the window before
    answers_kg: float  #: dF / g that the road may answer
    own_torque: float  #: log likelihood of the change of torque where the road answers, less where it is free
    force_density: float  #: of the force that the model lacks, N2 s
    height_known: bool
    sees: bool  #: the accelerometer is used
    accel_before: float
    seconds: float  #: of the window, and of the gap before it
    roll_share: float  #: std of the rolling resistance, as a share
    has_road: bool  #: a road map is used
    roughness_1pm: float  #: variance that the grade gains per metre


class Found(NamedTuple):
    """What one hypothesis has to say of a window."""

    log_likelihood: float
    nis: float  #: e^2 / s of the speed, zero while closed
    speed_surplus: float
    sensed_surplus: float
    innovation: float  #: of the speed, in stds, cut as the update cuts it


@jit.kernel
def predict(
    x: Vector, P: Matrix, m: int, drifting: bool, s: Scratch, w: Window, c: Common, k: Constants
) -> None:
    """Predict the road, the load and the height; the momentum follows where the gates are open."""
    if drifting:
        drift(x, P, s.h, s.K, c.seconds)
    if c.height_known:
        P[HEIGHT][HEIGHT] += k.road.height_wander_m2ps * (WINDOW_S + w.gap_s)
    if c.metres > 0.0:
        curved = m in (CURVED_FREE, CURVED_ANSWERED)
        travel(x, P, s.h, s.K, c.metres, curved, c.height_known, c.roughness_1pm)
    if c.answers_kg != 0.0 and m >= STRAIGHT_ANSWERED:
        scatter = k.driver.scatter_share * c.levers.mean_u * c.answers_kg
        answer(x, P, s.h, s.K, c.answers_kg, scatter)


@jit.kernel
def balance(x: Vector, P: Matrix, s: Scratch, w: Window, c: Common, k: Constants) -> Found:
    """Predict the momentum over an open window and update with the speed at its end."""
    if c.begins:
        begin_balance(x, P, s, w, c.levers, c.began_mps, k.noise)
    accelerate(x, P, s.h, s.K, WINDOW_S, w.force_N, w.roll_mps2, w.drag_N_per_mps)
    P[Q][Q] += c.levers.mean_u * c.levers.mean_u * c.force_density * WINDOW_S
    e, var = speed(x, P, s, w, c.levers, k.noise)
    nis = e * e / var
    if nis > k.road.step_nis:
        # no noise explains it: the road has a step here, and the speed is what was measured
        missing = e * (1.0 + bounded_u(x, c.levers) * w.rotating_kg)
        step = missing / (WINDOW_S * GRAVITY_MPS2)
        P[GRADE][GRADE] += min(step * step, k.prior.grade * k.prior.grade)
        P[Q][Q] += missing * missing
    most = math.sqrt(k.noise.outlier)
    cut = min(max(e / math.sqrt(var), -most), most)
    excess = surplus(e, var, speed_noise(w, c.levers, k.noise), k.noise)
    return Found(log_likelihood(e, var, k.noise.outlier), nis, excess, 0.0, cut)


@jit.kernel
def step(
    x: Vector, P: Matrix, m: int, drifting: bool, s: Scratch, w: Window, c: Common, k: Constants
) -> Found:
    """Take one window into the density (x, P) of mode m."""
    predict(x, P, m, drifting, s, w, c, k)
    found = c.own_torque if m >= STRAIGHT_ANSWERED else 0.0
    nis = speed_surplus = sensed_surplus = innovation = 0.0
    motion = w.accel_mps2
    if w.open > 0.0:
        u = bounded_u(x, c.levers)
        driven = u * w.force_N - w.roll_mps2 - GRAVITY_MPS2 * x[GRADE] - w.drag_N_per_mps * x[WIND]
        motion = driven / (1.0 + u * w.rotating_kg)
        likelihood, nis, speed_surplus, _, innovation = balance(x, P, s, w, c, k)
        found += likelihood
    elif w.retarding > 0.0 or w.coarse > 0.0:
        closed_balance(x, P, s, w, c.levers, k.closed, c.roll_share, k.noise)
    if not math.isnan(w.altitude_m):
        found += altitude(x, P, s, w.altitude_m, c.height_known, k.prior, k.noise)
    if c.sees:
        e, var, r = accelerometer(x, P, s, w, c.levers, motion, c.accel_before, k.prior, k.noise)
        found += log_likelihood(e, var, k.noise.outlier)
        sensed_surplus = surplus(e, var, r, k.noise)
    if c.has_road:
        found += known_slope(x, P, s.h, s.K, w, k.noise.outlier)
    if has_coasted(w, k.closed):
        found += coasting(x, P, s, w, k.closed, k.road, k.noise)
    return Found(found, nis, speed_surplus, sensed_surplus, innovation)
