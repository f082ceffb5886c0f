"""The filter of `canest`: one Kalman filter over momentum, height and the accelerometer, window by window.

Newton's law divided by the mass is linear in the inverse mass u = 1/M, so the filter is exact and forgets
its start value; mass never enters a linearisation:

    dq/dt = u F - g mu - g theta - c omega         F known forces, c = 2 F_aero / v, omega = u x wind
    q = (1 + u J) v                                J mass of what rotates, in this gear
    v measured = v + delta T + sigma v T           delta = u x delay left, sigma = u x slip, T traction
    undriven speed = v measured - sigma v T - lag dv/dt - scale v
    accelerometer - dv/dt = g theta + bias + p dv/dt
    dtheta/ds = kappa,  dkappa/ds = -kappa / L + noise      grade lives in distance, not in time
    dh/ds = theta,  altitude = h

Integrated over a window the first line is a momentum balance, free of the colour that filters give to
accelerations. The rotating mass J stays on the left: a measured acceleration in the force would carry
noise that looks like force which moves nothing, and so like mass (errors in variables).

States that a closed gate must not move are only considered (Schmidt): their covariance widens what else is
learned, their values stay as they are to the last bit.

Plain scalar Python on lists, or the same source compiled on arrays (`canest.fast`).
"""

from __future__ import annotations

import math
from typing import Any

from canest import fast
from canest.estimators.canest_windows import WINDOW_S
from canest.vehicle.samples import GRAVITY_MPS2

Container = Any  #: list interpreted, array compiled

# states; those below FREE are the driveline's, which closed gates freeze
Q, U, DELAY, SLIP, LAG, SCALE, WIND = range(7)
GRADE, CURVATURE, BIAS, PITCH, HEIGHT = range(7, 12)
FREE = GRADE
STATES = 12

# carried beside the states
(
    SINCE,  # windows since the momentum balance began, 0 where it must begin anew
    STANDING_S,
    HAS_HEIGHT,
    LEARNED,
    SPEED_VAR,
    SENSED_VAR,
    UNDRIVEN_VAR,
    BIASED,  # running mean of the normalised innovation
    COUNT,
    NIS_SUM,
    POSITIVE,
    RUNS,
    SIGN,
    CALM_MPS,  # speed without its recent noise
    EFFORT,  # integral of the squared acceleration since mass was opened, m2/s3
) = range(15)
MEMORY = 15

# one window's outputs
OUT_U, OUT_U_VAR, OUT_GRADE, OUT_CURVATURE, OUT_GRADE_VAR, OUT_LEARNED, OUT_STANDING_S, OUT_EFFORT = range(8)
OUTPUTS = 8

_G = GRAVITY_MPS2
#: distance over which vertical curves last, m
_CURVE_M = 100.0
#: distance over which the wind along the road changes, m
_WIND_M = 5000.0
#: drift of a GPS altitude beyond its noise, m2 per m; and the std of one reading, m
_HEIGHT_DRIFT, _HEIGHT_STD_M = 0.004, 2.5
#: force that the model lacks: share of the traction, correlated over this time (torque holes, oscillation);
#: more in overrun, where friction torque is coarse and brakes blend in
_FORCE_SHARE, _OVERRUN_SHARE, _FORCE_S = 0.02, 0.1, 0.2
#: a retarder's force is known to this share, for as long as it brakes
_RETARDER_SHARE, _RETARDER_WINDOWS = 0.1, 25.0
#: mass changes little by little (fuel, snow): relative variance per metre, (1 % in 10 km)^2
_MASS_DRIFT = 1e-8
#: weight of the newest window in the calm speed; all of it in the first windows of a balance
_CALM, _FRESH = 0.02, 3.0
#: slip is learned from every so many windows: wheel speeds come at 10 Hz and it changes slowly
_UNDRIVEN_EVERY = 5.0
#: the delay of reported torque changes from frame to frame by a part of its 20 ms cycle
_JITTER_S = 0.004
#: the remaining delay is trusted to, s; the inverse mass is taken for it at least this share of its prior std
_DELAY_S, _LEAST_SHARE = 0.1, 0.1
#: a vehicle that stands this long may have been loaded
_LOADING_S = 30.0
#: share of its prior variance by which a new load changes delay, slip, bias and pitch
_LOOSER = 0.1
#: innovations beyond this many squared stds count as outliers and weigh less (Huber)
_OUTLIER = 9.0
#: memory of the noise levels and of the innovations' sign, in windows
_NOISE_MEMORY, _NOISE_START, _SIGN_MEMORY = 300.0, 10.0, 15.0
#: innovations this one-signed for seconds open mass (by this share) and grade again
_ONE_SIGNED, _CLIP, _DOUBT = 1.5, 5.0, 0.3


