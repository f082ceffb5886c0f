"""The filter of `canest`: momentum, height and the accelerometer, window by window, on two kinds of road.

Newton's law divided by the mass is linear in the inverse mass u = 1/M, so the filter is exact; mass never
enters a linearisation:

    dq/dt = u F - g mu - g theta - c omega         F known forces, c = 2 F_aero / v, omega = u x wind
    q = (1 + u J) v                                J mass of what rotates, in this gear
    v measured = v + delta T + sigma v T + gamma dA/dt
                                                   delta = u x delay left, sigma = u x slip, T traction and
                                                   A = T / (1 + u J) what of it reaches the axle
    undriven speed = v measured - sigma v T - lag dv/dt - scale v
    accelerometer - dv/dt = g theta + bias + p dv/dt - late d2v/dt2
    dtheta/ds = kappa                              grade lives in distance, not in time; see `canest_roads`
    dh/ds = theta,  altitude = h

A driveline that winds up adds what it gives way (r2 / stiffness = gamma) to the speed in front of it, where
the engine turns: that part of the momentum needs no correction.

Integrated over a window the first line is a momentum balance, free of the colour that filters give to
accelerations. The rotating mass J stays on the left: a measured acceleration in the force would carry
noise that looks like force which moves nothing, and so like mass (errors in variables).

States that a closed gate must not move are only considered (Schmidt): their covariance widens what else is
learned, their values stay as they are to the last bit.

Plain scalar Python on lists, or the same source compiled on arrays (`canest.core.jit`).
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2, LOADING_S
from canest.estimators.canest_0_1.axle import UNDRIVEN_EVERY, slip_seen
from canest.estimators.canest_0_1.coarse import coarse_grade, surer
from canest.estimators.canest_0_1.coast import coasted_here, doubt_road, note, roll_back, rolling_grade, shows
from canest.estimators.canest_0_1.doubt import (
    begin_stretch,
    credit,
    follow,
    forget,
    last,
    leans,
    proven,
    stand,
    steady_hand,
    surprise,
    unload,
)
from canest.estimators.canest_0_1.filter import correct, hold_within, push, reopen, start, travel
from canest.estimators.canest_0_1.hearing import hears
from canest.estimators.canest_0_1.noise import follow_swing, level, ring, surplus, tally, unknown_force
from canest.estimators.canest_0_1.recall import give_mass, refute, remember
from canest.estimators.canest_0_1.roads import blend, drive_on, likelihood, weigh
from canest.estimators.canest_0_1.senses import HEIGHT_WANDER, SEE_EVERY, climb, feel, retard
from canest.estimators.canest_0_1.states import (
    AXLE_SLIP,
    CALM_MPS,
    COAST_BACK_M,
    COAST_VAR,
    COUNT,
    CURVATURE,
    CURVED,
    DEAF,
    DELAY,
    GRADE,
    HAS_HEIGHT,
    HEIGHT,
    LAST_MPS2,
    LEARNED,
    OUT_CURVATURE,
    OUT_GRADE,
    OUT_GRADE_VAR,
    OUT_LEARNED,
    OUT_PROVEN,
    OUT_STANDING_S,
    OUT_STEADY_MPS2,
    OUT_U,
    OUT_U_VAR,
    PRESSED,
    SAME_U,
    SAME_VAR,
    SENSED_VAR,
    SINCE,
    SLIP,
    SPEED_VAR,
    STANDING_S,
    STEADY_N,
    STRAIGHT,
    SWING_VAR,
    UNSEEN,
    WIND,
    WINDUP,
    Q,
    U,
)
from canest.estimators.windowing import WINDOW_S

Container = Any  #: list interpreted, array compiled

_G = GRAVITY_MPS2
#: a straight is not quite straight: variance of the grade per metre, (0.1 % in 100 m)^2, as on a motorway
_ROUGHNESS = 1e-8
#: after a gap this long nobody knows how high the road has led, s
_LOST_S = 60.0
#: mass changes little by little (fuel, snow): relative variance per metre, (1 % in 10 km)^2
_MASS_DRIFT = 1e-8
#: weight of the newest window in the calm speed; all of it in the first windows of a balance
_CALM, _FRESH = 0.02, 3.0
#: slower than this the pulses of a speed sensor are too rare to tell an acceleration, m/s
_MOVING_MPS = 2.0
#: the delay of reported torque changes from frame to frame by a part of its 20 ms cycle
_JITTER_S = 0.004
#: the remaining delay is trusted to, s; the inverse mass is taken for it at least this share of its prior std
_DELAY_S, _LEAST_SHARE = 0.1, 0.1
#: what surprises may be a curve this much beyond its prior variance
_SHARPER = 9.0
#: share of its prior variance by which a new load changes delay, slip, bias and pitch
_LOOSER = 0.1


@jit.kernel
def run(
    n: int,
    windows: Container,
    X: Container,
    PP: Container,
    weight: Container,
    y: Container,
    Y: Container,
    memory: Container,
    prior: Container,
    floors: Container,
    loudest: float,
    torque_std: float,
    lightest: float,
    heaviest: float,
    w: Container,
    out: Container,
) -> None:
    """Filter n windows, the rows of `canest_windows.COLUMNS`; out[k] holds what is known after window k.

    X, PP, weight: states, covariances and probability of the filter for each kind of road. y, Y: the undriven
    axle's own. loudest: most that a speed's noise can be, std. lightest, heaviest: bounds of the mass.
    w: scratch, as long as a state vector.
    """
    gap_s, distance, before, before_N = windows[0], windows[1], windows[2], windows[3]
    before_rate, speed, force, traction = windows[4], windows[5], windows[6], windows[7]
    traction_rate, roll, accel, drag = windows[8], windows[9], windows[10], windows[11]
    gear, rotating, undriven, sensed = windows[12], windows[13], windows[14], windows[15]
    altitude, open_, retarding, stopped = windows[16], windows[17], windows[18], windows[19]
    coarse, bend = windows[20], windows[21]
    coast_mps2, coast_var, coast_N = windows[22], windows[23], windows[24]
    coast_kg, coast_back_s = windows[25], windows[26]
    curvature_var, wind_var = prior[CURVATURE] * prior[CURVATURE], prior[WIND] * prior[WIND]
    least = _LEAST_SHARE * prior[U]
    lowest, highest = 1.0 / heaviest, 1.0 / lightest
    for k in range(n):
        v, t, a, J = speed[k], traction[k], accel[k], rotating[k]
        ds = distance[k]
        is_open = open_[k] > 0.0
        # -- what happened since the window before
        stood_s = memory[STANDING_S]
        standing = stand(memory, gap_s[k], stopped[k] > 0.0, ds)
        loaded = stood_s < LOADING_S <= standing
        if gap_s[k] > 0.0:
            memory[SINCE] = 0.0
            ds += gap_s[k] * max(v, 0.0)
            if gap_s[k] > _LOST_S:
                memory[HAS_HEIGHT] = 0.0
        drive_on(X, PP, weight, memory, ds, wind_var, curvature_var)
        if loaded:
            remember(memory)
            unload(memory)
            Y[AXLE_SLIP][AXLE_SLIP] += _LOOSER * prior[SLIP] * prior[SLIP] + y[AXLE_SLIP] * y[AXLE_SLIP]
        # the road has a step, or the load has changed where nobody saw it: let the next seconds tell
        surprised, again = surprise(memory, ds)
        if again:
            refute(memory)
        was_deaf = memory[DEAF]
        feels = hears(memory, sensed[k], a, v > _MOVING_MPS, floors[0])
        memory[COAST_BACK_M] += ds
        coasted = note(memory, coast_mps2[k], coast_var[k], coast_N[k], coast_kg[k], coast_back_s[k] * v)
        # -- what both filters share of this window
        begins = is_open and memory[SINCE] == 0.0
        calm = v
        if is_open:
            calm = before[k] if begins else memory[CALM_MPS]
            memory[SINCE] += 1.0
        began = calm
        if is_open:
            # errors in variables: levers must not carry the noise that their innovation meets, or what
            # they lift drifts; so they take a calm speed (an instrument), the innovation the measured one
            calm += max(_CALM, min(1.0, _FRESH / memory[SINCE])) * (v - calm)
            memory[CALM_MPS] = calm
        else:
            memory[SINCE] = 0.0
        torque_rate = (t - before_N[k]) / WINDOW_S
        moved = abs(t - before_N[k])
        unknown = unknown_force(t, moved, torque_std * gear[k], drag[k])
        high = memory[HAS_HEIGHT] > 0.0
        uneven, fuel = _ROUGHNESS * ds, _MASS_DRIFT * ds
        if memory[SAME_VAR] > 0.0:
            memory[SAME_VAR] += fuel * memory[SAME_U] * memory[SAME_U]
        wander = HEIGHT_WANDER * (WINDOW_S + gap_s[k])
        speed_var = memory[SPEED_VAR]
        slip_z = slip_r = 0.0
        if is_open and undriven[k] == undriven[k] and (memory[COUNT] + 1.0) % UNDRIVEN_EVERY == 0.0:
            slip_z, slip_r = slip_seen(y, Y, w, memory, floors[2], v - undriven[k], calm, t, a)
        memory[UNSEEN] += 1.0
        sees = feels and stopped[k] == 0.0 and memory[UNSEEN] >= SEE_EVERY
        if memory[DEAF] < was_deaf:  # it works again: from now on torque tells anew
            forget(memory)
            refute(memory)
        if sees:
            memory[UNSEEN] = 0.0
        climbs = altitude[k] == altitude[k]
        u = max(weight[STRAIGHT] * X[STRAIGHT][U] + weight[CURVED] * X[CURVED][U], least)
        rings = ring(memory, t if begins else moved, u * J)
        swing_var = memory[SWING_VAR] * rings
        steepens = prior[CURVATURE] * calm
        # force that follows the road may widen what else is learned, and moves no mass; an accelerometer
        # feels the road that a steady hand follows
        follows = leans(memory, t) or (not feels and steady_hand(memory, u, force[k], steepens))
        rolled = is_open and coasted_here(memory)
        # -- each filter by itself
        odds = 0.0  # log-likelihood of a straight less that of a curve
        speed_surplus = sensed_surplus = bias = nis = pressed = settles = 0.0
        for m in (STRAIGHT, CURVED):
            x, P = X[m], PP[m]
            told = 0.0
            speed_found = sensed_found = found = found2 = 0.0
            if ds > 0.0:
                travel(x, P, ds, m == CURVED, high, uneven)
                P[U][U] += fuel * x[U] * x[U]
            if high:
                P[HEIGHT][HEIGHT] += wander
            if loaded:
                reopen(x, P, prior, prior[U], _LOOSER)
            if again:
                P[U][U] += x[U] * x[U]
            if surprised:
                P[GRADE][GRADE] += prior[GRADE] * prior[GRADE]
                if m == CURVED:
                    P[CURVATURE][CURVATURE] += _SHARPER * curvature_var
            motion = a
            if coasted:
                doubt_road(x, P, memory, roll[k], drag[k])
            if rolled:
                told += roll_back(x, P, w, memory, roll[k], drag[k], _ROUGHNESS)
            if is_open:
                inverse = max(x[U], least)
                # the delay's lever is the traction halfway through it (second order in the delay)
                half = 0.5 * min(max(x[DELAY] / inverse, -_DELAY_S), _DELAY_S)
                whole = 1.0 + inverse * J
                if begins:
                    rate = before_rate[k]
                    late = before_N[k] + half * rate
                    start(x, P, began, speed_var + swing_var, before_N[k], late, rate / whole, J, whole)
                motion = (x[U] * force[k] - roll[k] - _G * x[GRADE]) / whole
                push(x, P, force[k], roll[k], drag[k], inverse * inverse * unknown * WINDOW_S)
                late = t + half * traction_rate[k]
                jitter = inverse * traction_rate[k] * _JITTER_S
                z = v + J * (v - calm) * x[U]
                r = (speed_var + swing_var + jitter * jitter) * whole * whole
                kept, kept_var = x[U], P[U][U]
                e, s = correct(
                    x, P, w, 0, z, r,
                    Q, 1.0, DELAY, late * whole, SLIP, calm * t * whole, U, -J * calm,
                    WINDUP, traction_rate[k] / whole,
                )  # fmt: skip
                if follows:
                    x[U], P[U][U] = kept, kept_var
                told += likelihood(e, s)
                speed_found = surplus(e / whole, s / (whole * whole), speed_var + swing_var)
                found, found2 = e / math.sqrt(s), e * e / s
                if slip_r > 0.0:
                    correct(
                        x, P, w, 0, slip_z, slip_r,
                        SLIP, 1.0, Q, 0.0, Q, 0.0, Q, 0.0, Q, 0.0,
                    )  # fmt: skip
                # or an endless mass on a straight road would explain every cruise
                settles += weight[m] * min(P[U][U] / kept_var, 1.0)
                pressed += weight[m] * hold_within(x, P, U, lowest, highest)
            elif retarding[k] > 0.0:
                retard(x, P, w, force[k], J, a, roll[k], drag[k], speed_var)
            if sees:
                felt, sensed_found = feel(
                    x, P, w, memory, is_open, sensed[k], a, motion, calm, t, torque_rate
                )
                told += felt
            if climbs:
                told += climb(x, P, w, is_open, high, altitude[k])
            odds += told if m == STRAIGHT else -told
            share = weight[m]
            speed_surplus += share * speed_found
            sensed_surplus += share * sensed_found
            bias += share * found
            nis += share * found2
        # -- what they learned together
        if is_open:
            # what is louder is no noise, but a model that is wrong
            noise = level(speed_var, speed_surplus, floors[0], memory[COUNT])
            memory[SPEED_VAR] = min(noise, loudest * loudest)
            if swing_var > speed_var:
                follow_swing(memory, speed_surplus / rings)
            if sees:
                memory[SENSED_VAR] = level(memory[SENSED_VAR], sensed_surplus, floors[1], memory[COUNT])
            memory[LEARNED] = 1.0
            memory[PRESSED] = settles * memory[PRESSED] + pressed
            first_of_all = begins and memory[COUNT] == 0.0
            if rolled and shows(memory):  # the road has been seen here
                begin_stretch(memory)
            credit(memory, u, force[k], steepens, first_of_all, feels, ds)
            tally(memory, bias, nis)
            if t > 0.0:  # in overrun it may as well be a brake that nobody reports
                follow(memory, bias)
        if climbs:
            memory[HAS_HEIGHT] = 1.0
        memory[LAST_MPS2] = a
        weigh(weight, odds, 0.0)
        row = out[k]
        mean = blend(X, PP, weight, memory, is_open, row)
        u_var = row[OUT_U_VAR]
        give_mass(memory, row, mean, is_open, prior[U] * prior[U])
        if is_open:
            memory[COAST_VAR] = 0.0
            last(memory, mean)
        wind = weight[STRAIGHT] * X[STRAIGHT][WIND] + weight[CURVED] * X[CURVED][WIND]
        seen = seen_var = 0.0
        if coarse[k] > 0.0:
            seen, seen_var = coarse_grade(
                mean, u_var, wind, force[k], J, a, roll[k], drag[k], bend[k], memory[SPEED_VAR]
            )
        elif coasted:
            seen, seen_var = rolling_grade(
                memory, mean, u_var, wind, roll[k], drag[k], row[OUT_CURVATURE], wind_var
            )
        row[OUT_GRADE], row[OUT_GRADE_VAR] = surer(
            memory, row[OUT_GRADE], row[OUT_GRADE_VAR], is_open, seen, seen_var
        )
        row[OUT_LEARNED] = memory[LEARNED]
        row[OUT_STANDING_S] = memory[STANDING_S] * stopped[k]
        row[OUT_STEADY_MPS2] = row[OUT_U] * memory[STEADY_N]
        row[OUT_PROVEN] = proven(memory)
