"""Measurements: the row h of each, its variance r, and the update with it (docs/theory.md, section 4)."""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.model import Ends, Mixture, Scratch, Window
from canest.estimators.default.predict import column, moments, restore, widen
from canest.estimators.default.update import condition_on, judge
from canest.estimators.windowing import WINDOW_S

_SENSED = (m.GRADE, m.BIAS, m.PITCH)
_GAINED = (m.GRADE, m.BIAS, m.PITCH, m.V, m.BEGIN, m.DELAY, m.WINDUP)
_SPEED = (m.V, m.DELAY, m.WINDUP)
_ALTITUDE = (m.HEIGHT,)
_BALANCE = (m.GRADE, m.WIND, m.U, m.OFFSET)
_COASTED = (m.GRADE, m.CURVATURE, m.WIND, m.U)
_MAP = (m.GRADE, m.ROLLING, m.CURVATURE)
#: modes in which a speed tells no delay, and those in which closed gates tell no mass and no pitch
_HIDES_DELAY, _HIDES_MASS, _HIDES_PITCH = m.ANSWERS, m.EVERYWHERE, m.EVERYWHERE
#: bounds of the delay at which its lever is taken, s
_LEVER_DELAY_S = 0.1
#: share of the longest delay at which one counts as bounded: updates move it between two exchanges
_AT_BOUND = 0.95
#: mean square of the share of a windup that its lag does not tell: any between none and all
_MISSED = 1.0 / 3.0
#: variance of a speed that no known force has led to, (m/s)2
UNKNOWN_V = 1e4
#: an altitude this many variances off begins anew
_FAR_OFF = 25.0


@jit.kernel
def mean_of(weight: Any, count: int, values: Any) -> float:
    """Return the mean of a column."""
    mean = 0.0
    for d in range(count):
        mean += weight[d] * values[d]
    return mean


@jit.kernel
def mean_delay(mix: Mixture, count: int, u: float) -> float:
    """Return the delay of the torque beyond the usual one, s. u: mean inverse mass."""
    return mean_of(mix.weight, count, column(mix.x[:, m.DELAY], count)) / u


@jit.kernel
def bound_delay(mix: Mixture, count: int, c: Constants, v: Vehicle) -> None:
    """Bring delays beyond the longest back to it, and weigh the densities by how far off they were.

    x <- x + P_i (bound - x_i) / P_ii: the most probable state within the bound.
    """
    i, total = m.DELAY, 0.0
    for d in range(count):
        x, P = mix.x[d], mix.P[d]
        most = c.longest_delay_s * min(max(x[m.U], v.least_u), v.most_u)
        beyond = x[i] - min(max(x[i], -most), most)
        if beyond != 0.0:
            mix.weight[d] *= math.exp(-min(0.5 * c.likelihood_power * beyond * beyond / P[i, i], 30.0))
            x -= P[i] * (beyond / P[i, i])
        total += mix.weight[d]
    for d in range(count):
        mix.weight[d] /= total


@jit.kernel
def delay_is_too_long(delay_s: float, c: Constants) -> bool:
    """Return whether the delay is at its bound, so that it may be longer."""
    return abs(delay_s) > _AT_BOUND * c.longest_delay_s


@jit.kernel
def slow_traction(before_N: float, w: Window, dt: float) -> float:
    """Return the traction F_s that follows F_t with a lag of 0.2 s, at the end of a window.

    before_N: at its begin. F_t goes in a line from begin to end.
    """
    ramp_N = (w.traction_N - w.begin_N) * WINDOW_S / dt
    return w.traction_N - ramp_N + (before_N - w.begin_N + ramp_N) * math.exp(-dt / WINDOW_S)


@jit.kernel
def momentum_speed(w: Window, ratio: float, undriven: bool) -> float:
    """Return the speed of all that moves, (v_undriven + u J v_driven) / (1 + u J). ratio: u J.

    The body goes as an undriven axle does, and what rotates as the driven wheels do, which slip and wind up.
    """
    return (w.undriven_mps + ratio * w.speed_mps) / (1.0 + ratio) if undriven else w.speed_mps


@jit.kernel
def ends_at(speed_mps: float, tractions_N: tuple[float, float], ratio: float, undriven: bool) -> Ends:
    """Return what is measured at one moment. tractions_N: F_t and F_s (`slow_traction`). ratio: u J."""
    moving_N, slow_N = tractions_N[0] / (1.0 + ratio), tractions_N[1] / (1.0 + ratio)
    slips = 0.0 if undriven else 1.0 / (1.0 + ratio)
    return Ends(speed_mps, moving_N, (moving_N - slow_N) / WINDOW_S, slips)