@fast.kernel
def correct(
    x: Container,
    P: Container,
    active: Container,
    w: Container,
    first: int,
    z: float,
    r: float,
    i0: int,
    h0: float,
    i1: int,
    h1: float,
    i2: int,
    h2: float,
    i3: int,
    h3: float,
) -> tuple[float, float]:
    """Measure z = h0 x[i0] + ... + h3 x[i3] + noise of variance r; move only the states from `first` on.

    Kalman update in the symmetric form P -= w w', w = P h / sqrt(s); for states before `first` the gain is
    zero and their block of P stays (Schmidt-Kalman). Returns the innovation and its variance.
    """
    p0, p1, p2, p3 = P[i0], P[i1], P[i2], P[i3]
    for i in active:
        w[i] = h0 * p0[i] + h1 * p1[i] + h2 * p2[i] + h3 * p3[i]
    s = max(r + h0 * w[i0] + h1 * w[i1] + h2 * w[i2] + h3 * w[i3], r)
    e = z - h0 * x[i0] - h1 * x[i1] - h2 * x[i2] - h3 * x[i3]
    weight = max(s, e * e / _OUTLIER)
    root = 1.0 / math.sqrt(weight)
    for i in active:
        w[i] *= root
    gain = e * root
    for i in active:
        wi = w[i]
        row = P[i]
        if i >= first:
            x[i] += gain * wi
            for j in active:
                row[j] -= wi * w[j]
        else:
            for j in active:
                if j >= first:
                    row[j] -= wi * w[j]
    return e, s


@fast.kernel
def widen(P: Container, active: Container, i: int, variance: float) -> None:
    """Forget state i: only its variance is left."""
    for j in active:
        P[i][j] = 0.0
        P[j][i] = 0.0
    P[i][i] = variance


@fast.kernel
def travel(
    x: Container, P: Container, active: Container, ds: float, curvature_var: float, wind_var: float
) -> None:
    """Move `ds` metres along the road: height, grade, curvature, wind."""
    keep = math.exp(-ds / _CURVE_M)
    calm = math.exp(-ds / _WIND_M)
    x[HEIGHT] += ds * x[GRADE]
    x[GRADE] += ds * x[CURVATURE]
    x[CURVATURE] *= keep
    x[WIND] *= calm
    for i in active:
        row = P[i]
        row[HEIGHT] += ds * row[GRADE]
        row[GRADE] += ds * row[CURVATURE]
        row[CURVATURE] *= keep
        row[WIND] *= calm
    height, grade, curve, wind = P[HEIGHT], P[GRADE], P[CURVATURE], P[WIND]
    for j in active:
        height[j] += ds * grade[j]
        grade[j] += ds * curve[j]
        curve[j] *= keep
        wind[j] *= calm
    q = curvature_var * (1.0 - keep * keep)
    curve[CURVATURE] += q
    cross = 0.5 * q * ds
    grade[CURVATURE] += cross
    curve[GRADE] += cross
    grade[GRADE] += q * ds * ds / 3.0
    wind[WIND] += wind_var * (1.0 - calm * calm)
    height[HEIGHT] += _HEIGHT_DRIFT * ds
    P[U][U] += _MASS_DRIFT * ds * x[U] * x[U]


@fast.kernel
def push(
    x: Container, P: Container, active: Container, force: float, roll: float, drag: float, noise: float
) -> None:
    """Add a window's momentum per mass: dq = dt (u F - g mu - g theta - c omega) + noise."""
    fu = WINDOW_S * force
    fg = -WINDOW_S * _G
    fw = -WINDOW_S * drag
    x[Q] += fu * x[U] + fg * x[GRADE] + fw * x[WIND] - WINDOW_S * roll
    for i in active:
        row = P[i]
        row[Q] += fu * row[U] + fg * row[GRADE] + fw * row[WIND]
    momentum, inverse, grade, wind = P[Q], P[U], P[GRADE], P[WIND]
    for j in active:
        momentum[j] += fu * inverse[j] + fg * grade[j] + fw * wind[j]
    momentum[Q] += noise


