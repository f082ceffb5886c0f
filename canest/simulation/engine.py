"""Engine and motor: what they can give (turbo lag), what is asked of them, what accessories take."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import CLOSED, NEUTRAL, RAMP_OUT, RECORD_S, RPM, STANDING, TORQUE_TABLE_RPM
from canest.simulation.parameters import AccessoryParameters, EngineParameters, VehicleParameters
from canest.simulation.states import (
    Driveline,
    GearboxState,
    Motion,
    OperatingPoint,
    Resistance,
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
def operating_point(
    vehicle: VehicleParameters, state: State, driveline: Driveline, resistance: Resistance
) -> tuple[OperatingPoint, float]:
    """Return what the engine can give at its speed, in torque and in force, and the boost 5 ms later.

    driveline, resistance: with the present mass.
    """
    p = vehicle.engine
    speed, _, engine_speed, _, _, _, torque, _, _, _ = state.motion
    full = p.full_torque
    last = len(full) - 1
    x = engine_speed * ROWS_PER_RADPS
    row = max(int(x), 0)
    highest = full[last] if row >= last else full[row] + (full[row + 1] - full[row]) * (x - row)
    friction = p.friction_0 + p.friction_w * engine_speed
    # the unboosted part at once, the rest as the turbocharger spools up: it follows the load by a lag
    boost = state.engine.boost
    boost += (torque / (highest + TINY_NM) - boost) * RECORD_S / p.boost_s
    boost = min(boost, 1.0)
    available = highest * (p.unboosted + (1.0 - p.unboosted) * boost * OVERBOOST)
    available = min(available, highest)
    pedal_up = p.regeneration * (1.0 if speed > REGENERATION_FADE_MPS else speed / REGENERATION_FADE_MPS)
    per_force = driveline.torque_per_force
    least = -(friction + pedal_up) / per_force if state.gearbox.phase in CLOSED else 0.0
    ceiling = (resistance.total + driveline.mass * vehicle.driver.accel_limit) * per_force + friction
    return OperatingPoint(per_force, friction, highest, available, ceiling, pedal_up, least, row), boost


@kernel
def torque_demand(
    p: EngineParameters,
    released: float,
    ramp_s: float,
    shift: GearboxState,
    motion: Motion,
    point: OperatingPoint,
    pedal: float,
) -> tuple[float, float]:
    """Return the indicated torque (N m) asked for by pedal, shift and idle governor, and its released share.

    ramp_s: time in which a shift takes the torque away. released: share that it lets through. pedal: 0..1.
    """
    _, friction, highest, available, ceiling, pedal_up, _, _ = point
    engine_speed = motion.engine_speed
    phase = shift.phase
    if phase == NEUTRAL and not p.electric:
        demand = friction + p.inertia * (motion.input_speed - engine_speed) / MATCHING_S
        demand = min(MATCHING_SHARE * available, max(0.0, demand))
        released = 0.0
    elif phase == STANDING and not p.electric:
        demand = friction
    else:
        demand = pedal * (highest + p.regeneration) - pedal_up
        demand = min(demand, ceiling)
        if phase == RAMP_OUT:
            released = max(0.0, 1.0 - shift.phase_s / ramp_s)
            demand = friction + (demand - friction) * released
        elif released < 1.0:
            released = min(1.0, released + RECORD_S / (ramp_s * RELEASE_RATIO))
            demand = friction + (demand - friction) * released
    if not p.electric:
        floor = friction + IDLE_GAIN_1PS * p.inertia * (p.idle - engine_speed)
        if demand < floor and engine_speed < p.idle * IDLE_REACH:
            demand = floor
        demand = max(demand, 0.0)
    return min(demand, available), released


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
