"""The truth's motion: road, driver, engine, gearbox, driveline and body, one after the other, every 5 ms.

Scalar kernels, interpreted as they stand or compiled by numba. The driveline runs at 1 kHz, all else at
200 Hz.
"""

from __future__ import annotations

from typing import Any

from canest.core.jit import kernel
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
    LAUNCH,
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
    Retarders,
    State,
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
    wanted = course.wanted_speed[planned]
    throttle = course.throttle[planned]
    load_on = course.load_on[planned]
    motion, engine, _, _, gearbox, cargo, pitch, driveline = state
    before = gearbox.phase
    speed = motion.speed
    # where the vehicle is, and what the engine can do there
    grade, curvature = road_at(course, motion.distance)
    cargo = cargo_at(course, cargo, k * RECORD_S, speed)
    mass = cargo.mass
    resistance = road_load(
        vehicle.resistance, mass, speed, grade, curvature, course.crr_extra[planned],
        course.drag_scale[planned],
    )  # fmt: skip
    if mass != driveline.mass:
        driveline = driveline_in(vehicle, gearbox.gear, mass)
    point, boost = operating_point(vehicle, state, driveline, resistance)
    # what driver and control units make of it
    pedals, retarders = act(vehicle, state, point, resistance.total, mass, wanted, throttle)
    pedal = pedals.accelerator
    gearbox = shift(vehicle.gearbox, gearbox, motion, point, pedals, mass, resistance.total, wanted)
    phase = gearbox.phase
    if phase != before:
        driveline = driveline_in(vehicle, gearbox.gear, mass)
        motion = engaged_anew(motion, before, phase, driveline.ratio)
    demand, released = torque_demand(
        vehicle.engine, engine.released, vehicle.gearbox.ramp_s, gearbox, motion, point, pedal
    )
    # what comes of it
    taken = accessory_torque(vehicle.accessory, load_on, motion.engine_speed)
    taken = taken + retarders.reported + retarders.unreported
    torques = CrankTorques(demand, point.friction, taken, point.ceiling, point.highest)
    motion = integrate(vehicle, motion, driveline, phase, torques, resistance, pedals.brake)
    slip = 0.0 if phase in CLOSED else clutch_slip(motion)
    if phase == LAUNCH and clutch_locks(vehicle.engine.idle, motion):
        gearbox = locked(gearbox)
        motion = wound_up(motion, driveline.stiffness)
    accel = (motion.speed - speed) / RECORD_S
    pitch = pitch_after(vehicle.pitch, pitch, accel)
    engine = EngineState(boost, demand, released)
    at = k * COLUMN_COUNT
    out[at + ACCEL] = accel
    out[at + CLUTCH_SLIP] = slip
    out[at + LOAD_ON] = load_on
    out[at + GRADE] = grade
    out[at + CURVATURE] = curvature
    state = State(motion, engine, pedals, retarders, gearbox, cargo, pitch, driveline)
    write_state(out, at, state)
    return state


@kernel
def act(
    vehicle: VehicleParameters, state: State, point: OperatingPoint, resistance: float, mass: float,
    wanted: float, throttle: float,
) -> tuple[Pedals, Retarders]:  # fmt: skip
    """Return the pedals and the engine brakes: engine drag first, then the engine brake, then the brakes."""
    driver = vehicle.driver
    speed = state.motion.speed
    engine_speed = state.motion.engine_speed
    reported, unreported = state.retarders
    engaged = state.gearbox.phase == ENGAGED
    pedals, missing = accelerate(driver, state.pedals, point, mass, speed, wanted, throttle, resistance)
    usable = driver.uses_retarder and engaged and engine_speed > USABLE_RADPS
    reported, missing = reported_retarder(vehicle.retarder, reported, missing, point.torque_per_force, usable)
    pedals = slow_down(driver, pedals, mass, speed, wanted, throttle, missing)
    usable = engaged and engine_speed > UNREPORTED_RADPS
    return pedals, Retarders(reported, unreported_retarder(vehicle.retarder, unreported, pedals, usable))


@kernel
def clutch_slip(motion: Motion) -> float:
    """Return the slip of an open clutch that the gearbox reports, 0..1 of engine speed."""
    speed = motion.engine_speed
    slip = (speed - motion.input_speed) / speed if speed > SLIP_FROM_RADPS else 0.0
    return min(1.0, max(0.0, slip))


@kernel
def write_state(out: Any, at: int, state: State) -> None:
    """Write what the state holds of a row of `COLUMNS` into ``out`` from ``at`` on."""
    motion, engine, pedals, retarders, gearbox, cargo, pitch, _ = state
    v, s, we, ww, _, _, torque, _, tw, crank = motion
    out[at + SPEED] = v
    out[at + DISTANCE] = s
    out[at + ENGINE_SPEED] = we
    out[at + WHEEL_SPEED] = ww
    out[at + INDICATED] = torque
    out[at + DEMAND] = engine.demand
    out[at + WHEEL_TORQUE] = tw
    out[at + PEDAL] = pedals.accelerator
    out[at + BRAKE] = pedals.brake
    out[at + RETARDER] = retarders.reported
    out[at + GEAR] = gearbox.gear
    out[at + PHASE] = gearbox.phase
    out[at + MASS] = cargo.mass
    out[at + PITCH] = pitch.angle
    out[at + CRANK_TORQUE] = crank