@fast.kernel
def start(
    x: Container,
    P: Container,
    active: Container,
    z: float,
    r: float,
    t: float,
    late: float,
    rotating: float,
    whole: float,
) -> None:
    """Begin a balance at the measured speed: q = z + u J z - (1 + u J) (delta T + sigma z T + noise r)."""
    hd, hs, hu = -late * whole, -z * t * whole, rotating * z
    x[Q] = z + hd * x[DELAY] + hs * x[SLIP] + hu * x[U]
    delay, slip, inverse = P[DELAY], P[SLIP], P[U]
    for j in active:
        P[Q][j] = hd * delay[j] + hs * slip[j] + hu * inverse[j]
    for j in active:
        P[j][Q] = P[Q][j]
    P[Q][Q] = r * whole * whole + hd * P[Q][DELAY] + hs * P[Q][SLIP] + hu * P[Q][U]


@fast.kernel
def reopen(x: Container, P: Container, prior: Container, std: float) -> None:
    """The load may have changed, u by `std`: what is a product with u goes along, less sure than before."""
    for i in (U, DELAY, SLIP, WIND):
        for j in (U, DELAY, SLIP, WIND):
            P[i][j] += std * std * (x[i] / x[U]) * (x[j] / x[U])
    for i in (DELAY, SLIP, BIAS, PITCH):
        P[i][i] += _LOOSER * prior[i] * prior[i]


@fast.kernel
def level(variance: float, e: float, s: float, floor: float, count: float) -> float:
    """Follow a noise level: the innovation's square less what the states explain of it.

    The memory grows with the count of measurements so far, so that a wrong first guess is soon forgotten.
    """
    surplus = min(e * e, _OUTLIER * s) - s
    return max(floor * floor, variance + surplus / min(_NOISE_MEMORY, _NOISE_START + count))


@fast.kernel
def tally(memory: Container, e: float, s: float) -> None:
    """Count the normalised innovation squared, its signs and runs (Wald and Wolfowitz 1940)."""
    memory[COUNT] += 1.0
    memory[NIS_SUM] += e * e / s
    sign = 1.0 if e > 0.0 else -1.0
    if sign > 0.0:
        memory[POSITIVE] += 1.0
    if sign != memory[SIGN]:
        memory[RUNS] += 1.0
    memory[SIGN] = sign


