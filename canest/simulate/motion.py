"""The truth's motion: engine, clutch, driveline twist, tyres and body at 1 kHz, led by driver and gearbox.

One scalar kernel and the few that it calls, interpreted as they stand or compiled by numba. Physics run at
1 kHz (semi-implicit Euler: velocities first, positions with the new velocities), driver, gearbox and records
at 200 Hz.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core.jit import kernel
from canest.simulate.constants import GRAVITY
from canest.simulate.gearbox import gear_for, starting_gear
from canest.simulate.pedals import accelerate, slow_down


@kernel
def move(
    c: Any, full: Any, ratios: Any, etas: Any, kept: Any, grades: Any, curvatures: Any, target: Any,
    throttle: Any, crr_extra: Any, drag_scale: Any, load_on: Any, mass_t: Any, mass_kg: Any, out: Any,
) -> None:  # fmt: skip
    """Move the vehicle and fill `out`, flat: one row of `COLUMNS` every 5 ms.

    full: full torque (N m) every 25 rpm. ratios: crank to wheels, per gear; etas: efficiency, kept: share of
    the traction that hidden losses leave. grades, curvatures: every metre. target (m/s), throttle (negative:
    none), crr_extra, drag_scale, load_on: every 0.1 s. mass_t, mass_kg: changes, at the next standstill.
    """
    dt = 0.001
    gravity = GRAVITY
    road_end = len(grades) - 2
    full_end = len(full) - 1
    records = len(out) // 20
    to_table = 60.0 / (2.0 * math.pi) / 25.0
    electric = c.idle == 0.0
    radius = c.radius
    mass_next = 1
    m = mass_kg[0]

    v = c.start_mps
    s = 0.0
    gear = int(c.start_gear)
    ratio = ratios[gear]
    moving = v > 0.5 or electric
    phase = 0 if moving else 5
    we = v / radius * ratio if moving else c.idle
    ww = v / radius
    win = ww * ratio
    theta = 0.0
    boost = 0.0
    t_ind = c.friction_0 + c.friction_w * we
    pedal = 0.0
    brake = 0.0
    braking = False
    lifted = False
    pushed = False
    retarder = 0.0
    hidden_retarder = 0.0
    phase_s = 0.0
    since_shift = 10.0
    next_gear = gear
    ramp = 1.0
    resisted = 0.0
    pitch = 0.0
    pitch_rate = 0.0
    tw = 0.0
    tc = 0.0
    capacity = 0.0
    demand = t_ind
    slip_gain = c.slip / (radius * m)

    for k in range(records):
        # what the plan, the road and the cargo say
        j = k // 20
        wanted = target[j]
        foot = throttle[j]
        at = int(s)
        if at >= road_end:
            grade = grades[road_end]
            curvature = curvatures[road_end]
        else:
            part = s - at
            grade = grades[at] + (grades[at + 1] - grades[at]) * part
            curvature = curvatures[at] + (curvatures[at + 1] - curvatures[at]) * part
        if mass_next < len(mass_t) and k * 0.005 >= mass_t[mass_next] and v < 0.01:
            m = mass_kg[mass_next]
            mass_next += 1
            slip_gain = c.slip / (radius * m)
        cosine = 1.0 / math.sqrt(1.0 + grade * grade)
        crr = c.crr + crr_extra[j] + c.crr_per_mps * v
        lateral = v * v * curvature
        cornering = m * c.cornering * (lateral * lateral)
        fixed = m * gravity * (grade + crr) * cosine + cornering + c.drag_force
        drag = c.drag * drag_scale[j]
        air = v + c.wind
        resistance = fixed + drag * air * abs(air)
        resisted += (resistance - resisted) * 0.005 / 0.8  # what a driver has come to expect

        # full torque at this speed: the unboosted part at once, the rest as the turbo spools up
        x = we * to_table
        i = int(x)
        i = max(i, 0)
        highest = full[full_end] if i >= full_end else full[i] + (full[i + 1] - full[i]) * (x - i)
        friction = c.friction_0 + c.friction_w * we
        boost += (t_ind / (highest + 1.0) - boost) * 0.005 / c.boost_s
        boost = min(boost, 1.0)
        available = highest * (c.unboosted + (1.0 - c.unboosted) * boost * 1.05)
        available = min(available, highest)

        # driver: pedal and brake
        closed = phase in (0, 1, 3)
        per_force = radius / (ratio * etas[gear])  # crank torque per newton at the wheels
        least = -(friction + c.regeneration * (1.0 if v > 1.5 else v / 1.5)) / per_force if closed else 0.0
        pedal, short, lifted, pushed = accelerate(
            c, m, v, wanted, foot, resisted, per_force, least, friction, highest, pedal, lifted, pushed
        )
        ceiling = (resistance + m * c.accel_limit) * per_force + friction

        want_retarder = 0.0
        if c.uses_retarder > 0.0 and short > 0.0 and phase == 0 and we > 100.0 and not electric:
            want_retarder = min(c.retarder_max, short * per_force)
            short -= want_retarder / per_force
        retarder += (want_retarder - retarder) * 0.005 / 0.15
        if retarder < 1.0 and want_retarder == 0.0:
            retarder = 0.0
        brake, braking = slow_down(c, m, v, wanted, foot, short, brake, braking)
        brake_force = brake * m * gravity * 0.6
        want_hidden = 0.0
        if phase == 0 and we > 95.0:
            if pedal < 0.005:
                want_hidden = c.hidden_retarder_pedal
            if braking:
                want_hidden += c.hidden_retarder_brake
        hidden_retarder += (want_hidden - hidden_retarder) * 0.005 / 0.1

        # gearbox and clutch
        phase_s += 0.005
        since_shift += 0.005
        if phase == 0 and not electric:
            if win < 0.88 * c.idle:
                phase = 5
                phase_s = 0.0
            elif c.fixed_gear < 0.0 and since_shift > 1.2 and not braking and v > 0.5:
                next_gear = gear_for(c, full, ratios, etas, gear, we, win, pedal, resistance, m, i, to_table)
                if next_gear != gear:
                    phase = 1
                    phase_s = 0.0
        elif phase == 1:
            if phase_s >= c.ramp_s and (abs(tc) < 0.03 * highest + 5.0 or phase_s > 0.6):
                phase = 2
                phase_s = 0.0
                gear = next_gear
                ratio = ratios[gear]
        elif phase == 2:
            if phase_s >= c.neutral_s and abs(we - win) < 2.0:
                phase = 3
                phase_s = 0.0
                theta = 0.0
            elif phase_s > 4.0 or win < 0.88 * c.idle:
                phase = 5
                phase_s = 0.0
        elif phase == 3:
            if phase_s >= c.ramp_s:
                phase = 0
                phase_s = 0.0
                since_shift = 0.0
        elif phase == 4:
            if pedal < 0.005 and wanted < 0.05:
                phase = 5
        elif phase == 5 and pedal > 0.03 and brake < 0.3:
            if c.fixed_gear >= 0.0:
                gear = int(c.fixed_gear)
            else:
                gear = starting_gear(c, full, ratios, etas, v, resistance, m)
            ratio = ratios[gear]
            win = ww * ratio
            phase = 4 if win < c.idle * 1.25 else 2
            phase_s = 0.0

        # torque the engine is asked for
        kp = kept[gear]
        eta_drive = etas[gear] * kp
        if phase == 2 and not electric:
            demand = friction + c.engine_inertia * (win - we) / 0.1
            demand = min(0.6 * available, max(0.0, demand))
            ramp = 0.0
        elif phase == 5 and not electric:
            demand = friction
        else:
            asked = pedal * (highest + c.regeneration) - c.regeneration * (1.0 if v > 1.5 else v / 1.5)
            asked = min(asked, ceiling)
            if phase == 1:
                ramp = max(0.0, 1.0 - phase_s / c.ramp_s)
                asked = friction + (asked - friction) * ramp
            elif ramp < 1.0:
                ramp = min(1.0, ramp + 0.005 / (c.ramp_s * 1.5))
                asked = friction + (asked - friction) * ramp
            demand = asked
        if not electric:
            floor = friction + 25.0 * c.engine_inertia * (c.idle - we)
            if demand < floor and we < c.idle * 1.1:
                demand = floor
            demand = max(demand, 0.0)
        demand = min(demand, available)

        load = 0.0
        if load_on[j] > 0.0 and we > 10.0:
            power = c.load_power
            if c.load_cubic > 0.0:
                share = we / c.load_at
                power = power * (share * share * share)  # a power by numba has other bits
            # below its working speed a load takes less, and nothing that would stall the engine
            load = power / max(we, 1.5 * c.idle, 50.0)
            if not electric:
                load *= min(1.0, max(0.0, 2.0 * we / c.idle - 1.2))
        lost = c.torque_loss if we > 10.0 else 0.0
        taken = lost + load + retarder + hidden_retarder
        kc = c.stiffness / (ratio * ratio)
        body = (m * radius * radius + c.wheel_inertia) / (ratio * ratio)
        cc = 2.0 * c.damping * math.sqrt(kc * c.engine_inertia * body / (c.engine_inertia + body))
        inertial = m + c.wheel_inertia / (radius * radius)
        fuel = dt / c.fuelling_s
        twisting = phase in (0, 1, 3)
        launching = phase == 4
        drag_torque = 0.2 * highest
        v_before = v

        for _ in range(5):
            t_ind += (demand - t_ind) * fuel
            crank = c.gain * (t_ind - friction) - taken
            if twisting:
                tc = kc * theta + cc * (we - win)
            elif launching:
                capacity = t_ind - friction - taken + 8.0 * c.engine_inertia * (we - 1.5 * c.idle)
                # a slipping clutch pulls both ways: it speeds up an engine that has fallen behind
                tc = min(max(0.0, capacity), ceiling - friction) if we > win else -drag_torque
            else:
                tc = 0.0
            tw = tc * ratio * eta_drive if tc > 0.0 else tc * ratio / eta_drive
            we += (crank - tc) / c.engine_inertia * dt
            air = v + c.wind
            a = (tw / radius - fixed - drag * air * abs(air) - brake_force) / inertial
            v += a * dt
            v = max(v, 0.0)
            s += v * dt
            ww = v * (1.0 + slip_gain * tw) / radius
            win = ww * ratio
            if twisting:
                theta += (we - win) * dt
        if not electric and we < 0.5 * c.idle:
            we = 0.5 * c.idle
        if launching and abs(win - we) < 2.0 and win > 0.9 * c.idle:
            phase = 0
            phase_s = 0.0
            since_shift = 0.0
            theta = tc / kc

        a = (v - v_before) / 0.005
        pitch_rate += (
            c.pitch_w * c.pitch_w * (c.pitch_gain * a - pitch) - 0.7 * c.pitch_w * pitch_rate
        ) * 0.005
        pitch += pitch_rate * 0.005

        o = k * 20
        out[o] = v
        out[o + 1] = a
        out[o + 2] = s
        out[o + 3] = we
        out[o + 4] = ww
        out[o + 5] = t_ind
        out[o + 6] = demand
        out[o + 7] = tw
        out[o + 8] = pedal
        out[o + 9] = brake
        out[o + 10] = retarder
        out[o + 11] = gear
        out[o + 12] = phase
        slip = (we - win) / we if we > 1.0 and not twisting else 0.0
        out[o + 13] = min(1.0, max(0.0, slip))
        out[o + 14] = m
        out[o + 15] = load_on[j]
        out[o + 16] = pitch
        out[o + 17] = grade
        out[o + 18] = curvature
        out[o + 19] = crank
