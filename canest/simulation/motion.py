"""The truth's motion: road, driver, engine, gearbox, driveline and body, one after the other, every 5 ms.

Scalar kernels, interpreted as they stand or compiled by numba. The driveline runs at 1 kHz, all else at
200 Hz.
"""

from __future__ import annotations

from typing import Any

from canest.fast import kernel
from canest.simulation.constants import (
    ACCEL,
    BRAKE,
    CLOSED,
    CLUTCH_SLIP,
    COLUMN_COUNT,
    CRANK_TORQUE,
    CURVATURE,
    DEMAND,
    DISTANCE,
    ENGAGED,
    ENGINE_SPEED,
    GEAR,
    GRADE,
    INDICATED,
    LOAD_ON,
    MASS,
    PEDAL,
    PHASE,
    PITCH,
    RECORD_S,
    RECORDS_PER_PLAN_STEP,
    RETARDER,
    SPEED,
    WHEEL_SPEED,
    WHEEL_TORQUE,
)  # fmt: skip
from canest.simulation.driveline import (
    clutch_locks,
    driveline_in,
    engaged_anew,
    integrate,
    locked,
    wound_up,
)
from canest.simulation.driver_pedals import accelerate, slow_down
from canest.simulation.engine import accessory_torque, operating_point, torque_demand
from canest.simulation.gearbox import shift
from canest.simulation.parameters import Course, VehicleParameters
from canest.simulation.pitch import pitch_after
from canest.simulation.resistance import cargo_at, road_at, road_load
from canest.simulation.retarder import UNREPORTED_RADPS, USABLE_RADPS, reported_retarder, unreported_retarder
from canest.simulation.states import (
    CrankTorques,
    EngineState,
    Motion,
    OperatingPoint,
    Pedals,
    Resistance,
    Retarders,
    RoadPoint,
    State,
    Wish,
)

SLIP_FROM_RADPS = 1.0  #: no clutch slip is reported of an engine slower than this (chosen)


