"""Clutch, twisting shafts, wheels and tyres: what is integrated at 1 kHz.

Semi-implicit Euler: velocities first, positions with the new velocities.
"""

from __future__ import annotations

import math

from canest.core.jit import kernel
from canest.simulation.constants import (
    BRAKE,
    CLOSED,
    CRANK_TORQUE,
    DEMAND,
    DISTANCE,
    ENGAGED,
    ENGINE_SPEED,
    GEAR,
    GRAVITY,
    INDICATED,
    LAUNCH,
    MASS,
    NEUTRAL,
    PHASE,
    RAMP_IN,
    SPEED,
    STANDING,
    STEP_S,
    STEPS_PER_RECORD,
    WHEEL_SPEED,
    WHEEL_TORQUE,
)
from canest.simulation.driver_pedals import FULL_BRAKE_G
from canest.simulation.parameters import VehicleParameters
from canest.simulation.states import (
    CEILING,
    CLUTCH_TORQUE,
    DAMPING,
    DRAG,
    EFFICIENCY,
    FIXED,
    FRICTION,
    HIGHEST,
    INERTIA,
    INPUT_SPEED,
    PHASE_S,
    RATIO,
    SINCE_SHIFT_S,
    SLIP_GAIN,
    STIFFNESS,
    TAKEN,
    TORQUE_PER_FORCE,
    TWIST,
    State,
)

# All chosen.
CLUTCH_GAIN_1PS = 8.0  #: the clutch takes what brings the engine to ...
LAUNCH_IDLE = 1.5  #: ... this multiple of the idle speed
CLUTCH_DRAG = 0.2  #: torque of a clutch that pulls the engine up, share of full torque
STALL_IDLE = 0.5  #: an engine does not fall below this multiple of the idle speed
LOCKING_RADPS = 2.0  #: slip below which the clutch closes ...
LOCKING_IDLE = 0.9  #: ... above this multiple of the idle speed


@kernel
def set_driveline(vehicle: VehicleParameters, x: State) -> None:
    """Set the driveline for gear and mass: twist of two inertias, and what shafts carry.

    k = K / i^2, J = (m r^2 + J_w) / i^2, d = 2 D sqrt(k J_e J / (J_e + J)).
    """
    p = vehicle.driveline
    gear = int(x[GEAR])
    mass = x[MASS]
    radius = p.wheel_radius
    engine = vehicle.engine.inertia
    ratio = vehicle.gearbox.ratios[gear]
    declared = vehicle.gearbox.efficiencies[gear]
    stiffness = p.stiffness / (ratio * ratio)
    body = (mass * radius * radius + p.wheel_inertia) / (ratio * ratio)
    x[RATIO] = ratio
    x[EFFICIENCY] = declared * p.kept[gear]
    x[TORQUE_PER_FORCE] = radius / (ratio * declared)
    x[STIFFNESS] = stiffness
    x[DAMPING] = 2.0 * p.damping * math.sqrt(stiffness * engine * body / (engine + body))
    x[INERTIA] = mass + p.wheel_inertia / (radius * radius)
    x[SLIP_GAIN] = p.slip / (radius * mass)


@kernel
def change_gear(x: State, before: float) -> None:
    """Reset what a change from the phase ``before`` resets: the twist, or the input speed in a new gear."""
    phase = x[PHASE]
    if before == NEUTRAL and phase == RAMP_IN:
        x[TWIST] = 0.0
    elif before == STANDING and phase != STANDING:
        x[INPUT_SPEED] = x[WHEEL_SPEED] * x[RATIO]


@kernel
def integrate(vehicle: VehicleParameters, x: State) -> None:
    """Move for 5 ms.

    J_e dw = gain (T - T_f) - T_taken - T_c; (m + J_w / r^2) dv = T_w / r - F.
    """
    engine = vehicle.engine
    gain, inertia_e = engine.gain, engine.inertia
    fuel = STEP_S / engine.fuelling_s
    slipping_from = LAUNCH_IDLE * engine.idle
    wind = vehicle.resistance.wind
    radius = vehicle.driveline.wheel_radius
    demand, friction, taken = x[DEMAND], x[FRICTION], x[TAKEN]
    ratio, efficiency, slip_gain = x[RATIO], x[EFFICIENCY], x[SLIP_GAIN]
    kc, cc, inertia = x[STIFFNESS], x[DAMPING], x[INERTIA]
    fixed, drag = x[FIXED], x[DRAG]
    brake_force = x[BRAKE] * x[MASS] * GRAVITY * FULL_BRAKE_G
    twisting = x[PHASE] in CLOSED
    launching = x[PHASE] == LAUNCH
    v, s, theta = x[SPEED], x[DISTANCE], x[TWIST]
    we, ww, win = x[ENGINE_SPEED], x[WHEEL_SPEED], x[INPUT_SPEED]
    torque, tw, tc, crank = x[INDICATED], x[WHEEL_TORQUE], x[CLUTCH_TORQUE], x[CRANK_TORQUE]
    for _ in range(STEPS_PER_RECORD):
        torque += (demand - torque) * fuel
        crank = gain * (torque - friction) - taken
        if twisting:
            tc = kc * theta + cc * (we - win)
        elif launching:
            capacity = torque - friction - taken + CLUTCH_GAIN_1PS * inertia_e * (we - slipping_from)
            # a slipping clutch pulls both ways: it speeds up an engine that has fallen behind
            tc = min(max(0.0, capacity), x[CEILING] - friction) if we > win else -(CLUTCH_DRAG * x[HIGHEST])
        else:
            tc = 0.0
        tw = tc * ratio * efficiency if tc > 0.0 else tc * ratio / efficiency
        we += (crank - tc) / inertia_e * STEP_S
        air = v + wind
        v += (tw / radius - fixed - drag * air * abs(air) - brake_force) / inertia * STEP_S
        v = 0.0 if v < 0.0 else v
        s += v * STEP_S
        ww = v * (1.0 + slip_gain * tw) / radius
        win = ww * ratio
        if twisting:
            theta += (we - win) * STEP_S
    if not engine.electric and we < STALL_IDLE * engine.idle:
        we = STALL_IDLE * engine.idle
    x[SPEED], x[DISTANCE], x[TWIST] = v, s, theta
    x[ENGINE_SPEED], x[WHEEL_SPEED], x[INPUT_SPEED] = we, ww, win
    x[INDICATED], x[WHEEL_TORQUE], x[CLUTCH_TORQUE], x[CRANK_TORQUE] = torque, tw, tc, crank


@kernel
def clutch_locks(idle: float, x: State) -> bool:
    """Return whether a launch is over. idle: of the engine (rad/s)."""
    slip = abs(x[INPUT_SPEED] - x[ENGINE_SPEED])
    return slip < LOCKING_RADPS and x[INPUT_SPEED] > LOCKING_IDLE * idle


@kernel
def lock(x: State) -> None:
    """Close the clutch after a launch, the shafts wound up by its torque."""
    x[PHASE] = ENGAGED
    x[PHASE_S] = 0.0
    x[SINCE_SHIFT_S] = 0.0
    x[TWIST] = x[CLUTCH_TORQUE] / x[STIFFNESS]
