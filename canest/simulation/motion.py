"""The truth's motion: road, driver, engine, gearbox, driveline and body, one after the other, every 5 ms.

Scalar kernels, interpreted as they stand or compiled by numba. The driveline runs at 1 kHz, all else at
200 Hz. What every record passes does without min() and max(): interpreted, a call takes as long as ten
operations.
"""

from __future__ import annotations

from typing import Any

from canest.core.jit import kernel
from canest.simulation.constants import (
    ACCEL,
    CLOSED,
    CLUTCH_SLIP,
    COLUMN_COUNT,
    ENGAGED,
    ENGINE_SPEED,
    LAUNCH,
    LOAD_ON,
    PHASE,
    RECORD_S,
    RECORDS_PER_PLAN_STEP,
    RETARDER,
    SPEED,
)
from canest.simulation.driveline import change_gear, clutch_locks, integrate, lock, set_driveline
from canest.simulation.driver_pedals import accelerate, slow_down
from canest.simulation.engine import accessory_torque, set_demand, set_operating_point
from canest.simulation.gearbox import shift
from canest.simulation.parameters import Course, Plan, VehicleParameters
from canest.simulation.pitch import pitch_body
from canest.simulation.resistance import load_cargo, set_road_load
from canest.simulation.retarder import UNREPORTED_RADPS, USABLE_RADPS, use_retarder, use_unreported
from canest.simulation.states import INPUT_SPEED, TAKEN, UNREPORTED, State

SLIP_FROM_RADPS = 1.0  #: no clutch slip is reported of an engine slower than this (chosen)


@kernel
def move(vehicle: VehicleParameters, course: Course, x: State, out: Any) -> None:
    """Move the vehicle from a state on and fill `out`, flat: one row of `COLUMNS` every 5 ms."""
    plan = plan_at(course, 0)
    for k in range(len(out) // COLUMN_COUNT):
        if k % RECORDS_PER_PLAN_STEP == 0:
            plan = plan_at(course, k // RECORDS_PER_PLAN_STEP)
        step(vehicle, course, plan, x, k * RECORD_S)
        at = k * COLUMN_COUNT
        for column in range(COLUMN_COUNT):
            out[at + column] = x[column]


@kernel
def plan_at(course: Course, planned: int) -> Plan:
    """Return what is planned from `planned` times `PLAN_S` on."""
    return Plan(
        course.wanted_speed[planned],
        course.throttle[planned],
        course.crr_extra[planned],
        course.drag_scale[planned],
        course.load_on[planned],
    )


@kernel
def step(vehicle: VehicleParameters, course: Course, plan: Plan, x: State, time_s: float) -> None:
    """Change the state to that of the record at a time, 5 ms later."""
    wanted = plan.wanted_speed
    load_on = plan.load_on
    speed = x[SPEED]
    before = x[PHASE]
    # where the vehicle is, and what the engine can do there
    if load_cargo(course, x, time_s):
        set_driveline(vehicle, x)
    set_road_load(vehicle.resistance, course, plan, x)
    set_operating_point(vehicle, x)
    # what driver and control units make of it
    act(vehicle, x, wanted, plan.throttle)
    shift(vehicle.gearbox, x, wanted)
    phase = x[PHASE]
    if phase != before:
        set_driveline(vehicle, x)
        change_gear(x, before)
    set_demand(vehicle.engine, x, vehicle.gearbox.ramp_s)
    # what comes of it
    taken = accessory_torque(vehicle.accessory, load_on, x[ENGINE_SPEED])
    x[TAKEN] = taken + x[RETARDER] + x[UNREPORTED]
    integrate(vehicle, x)
    x[LOAD_ON] = load_on
    x[CLUTCH_SLIP] = 0.0 if phase in CLOSED else clutch_slip(x[ENGINE_SPEED], x[INPUT_SPEED])
    if phase == LAUNCH and clutch_locks(vehicle.engine.idle, x):
        lock(x)
    accel = (x[SPEED] - speed) / RECORD_S
    x[ACCEL] = accel
    pitch_body(vehicle.pitch, x, accel)


@kernel
def act(vehicle: VehicleParameters, x: State, wanted: float, throttle: float) -> None:
    """Move pedals and engine brakes: engine drag first, then the engine brake, then the brakes.

    wanted: speed of the plan (m/s). throttle: of the plan, negative for none.
    """
    driver = vehicle.driver
    engine_speed = x[ENGINE_SPEED]
    engaged = x[PHASE] == ENGAGED
    missing = accelerate(driver, x, wanted, throttle)
    if driver.uses_retarder:
        missing = use_retarder(vehicle.retarder, x, missing, engaged and engine_speed > USABLE_RADPS)
    if driver.brakes:
        slow_down(x, wanted, throttle, missing)
    if vehicle.retarder.unreported:
        use_unreported(vehicle.retarder, x, engaged and engine_speed > UNREPORTED_RADPS)


@kernel
def clutch_slip(engine_speed: float, input_speed: float) -> float:
    """Return the slip of an open clutch that the gearbox reports, 0..1 of engine speed. Speeds: rad/s."""
    slip = (engine_speed - input_speed) / engine_speed if engine_speed > SLIP_FROM_RADPS else 0.0
    return min(1.0, max(0.0, slip))