@kernel
def move(vehicle: VehicleParameters, course: Course, state: State, out: Any) -> None:
    """Move the vehicle from a state on and fill `out`, flat: one row of `COLUMNS` every 5 ms."""
    for k in range(len(out) // COLUMN_COUNT):
        state = step(vehicle, course, state, k, out)


@kernel
def step(vehicle: VehicleParameters, course: Course, state: State, k: int, out: Any) -> State:
    """Return the state 5 ms later, and write row k of `out`."""
    planned = k // RECORDS_PER_PLAN_STEP
    wish = Wish(course.wanted_speed[planned], course.throttle[planned])
    speed = state.motion.speed
    # where the vehicle is, and what the engine can do there
    road = road_at(course, state.motion.distance)
    cargo = cargo_at(course, state.cargo, k * RECORD_S, speed)
    mass = cargo.mass
    resistance = road_load(
        vehicle.resistance, mass, speed, road, course.crr_extra[planned], course.drag_scale[planned]
    )
    driveline = driveline_in(vehicle, state.driveline, state.gearbox.gear, mass)
    point, boost = operating_point(vehicle, state, driveline, resistance)
    # what driver and control units make of it
    pedals, retarders = act(vehicle, state, point, resistance, mass, wish)
    gearbox = shift(
        vehicle.gearbox, state.gearbox, state.motion, point, pedals, mass, resistance.total, wish.speed
    )
    driveline = driveline_in(vehicle, driveline, gearbox.gear, mass)
    motion = engaged_anew(state.motion, state.gearbox.phase, gearbox.phase, driveline.ratio)
    demand, released = torque_demand(
        vehicle.engine, state.engine.released, vehicle.gearbox.ramp_s, gearbox, motion, point,
        pedals.accelerator,
    )  # fmt: skip
    engine = EngineState(boost, demand, released)
    # what comes of it
    torques = crank_torques(vehicle, engine, point, retarders, course.load_on[planned], motion.engine_speed)
    motion = integrate(vehicle, motion, driveline, gearbox.phase, torques, resistance, pedals.brake)
    slip = clutch_slip(motion, gearbox.phase)
    if clutch_locks(vehicle.engine.idle, gearbox.phase, motion):
        gearbox = locked(gearbox)
        motion = wound_up(motion, driveline.stiffness)
    accel = (motion.speed - speed) / RECORD_S
    pitch = pitch_after(vehicle.pitch, state.pitch, accel)
    state = State(motion, engine, pedals, retarders, gearbox, cargo, pitch, driveline)
    write_record(out, k * COLUMN_COUNT, state, road, accel, slip, course.load_on[planned])
    return state


@kernel
def act(
    vehicle: VehicleParameters, state: State, point: OperatingPoint, resistance: Resistance, mass: float,
    wish: Wish,
) -> tuple[Pedals, Retarders]:  # fmt: skip
    """Return the pedals and the engine brakes: engine drag first, then the engine brake, then the brakes."""
    motion = state.motion
    engaged = state.gearbox.phase == ENGAGED
    pedals, missing = accelerate(
        vehicle.driver, state.pedals, point, mass, motion.speed, wish, resistance.total
    )
    usable = vehicle.driver.uses_retarder and engaged and motion.engine_speed > USABLE_RADPS
    reported, missing = reported_retarder(
        vehicle.retarder, state.retarders.reported, missing, point.torque_per_force, usable
    )
    pedals = slow_down(vehicle.driver, pedals, mass, motion.speed, wish, missing)
    usable = engaged and motion.engine_speed > UNREPORTED_RADPS
    unreported = unreported_retarder(vehicle.retarder, state.retarders.unreported, pedals, usable)
    return pedals, Retarders(reported, unreported)


@kernel
def crank_torques(
    vehicle: VehicleParameters, engine: EngineState, point: OperatingPoint, retarders: Retarders,
    load_on: float, speed: float,
) -> CrankTorques:  # fmt: skip
    """Return the torques at the crank for the next 5 ms. speed: of the engine (rad/s)."""
    taken = accessory_torque(vehicle.accessory, load_on, speed) + retarders.reported + retarders.unreported
    return CrankTorques(engine.demand, point.friction, taken, point.ceiling, point.highest)


@kernel
def clutch_slip(motion: Motion, phase: int) -> float:
    """Return the slip that the gearbox reports, 0..1 of engine speed; 0 with the clutch closed."""
    speed = motion.engine_speed
    slip = (speed - motion.input_speed) / speed if speed > SLIP_FROM_RADPS and phase not in CLOSED else 0.0
    return min(1.0, max(0.0, slip))


@kernel
def write_record(
    out: Any, at: int, state: State, road: RoadPoint, accel: float, slip: float, load_on: float
) -> None:
    """Write a row of `COLUMNS` into ``out`` from ``at`` on."""
    motion = state.motion
    out[at + SPEED] = motion.speed
    out[at + ACCEL] = accel
    out[at + DISTANCE] = motion.distance
    out[at + ENGINE_SPEED] = motion.engine_speed
    out[at + WHEEL_SPEED] = motion.wheel_speed
    out[at + INDICATED] = motion.torque
    out[at + DEMAND] = state.engine.demand
    out[at + WHEEL_TORQUE] = motion.wheel_torque
    out[at + PEDAL] = state.pedals.accelerator
    out[at + BRAKE] = state.pedals.brake
    out[at + RETARDER] = state.retarders.reported
    out[at + GEAR] = state.gearbox.gear
    out[at + PHASE] = state.gearbox.phase
    out[at + CLUTCH_SLIP] = slip
    out[at + MASS] = state.cargo.mass
    out[at + LOAD_ON] = load_on
    out[at + PITCH] = state.pitch.angle
    out[at + GRADE] = road.grade
    out[at + CURVATURE] = road.curvature
    out[at + CRANK_TORQUE] = motion.crank_torque