@fast.kernel
def run(
    n: int,
    windows: Container,
    x: Container,
    P: Container,
    memory: Container,
    active: Container,
    prior: Container,
    floors: Container,
    torque_std: float,
    w: Container,
    out: Container,
) -> None:
    """Filter n windows, the rows of `canest_windows.COLUMNS`; out[k] holds what is known after window k.

    w is scratch space of STATES numbers.
    """
    gap_s, distance, before, before_N, before_rate = (
        windows[0],
        windows[1],
        windows[2],
        windows[3],
        windows[4],
    )
    speed, force, traction, traction_rate, roll = windows[5], windows[6], windows[7], windows[8], windows[9]
    accel, drag, gear, rotating, undriven = windows[10], windows[11], windows[12], windows[13], windows[14]
    sensed, altitude = windows[15], windows[16]
    open_, retarding, stopped = windows[17], windows[18], windows[19]
    curvature_var = prior[CURVATURE] * prior[CURVATURE]
    wind_var = prior[WIND] * prior[WIND]
    for k in range(n):
        v = speed[k]
        t = traction[k]
        ds = distance[k]
        a = accel[k]
        standing = memory[STANDING_S] + gap_s[k] + stopped[k] * WINDOW_S
        if gap_s[k] > 0.0:
            memory[SINCE] = 0.0
            ds += gap_s[k] * max(v, 0.0)
        if ds > 0.0:
            travel(x, P, active, ds, curvature_var, wind_var)
        if memory[STANDING_S] < _LOADING_S <= standing:
            reopen(x, P, prior, prior[U])
            memory[EFFORT] = 0.0
        if abs(memory[BIASED]) > _ONE_SIGNED:
            # the load has changed where nobody saw it, or the road has a step: let the next seconds tell
            P[U][U] += _DOUBT * _DOUBT * x[U] * x[U]
            P[GRADE][GRADE] += prior[GRADE] * prior[GRADE]
            memory[BIASED] = 0.0
        memory[STANDING_S] = standing * stopped[k]
        if open_[k] > 0.0:
            first = 0
            inverse = max(x[U], _LEAST_SHARE * prior[U])
            # the delay's lever is the traction halfway through it (second order in the delay)
            half = 0.5 * min(max(x[DELAY] / inverse, -_DELAY_S), _DELAY_S)
            whole = 1.0 + inverse * rotating[k]
            calm = memory[CALM_MPS]
            if memory[SINCE] == 0.0:
                calm = before[k]
                late = before_N[k] + half * before_rate[k]
                start(x, P, active, calm, memory[SPEED_VAR], before_N[k], late, rotating[k], whole)
            memory[SINCE] += 1.0
            # errors in variables: levers must not carry the noise that their innovation meets, or what
            # they lift drifts; so they take a calm speed (an instrument), the innovation the measured one
            motion = (x[U] * force[k] - roll[k] - _G * x[GRADE]) / whole
            calm += max(_CALM, min(1.0, _FRESH / memory[SINCE])) * (v - calm)
            memory[CALM_MPS] = calm
            lacking = _FORCE_SHARE * t if t > 0.0 else -_OVERRUN_SHARE * t
            unknown = inverse * (torque_std * gear[k] + lacking)
            push(x, P, active, force[k], roll[k], drag[k], unknown * unknown * _FORCE_S * WINDOW_S)
            late = t + half * traction_rate[k]
            jitter = inverse * traction_rate[k] * _JITTER_S
            z = v + rotating[k] * (v - calm) * x[U]
            r = (memory[SPEED_VAR] + jitter * jitter) * whole * whole
            e, s = correct(
                x, P, active, w, 0, z, r,
                Q, 1.0, DELAY, late * whole, SLIP, calm * t * whole, U, -rotating[k] * calm,
            )  # fmt: skip
            memory[SPEED_VAR] = level(memory[SPEED_VAR], e / whole, s / whole**2, floors[0], memory[COUNT])
            memory[LEARNED] = 1.0
            memory[EFFORT] += a * a * WINDOW_S
            tally(memory, e, s)
            if t > 0.0:  # in overrun it may as well be a brake that nobody reports
                z = min(max(e / math.sqrt(s), -_CLIP), _CLIP)
                memory[BIASED] += (z - memory[BIASED]) / _SIGN_MEMORY
            if undriven[k] == undriven[k] and memory[COUNT] % _UNDRIVEN_EVERY == 0.0:
                e, s = correct(
                    x, P, active, w, 0, v - undriven[k], memory[UNDRIVEN_VAR],
                    SLIP, calm * t, LAG, a, SCALE, calm, Q, 0.0,
                )  # fmt: skip
                memory[UNDRIVEN_VAR] = level(
                    memory[UNDRIVEN_VAR], e, s, floors[2], memory[COUNT] / _UNDRIVEN_EVERY
                )
        else:
            first = FREE
            memory[SINCE] = 0.0
            calm = v
            motion = a
            if retarding[k] > 0.0:
                unknown = _RETARDER_SHARE * x[U] * force[k]
                r = 2.0 * memory[SPEED_VAR] / (WINDOW_S * WINDOW_S) + _RETARDER_WINDOWS * unknown * unknown
                net = force[k] - rotating[k] * a
                correct(x, P, active, w, FREE, -a - roll[k], r, GRADE, _G, U, -net, WIND, drag[k], Q, 0.0)
        if sensed[k] == sensed[k] and stopped[k] == 0.0:
            r = memory[SENSED_VAR]
            slip = calm * (t - before_N[k]) / WINDOW_S + t * motion
            if first > 0:  # the torque reported in a shift is not that of the wheels
                r += slip * slip * (x[SLIP] * x[SLIP] + P[SLIP][SLIP])
            e, s = correct(
                x, P, active, w, first, sensed[k] - a, r, GRADE, _G, BIAS, 1.0, PITCH, motion, SLIP, -slip
            )
            if first == 0:
                memory[SENSED_VAR] = level(memory[SENSED_VAR], e, s, floors[1], memory[COUNT])
        if altitude[k] == altitude[k]:
            if memory[HAS_HEIGHT] > 0.0:
                correct(
                    x, P, active, w, first, altitude[k], _HEIGHT_STD_M * _HEIGHT_STD_M,
                    HEIGHT, 1.0, Q, 0.0, Q, 0.0, Q, 0.0,
                )  # fmt: skip
            else:
                widen(P, active, HEIGHT, _HEIGHT_STD_M * _HEIGHT_STD_M)
                x[HEIGHT] = altitude[k]
                memory[HAS_HEIGHT] = 1.0
        row = out[k]
        row[OUT_U] = x[U]
        row[OUT_U_VAR] = P[U][U]
        row[OUT_GRADE] = x[GRADE]
        row[OUT_CURVATURE] = x[CURVATURE]
        row[OUT_GRADE_VAR] = P[GRADE][GRADE]
        row[OUT_LEARNED] = memory[LEARNED]
        row[OUT_STANDING_S] = memory[STANDING_S]
        row[OUT_EFFORT] = memory[EFFORT]