@jit.kernel
def speed(
    mix: Mixture, count: int, end: Ends, u: float, r: float, c: Constants, v: Vehicle, t: Scratch
) -> None:
    """Update with a speed: v_measured (1 - k_lambda u F_m / (1 + u J)) = v + delta F_m + gamma Fdot.

    The slip is that of driven wheels, where the speed is theirs. F_m of the delay: that halfway through it.
    u: mean inverse mass.
    """
    moments(mix, count, m.DELAY, t.columns[0], t.columns[1])
    delay_s = mean_of(mix.weight, count, t.columns[0]) / u
    half_s = 0.5 * min(max(delay_s, -_LEVER_DELAY_S), _LEVER_DELAY_S)
    h = 1.0, end.traction_N + half_s * end.traction_Nps, end.traction_Nps
    slip = v.slip_per_mps2 * u * end.traction_N * end.slips
    condition_on(mix, count, _SPEED, h, end.speed_mps * (1.0 - slip), r, c.outlier_nis, t)
    restore(mix, count, m.DELAY, t.columns[0], t.columns[1], _HIDES_DELAY)


@jit.kernel
def windup_var(mix: Mixture, count: int, end: Ends) -> float:
    """Return the variance of a speed by what a lag does not tell of the course of a windup, (m/s)2."""
    wound_mps = mean_of(mix.weight, count, column(mix.x[:, m.WINDUP], count)) * end.traction_Nps
    return _MISSED * wound_mps * wound_mps


@jit.kernel
def no_noise_explains(missing_mps: float, var: float, c: Constants) -> bool:
    """Return whether an innovation is a gross one: the road has a step there."""
    return missing_mps * missing_mps > c.gross_nis * var


@jit.kernel
def learn_open(
    mix: Mixture, count: int, answers: tuple[float, float], lever: float, r: float, level: float,
    c: Constants, t: Scratch,
) -> tuple[float, float, float]:  # fmt: skip
    """Weigh the hypotheses by an open window's speed and torque.

    Returns the means of NIS and of its surplus, and the innovation over its standard deviation, mean.

    answers: see `answer_log_likelihood`, on a smooth and a rough road. lever: grade per m/s that is missing.
    level: the part of r that follows innovations. Where no noise explains an innovation the road has a step,
    and the speed is what was measured.
    """
    nis, surplus = judge(mix, count, r, level, c, t)
    innovation = 0.0
    for d in range(count):
        mode, missing = mix.mode[d], t.e[d]
        innovation += mix.weight[d] * missing / math.sqrt(t.s[d])
        mix.found[d] += answers[int(m.IS_ROUGH[mode])] * m.ANSWERS[mode]
        if no_noise_explains(missing, t.s[d], c):
            step = missing * lever
            mix.P[d, m.GRADE, m.GRADE] += min(step * step, c.grade_std * c.grade_std)
            mix.P[d, m.V, m.V] += missing * missing
    return nis, surplus, innovation


@jit.kernel
def felt_var(w: Window, gained: bool, speed_var: float, dt: float, u: float, v: Vehicle) -> float:
    """Return the variance of what an accelerometer is compared with, beside its own noise, (m/s2)2.

    Of what a body does that its pitch does not tell; and of two speeds where the states do not know the one
    gained, or, between two reports of a slow signal, of what the traction changed. u: mean inverse mass.
    """
    rocks = v.rocking * w.accel_mps2 * w.accel_mps2
    if v.period_windows > 1.0:  # then the level has the noise of two speeds
        changed = u * (w.traction_N - w.begin_N)
        return rocks + changed * changed
    return rocks if gained else rocks + 2.0 * speed_var / (dt * dt)


@jit.kernel
def gain_is_known(is_open: bool, v: Vehicle) -> bool:
    """Return whether the states know the speed gained in a window: its force is known, not only a line."""
    return is_open and v.period_windows <= 1.0


@jit.kernel
def row_of_gain(before: Ends, end: Ends, dt: float, v: Vehicle) -> tuple[float, float, float, float]:
    """Return the row of a window's mean acceleration, (v - v_0 + delta dF_m + chi gamma dFdot) / dt."""
    jump_N, jump_Nps = end.traction_N - before.traction_N, end.traction_Nps - before.traction_Nps
    return 1.0 / dt, -1.0 / dt, jump_N / dt, v.felt_windup * jump_Nps / dt


