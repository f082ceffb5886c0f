"""Clutch, twisting shafts, wheels and tyres: what is integrated at 1 kHz.

Semi-implicit Euler: velocities first, positions with the new velocities.
"""

from __future__ import annotations

import math

from canest.core.jit import kernel
from canest.simulation.constants import (
    CLOSED,
    ENGAGED,
    GRAVITY,
    LAUNCH,
    NEUTRAL,
    RAMP_IN,
    STANDING,
    STEP_S,
    STEPS_PER_RECORD,
)
from canest.simulation.driver_pedals import FULL_BRAKE_G
from canest.simulation.parameters import VehicleParameters
from canest.simulation.states import CrankTorques, Driveline, GearboxState, Motion, Resistance

# All chosen.
CLUTCH_GAIN_1PS = 8.0  #: the clutch takes what brings the engine to ...
LAUNCH_IDLE = 1.5  #: ... this multiple of the idle speed
CLUTCH_DRAG = 0.2  #: torque of a clutch that pulls the engine up, share of full torque
STALL_IDLE = 0.5  #: an engine does not fall below this multiple of the idle speed
LOCKING_RADPS = 2.0  #: slip below which the clutch closes ...
LOCKING_IDLE = 0.9  #: ... above this multiple of the idle speed


@kernel
def driveline_in(vehicle: VehicleParameters, gear: int, mass: float) -> Driveline:
    """Return the driveline in a gear with a mass (kg): twist of two inertias, and what shafts carry.

    k = K / i^2, J = (m r^2 + J_w) / i^2, d = 2 D sqrt(k J_e J / (J_e + J)).
    """
    p = vehicle.driveline
    radius = p.wheel_radius
    engine = vehicle.engine.inertia
    ratio = vehicle.gearbox.ratios[gear]
    declared = vehicle.gearbox.efficiencies[gear]
    stiffness = p.stiffness / (ratio * ratio)
    body = (mass * radius * radius + p.wheel_inertia) / (ratio * ratio)
    damping = 2.0 * p.damping * math.sqrt(stiffness * engine * body / (engine + body))
    inertia = mass + p.wheel_inertia / (radius * radius)
    return Driveline(
        gear, mass, ratio, declared * p.kept[gear], radius / (ratio * declared), stiffness, damping, inertia,
        p.slip / (radius * mass),
    )  # fmt: skip


@kernel
def engaged_anew(motion: Motion, before: int, after: int, ratio: float) -> Motion:
    """Return the motion with what a change of phase resets: the twist, or the input speed in a new gear."""
    input_speed = motion.input_speed
    twist = motion.twist
    if before == NEUTRAL and after == RAMP_IN:
        twist = 0.0
    elif before == STANDING and after != STANDING:
        input_speed = motion.wheel_speed * ratio
    else:
        return motion
    return Motion(
        motion.speed, motion.distance, motion.engine_speed, motion.wheel_speed, input_speed, twist,
        motion.torque, motion.clutch_torque, motion.wheel_torque, motion.crank_torque,
    )  # fmt: skip


@kernel
def integrate(
    vehicle: VehicleParameters, motion: Motion, driveline: Driveline, phase: int, torques: CrankTorques,
    resistance: Resistance, brake: float,
) -> Motion:  # fmt: skip
    """Return the motion 5 ms later.

    J_e dw = gain (T - T_f) - T_taken - T_c; (m + J_w / r^2) dv = T_w / r - F. brake: 0..1.
    """
    v, s, we, ww, win, theta, torque, tc, tw, crank = motion
    demand, friction, taken, ceiling, highest = torques
    engine = vehicle.engine
    gain = engine.gain
    inertia_e = engine.inertia
    fuel = STEP_S / engine.fuelling_s
    slipping_from = LAUNCH_IDLE * engine.idle
    wind = vehicle.resistance.wind
    radius = vehicle.driveline.wheel_radius
    _, mass, ratio, efficiency, _, kc, cc, inertia, slip_gain = driveline
    fixed, drag, _ = resistance
    brake_force = brake * mass * GRAVITY * FULL_BRAKE_G
    twisting = phase in CLOSED
    launching = phase == LAUNCH
    for _ in range(STEPS_PER_RECORD):
        torque += (demand - torque) * fuel
        crank = gain * (torque - friction) - taken
        if twisting:
            tc = kc * theta + cc * (we - win)
        elif launching:
            capacity = torque - friction - taken + CLUTCH_GAIN_1PS * inertia_e * (we - slipping_from)
            # a slipping clutch pulls both ways: it speeds up an engine that has fallen behind
            tc = min(max(0.0, capacity), ceiling - friction) if we > win else -(CLUTCH_DRAG * highest)
        else:
            tc = 0.0
        tw = tc * ratio * efficiency if tc > 0.0 else tc * ratio / efficiency
        we += (crank - tc) / inertia_e * STEP_S
        air = v + wind
        v += (tw / radius - fixed - drag * air * abs(air) - brake_force) / inertia * STEP_S
        v = max(v, 0.0)
        s += v * STEP_S
        ww = v * (1.0 + slip_gain * tw) / radius
        win = ww * ratio
        if twisting:
            theta += (we - win) * STEP_S
    if not engine.electric and we < STALL_IDLE * engine.idle:
        we = STALL_IDLE * engine.idle
    return Motion(v, s, we, ww, win, theta, torque, tc, tw, crank)


@kernel
def clutch_locks(idle: float, motion: Motion) -> bool:
    """Return whether a launch is over. idle: of the engine (rad/s)."""
    slip = abs(motion.input_speed - motion.engine_speed)
    return slip < LOCKING_RADPS and motion.input_speed > LOCKING_IDLE * idle


@kernel
def locked(gearbox: GearboxState) -> GearboxState:
    """Return the gearbox with the clutch closed after a launch."""
    return GearboxState(ENGAGED, gearbox.gear, gearbox.next_gear, 0.0, 0.0)


@kernel
def wound_up(motion: Motion, stiffness: float) -> Motion:
    """Return the motion with the twist that carries the clutch's torque."""
    v, s, we, ww, win, _, torque, tc, tw, crank = motion
    return Motion(v, s, we, ww, win, tc / stiffness, torque, tc, tw, crank)
