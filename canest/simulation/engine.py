"""Engine and motor: what they can give (turbo lag), what is asked of them, what accessories take."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import (
    CLOSED,
    DEMAND,
    ENGINE_SPEED,
    INDICATED,
    MASS,
    NEUTRAL,
    PEDAL,
    PHASE,
    RAMP_OUT,
    RECORD_S,
    RPM,
    SPEED,
    STANDING,
    TORQUE_TABLE_RPM,
)
from canest.simulation.parameters import AccessoryParameters, EngineParameters, VehicleParameters
from canest.simulation.states import (
    AVAILABLE,
    BOOST,
    CEILING,
    FRICTION,
    HIGHEST,
    INPUT_SPEED,
    LEAST_FORCE,
    PEDAL_UP,
    PHASE_S,
    RELEASED,
    ROAD_LOAD,
    TORQUE_PER_FORCE,
    TORQUE_ROW,
    State,
)

# All chosen.
ROWS_PER_RADPS = RPM / TORQUE_TABLE_RPM  #: rows of the full-torque table
OVERBOOST = 1.05  #: full torque is reached a little before full boost
TINY_NM = 1.0  #: keeps a quotient of torques finite
REGENERATION_FADE_MPS = 1.5  #: a motor brakes less below it, and not at rest
MATCHING_S = 0.1  #: time in which the engine is brought to the speed of the next gear
MATCHING_SHARE = 0.6  #: of the available torque
RELEASE_RATIO = 1.5  #: torque comes back this much more slowly than it was taken away
IDLE_GAIN_1PS = 25.0  #: of the idle governor
IDLE_REACH = 1.1  #: the idle governor acts up to this multiple of the idle speed
TURNING_RADPS = 10.0  #: an engine slower than this drives no accessory
ACCESSORY_IDLE = 1.5  #: multiple of the idle speed below which an accessory takes less
ACCESSORY_RADPS = 50.0  #: the same where there is no idle speed
#: share of an accessory's torque by engine speed over idle speed: nothing that would stall the engine
CUT_IN_SLOPE, CUT_IN_OFFSET = 2.0, 1.2


@kernel
def set_operating_point(vehicle: VehicleParameters, x: State) -> None:
    """Set what the engine can give at its speed, in torque and in force, with the boost 5 ms later."""
    p = vehicle.engine
    speed = x[SPEED]
    engine_speed = x[ENGINE_SPEED]
    per_force = x[TORQUE_PER_FORCE]
    full = p.full_torque
    last = len(full) - 1
    at = engine_speed * ROWS_PER_RADPS
    row = int(at) if at > 0.0 else 0
    highest = full[last] if row >= last else full[row] + (full[row + 1] - full[row]) * (at - row)
    friction = p.friction_0 + p.friction_w * engine_speed
    # the unboosted part at once, the rest as the turbocharger spools up: it follows the load by a lag
    boost = x[BOOST]
    boost += (x[INDICATED] / (highest + TINY_NM) - boost) * RECORD_S / p.boost_s
    boost = 1.0 if boost > 1.0 else boost
    available = highest * (p.unboosted + (1.0 - p.unboosted) * boost * OVERBOOST)
    pedal_up = p.regeneration * (1.0 if speed > REGENERATION_FADE_MPS else speed / REGENERATION_FADE_MPS)
    x[BOOST] = boost
    x[FRICTION] = friction
    x[HIGHEST] = highest
    x[AVAILABLE] = highest if highest < available else available
    x[CEILING] = (x[ROAD_LOAD] + x[MASS] * vehicle.driver.accel_limit) * per_force + friction
    x[PEDAL_UP] = pedal_up
    x[LEAST_FORCE] = -(friction + pedal_up) / per_force if x[PHASE] in CLOSED else 0.0
    x[TORQUE_ROW] = row


@kernel
def set_demand(p: EngineParameters, x: State, ramp_s: float) -> None:
    """Set the indicated torque (N m) asked for by pedal, shift and idle governor, and its released share.

    ramp_s: time in which a shift takes the torque away.
    """
    friction = x[FRICTION]
    available = x[AVAILABLE]
    engine_speed = x[ENGINE_SPEED]
    phase = x[PHASE]
    if phase == NEUTRAL and not p.electric:
        demand = friction + p.inertia * (x[INPUT_SPEED] - engine_speed) / MATCHING_S
        demand = min(MATCHING_SHARE * available, max(0.0, demand))
        x[RELEASED] = 0.0
    elif phase == STANDING and not p.electric:
        demand = friction
    else:
        demand = x[PEDAL] * (x[HIGHEST] + p.regeneration) - x[PEDAL_UP]
        ceiling = x[CEILING]
        demand = ceiling if ceiling < demand else demand
        released = x[RELEASED]
        if phase == RAMP_OUT:
            released = max(0.0, 1.0 - x[PHASE_S] / ramp_s)
            demand = friction + (demand - friction) * released
        elif released < 1.0:
            released = min(1.0, released + RECORD_S / (ramp_s * RELEASE_RATIO))
            demand = friction + (demand - friction) * released
        x[RELEASED] = released
    if not p.electric:
        floor = friction + IDLE_GAIN_1PS * p.inertia * (p.idle - engine_speed)
        if demand < floor and engine_speed < p.idle * IDLE_REACH:
            demand = floor
        demand = 0.0 if demand < 0.0 else demand
    x[DEMAND] = available if available < demand else demand


@kernel
def accessory_torque(p: AccessoryParameters, on: float, speed: float) -> float:
    """Return the torque (N m) that loss and switched load take at an engine speed (rad/s)."""
    load = 0.0
    if on > 0.0 and speed > TURNING_RADPS:
        power = p.power
        if p.cubic:
            share = speed / p.rated_speed
            power = power * (share * share * share)  # a power by numba has other bits
        load = power / max(speed, ACCESSORY_IDLE * p.idle, ACCESSORY_RADPS)
        if not p.electric:
            load *= min(1.0, max(0.0, CUT_IN_SLOPE * speed / p.idle - CUT_IN_OFFSET))
    lost = p.torque_loss if speed > TURNING_RADPS else 0.0
    return lost + load