@jit.kernel
def accelerometer(
    mix: Mixture, count: int, gained: bool, felt: tuple[float, ...], dt: float, var: tuple[float, float],
    c: Constants, t: Scratch,
) -> float:  # fmt: skip
    """Update with an accelerometer: a_x = g theta + b + (1 + p) dv/dt. Returns the surplus of var[0].

    gained: the states know dv/dt; else that of the speeds is subtracted, and p keeps its density: an error of
    theirs is in what is subtracted and in what p is multiplied with, and would teach a negative p.
    felt: what is left of a_x, the dv/dt of p, and the `row_of_gain`. var: variance of a window of 0.2 s, and
    see `felt_var`.
    """
    widen(mix, count, m.BIAS, c.bias_wander_m2ps5 * dt, m.EVERYWHERE)
    r = var[0] * WINDOW_S / dt
    if gained:
        condition_on(
            mix, count, _GAINED, (GRAVITY_MPS2, 1.0, *felt[1:]), felt[0], r + var[1], c.outlier_nis, t
        )
    else:
        moments(mix, count, m.PITCH, t.columns[0], t.columns[1])
        condition_on(mix, count, _SENSED, (GRAVITY_MPS2, 1.0, felt[1]), felt[0], r + var[1], c.outlier_nis, t)
        restore(mix, count, m.PITCH, t.columns[0], t.columns[1], _HIDES_PITCH)
    return judge(mix, count, r + var[1], r, c, t)[1] * dt / WINDOW_S


@jit.kernel
def altitude(mix: Mixture, count: int, height_m: float, known: bool, c: Constants, t: Scratch) -> None:
    """Update with an altitude; what is known of the height is given up for the first, and for one far off."""
    r = c.altitude_std_m * c.altitude_std_m
    moments(mix, count, m.HEIGHT, t.columns[0], t.columns[1])
    e = height_m - mean_of(mix.weight, count, t.columns[0])
    far = e * e > _FAR_OFF * (mean_of(mix.weight, count, t.columns[1]) + r)
    if far or not known:
        widen(mix, count, m.HEIGHT, 1e6, m.EVERYWHERE)
        for d in range(count):
            mix.x[d, m.HEIGHT] += e
    condition_on(mix, count, _ALTITUDE, (1.0,), height_m, r, c.outlier_nis, t)
    if known and not far:
        judge(mix, count, r, r, c, t)


@jit.kernel
def gained(
    mix: Mixture, count: int, w: Window, speed_var: float, u: float, c: Constants, t: Scratch
) -> tuple[float, float]:
    """Return the acceleration by two speeds when the traction acted, dv/dt - delta dF_m/dt, and variance."""
    means, variances = t.columns[0], t.columns[1]
    moments(mix, count, m.DELAY, means, variances)
    delay = mean_of(mix.weight, count, means)
    for d in range(count):
        variances[d] += (means[d] - delay) * (means[d] - delay)
    moved = (w.traction_N - w.begin_N) / (WINDOW_S * (1.0 + u * w.rotating_kg))
    by_delay = c.hidden_windows * mean_of(mix.weight, count, variances) * moved * moved
    return w.accel_mps2 - delay * moved, 2.0 * speed_var / (WINDOW_S * WINDOW_S) + by_delay


@jit.kernel
def closed_balance(
    mix: Mixture, count: int, w: Window, speed_var: float, u: float, c: Constants, t: Scratch
) -> None:
    """Update all but u with g theta + c omega + G xi - u (F - J a) = -a - g mu, where a gate hides a force.

    A force known to a tenth must not teach a mass: u takes part with its uncertainty and keeps its density.
    """
    accel_mps2, accel_var = gained(mix, count, w, speed_var, u, c, t)
    hidden = c.hidden_force_share * u * w.force_N
    r = c.hidden_windows * (hidden * hidden + w.bend_mps2 * w.bend_mps2) + accel_var
    h = GRAVITY_MPS2, w.drag_N_per_mps, w.rotating_kg * accel_mps2 - w.force_N, w.gear_1pm
    moments(mix, count, m.U, t.columns[0], t.columns[1])
    condition_on(mix, count, _BALANCE, h, -accel_mps2 - w.roll_mps2, r, c.outlier_nis, t)
    restore(mix, count, m.U, t.columns[0], t.columns[1], _HIDES_MASS)


@jit.kernel
def coasting(mix: Mixture, count: int, w: Window, c: Constants, t: Scratch) -> None:
    """Update with a coasting whose middle lies d metres back: how steep that place was.

    g (theta - d kappa) + c omega + u (J_w a - F) = -a - g mu, F without traction, J_w the wheels alone.
    """
    back_m = w.coast_back_s * w.speed_mps
    r = w.coast_var + c.coasting_std_mps2 * c.coasting_std_mps2
    by_u = w.coast_kg * w.coast_mps2 - w.coast_N
    h = GRAVITY_MPS2, -GRAVITY_MPS2 * back_m, w.drag_N_per_mps, by_u
    condition_on(mix, count, _COASTED, h, -w.coast_mps2 - w.roll_mps2, r, c.outlier_nis, t)
    judge(mix, count, r, r, c, t)


@jit.kernel
def mapped_slope(
    mix: Mixture, count: int, sine: float, half_m: float, r: float, c: Constants, t: Scratch
) -> None:
    """Update with a road map: z = theta + d kappa - rho at a window's end, half of it beyond theta."""
    condition_on(mix, count, _MAP, (1.0, -1.0, half_m), sine, r, c.outlier_nis, t)
    judge(mix, count, r, r, c, t)
