"""Scenario -> what the kernels take: the true vehicle, its course, and the state it starts from."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from canest.core.errors import ConfigError
from canest.core.frames import FloatColumn
from canest.simulation.constants import (
    DEMAND,
    ENGAGED,
    ENGINE_SPEED,
    GEAR,
    INDICATED,
    MASS,
    PERCENT,
    PHASE,
    PLAN_S,
    RADPS,
    SPEED,
    STANDING,
    TORQUE_TABLE_RPM,
    WHEEL_SPEED,
)
from canest.simulation.driveline import set_driveline
from canest.simulation.drivers import Pulses, plan
from canest.simulation.effects import Drafting, Hidden
from canest.simulation.parameters import (
    AccessoryParameters,
    Course,
    DrivelineParameters,
    DriverParameters,
    EngineParameters,
    GearboxParameters,
    PitchParameters,
    ResistanceParameters,
    RetarderParameters,
    Table,
    VehicleParameters,
)
from canest.simulation.roads import lay
from canest.simulation.scenario import Scenario
from canest.simulation.states import (
    INPUT_SPEED,
    NEXT_CHANGE,
    NEXT_GEAR,
    RELEASED,
    SINCE_SHIFT_S,
    STATE_SIZE,
    State,
)
from canest.simulation.vehicles import VehicleSpec

#: a list (interpreted) or an array (compiled) of the values of a table
Container = Callable[[FloatColumn], Table]

FASTEST_MPS = 45.0  #: sets how much road is laid (chosen)
BEYOND_TABLE_RPM = 1000.0  #: an engine may be driven this far beyond its full-torque curve (chosen)
STARTING_MARGIN = 1.2  #: the gear to start in turns the engine this much above the downshift point (chosen)
MOVING_MPS = 0.5  #: a drive that starts faster starts in gear (chosen)
LONG_AGO_S = 10.0  #: the last shift before the drive (chosen)
#: length of a stretch behind a vehicle or alone, over the mean length (chosen)
DRAFTING_SPREAD = (0.4, 1.6)


def vehicle_parameters(spec: Scenario, hidden: Hidden, contain: Container) -> VehicleParameters:
    """Return the true vehicle: what is declared, with everything hidden. Errors: ConfigError."""
    vehicle, driver = spec.vehicle, spec.driver
    load = hidden.load
    inertia_kgm2 = vehicle.engine_inertia_kgm2 + hidden.inertia_kgm2
    for what, left, is_enough in (
        ("drag_area", vehicle.cda_m2 + hidden.cda_delta_m2, vehicle.cda_m2 + hidden.cda_delta_m2 >= 0.0),
        ("rotating_inertia", inertia_kgm2, inertia_kgm2 > 0.0),
    ):
        if not is_enough:
            where, expected = "undeclared", "more than nothing with the vehicle's own"
            raise ConfigError(f"{what} takes too much", where=where, found=f"{left:g}", expected=expected)
    full = contain(_full_torque(vehicle))
    idle = 0.0 if vehicle.electric else vehicle.idle_rpm * RADPS
    return VehicleParameters(
        engine=_engine(vehicle, hidden, idle, full),
        accessory=AccessoryParameters(
            power=load.power_kW * 1000 if load else 0.0,
            cubic=load is not None and load.law == "cubic",
            rated_speed=load.at_rpm * RADPS if load else 1.0,
            torque_loss=hidden.torque_loss_Nm,
            idle=idle,
            electric=vehicle.electric,
        ),
        gearbox=_gearbox(spec, hidden, idle, full, contain),
        driveline=DrivelineParameters(
            kept=contain(np.asarray(hidden.kept, np.float64)),
            wheel_radius=vehicle.wheel_radius_m * hidden.radius_factor,
            wheel_inertia=vehicle.wheel_inertia_kgm2,
            stiffness=vehicle.stiffness_Nm,
            damping=vehicle.damping if hidden.damping is None else hidden.damping,
            slip=hidden.slip_per_mps2,
        ),
        resistance=ResistanceParameters(
            half_rho_cda=0.5 * vehicle.air_density_kgpm3 * (vehicle.cda_m2 + hidden.cda_delta_m2),
            crr=vehicle.crr,
            crr_per_mps=hidden.crr_per_mps,
            wind=hidden.wind_mps,
            drag_force=hidden.drag_N,
            cornering=hidden.cornering_s2pm,
        ),
        retarder=RetarderParameters(
            vehicle.retarder_Nm, any(hidden.retarder_Nm.values()), **hidden.retarder_Nm
        ),
        driver=DriverParameters(
            firmness=driver.firmness_1ps,
            accel_limit=vehicle.accel_limit_mps2,
            pulse_min=driver.min_mps if isinstance(driver, Pulses) else 0.0,
            brakes=driver.brakes,
            uses_retarder=driver.retarder and vehicle.layout == "j1939" and not vehicle.electric,
            regeneration=vehicle.regeneration_Nm,
        ),
        pitch=PitchParameters(vehicle.pitch_rad_per_mps2, 2 * math.pi * vehicle.pitch_hz),
    )


def _engine(vehicle: VehicleSpec, hidden: Hidden, idle: float, full: Table) -> EngineParameters:
    per_krpm = vehicle.friction_pct_per_krpm / (1000 * RADPS)
    return EngineParameters(
        electric=vehicle.electric,
        inertia=vehicle.engine_inertia_kgm2 + hidden.inertia_kgm2,
        friction_0=vehicle.friction_pct / PERCENT * vehicle.reference_torque_Nm,
        friction_w=per_krpm / PERCENT * vehicle.reference_torque_Nm,
        regeneration=vehicle.regeneration_Nm,
        idle=idle,
        fuelling_s=vehicle.fuelling_s,
        boost_s=vehicle.boost_s,
        unboosted=vehicle.unboosted,
        gain=hidden.gain,
        full_torque=full,
    )


def _gearbox(
    spec: Scenario, hidden: Hidden, idle: float, full: Table, contain: Container
) -> GearboxParameters:
    vehicle, driver = spec.vehicle, spec.driver
    gears = len(vehicle.gear_ratios)
    if driver.fixed_gear is not None and driver.fixed_gear > gears:
        raise ConfigError(
            "no such gear", where="driver.fixed_gear", found=driver.fixed_gear, expected=f"1..{gears}"
        )
    return GearboxParameters(
        electric=vehicle.electric,
        ratios=contain(np.asarray([ratio * vehicle.final_drive for ratio in vehicle.gear_ratios])),
        efficiencies=contain(np.asarray(vehicle.gear_efficiencies, np.float64)),
        wheel_radius=vehicle.wheel_radius_m * hidden.radius_factor,
        full_torque=full,
        idle=idle,
        upshift_low=vehicle.upshift_rpm[0] * RADPS,
        upshift_high=vehicle.upshift_rpm[1] * RADPS,
        downshift=vehicle.downshift_rpm * RADPS,
        ramp_s=vehicle.torque_ramp_s,
        neutral_s=vehicle.neutral_s,
        fixed_gear=-1 if driver.fixed_gear is None else driver.fixed_gear - 1,
    )


def _full_torque(vehicle: VehicleSpec) -> FloatColumn:
    last_rpm = vehicle.full_torque[-1][0]
    rpm = np.arange(0.0, last_rpm + BEYOND_TABLE_RPM, TORQUE_TABLE_RPM)
    full = np.interp(rpm, *np.array(vehicle.full_torque).T)
    full[rpm > last_rpm] = 0.0
    return np.asarray(full, np.float64)


def course_of(
    spec: Scenario, hidden: Hidden, rng: dict[str, np.random.Generator], contain: Container
) -> Course:
    """Draw road, plan and conditions from the streams `road`, `driver`, `drafting`. Errors: ConfigError."""
    intent = plan(spec.driver, spec.duration_s, rng["driver"])
    road = lay(spec.road, spec.duration_s * FASTEST_MPS, rng["road"])
    t = np.arange(len(intent.target_mps)) * PLAN_S
    crr_extra = np.full_like(t, hidden.crr_delta)
    for cold, tau in hidden.warmups:
        crr_extra += cold * np.exp(-t / tau)
    load_on = np.zeros_like(t)
    if hidden.load:
        load_on = (np.mod(t, hidden.load.period_s) < hidden.load.on_s).astype(float)
    times, masses = _masses(spec, hidden)
    kinds = {change.t_s: change for change in spec.mass_kg}
    changes = [kinds.get(at) for at in times]  # None: a payload change

    def table(column: Any) -> Table:
        return contain(np.asarray(column, np.float64))

    return Course(
        grades=table(road.grade),
        curvatures=table(road.curvature_1pm),
        wanted_speed=table(intent.target_mps),
        throttle=table(intent.throttle),
        crr_extra=table(crr_extra),
        drag_scale=table(_drag_scale(hidden.drafting, t, rng["drafting"])),
        load_on=table(load_on),
        mass_times=table([*times, math.inf]),
        masses=table(masses),
        mass_in_motion=table([change is not None and change.moving for change in changes]),
        mass_rates=table([change.rate_kgps if change else 0.0 for change in changes]),
    )


def _drag_scale(drafting: Drafting | None, t: Any, rng: np.random.Generator) -> FloatColumn:
    """Return the share of the drag area at times t: less behind another vehicle, now and then."""
    scale: FloatColumn = np.ones_like(t)
    now, behind = 0.0, False
    while drafting and now < t[-1]:
        until = now + rng.uniform(*DRAFTING_SPREAD) * drafting.period_s
        if behind:
            scale[(t >= now) & (t < until)] = 1 - drafting.reduction
        now, behind = until, not behind
    return scale


def _masses(spec: Scenario, hidden: Hidden) -> tuple[list[float], list[float]]:
    """Return times and masses: the scenario's, and the undeclared changes of payload on top."""
    if hidden.payloads and any(change.moving or change.rate_kgps for change in spec.mass_kg):
        raise ConfigError(
            "payload_change needs a mass that changes at standstills",
            where="undeclared",
            found="mass_kg with moving or rate_kgps",
            expected="all changes in mass_kg",
        )
    changes = [(change.t_s, change.mass_kg) for change in spec.mass_kg]
    if early := [when for when, _ in hidden.payloads if when < changes[0][0]]:
        raise ConfigError(
            "payload_change before the drive", where="undeclared", found=f"t_s {early[0]:g}",
            expected=f"{changes[0][0]:g} or later",
        )  # fmt: skip
    times = sorted({when for when, _ in changes} | {when for when, _ in hidden.payloads})
    masses = [
        next(kg for when, kg in reversed(changes) if when <= at)
        + sum(delta for when, delta in hidden.payloads if when <= at)
        for at in times
    ]
    if min(masses) <= 0:
        raise ConfigError("the mass must stay positive", where="mass_kg", found=f"{min(masses):g} kg")
    return times, masses


def initial_state(spec: Scenario, p: VehicleParameters, mass: float, contain: Container) -> State:
    """Return the state at the start: at rest with the clutch open, or rolling in gear."""
    speed = spec.driver.start_mps
    radius = p.driveline.wheel_radius
    gear = p.gearbox.fixed_gear
    if gear < 0:
        wanted = spec.vehicle.downshift_rpm * STARTING_MARGIN * RADPS
        fits = [k for k, ratio in enumerate(p.gearbox.ratios) if speed / radius * ratio >= wanted]
        gear = max(fits, default=0)
    ratio = float(p.gearbox.ratios[gear])
    rolling = speed > MOVING_MPS or p.engine.electric
    engine_speed = speed / radius * ratio if rolling else p.engine.idle
    torque = p.engine.friction_0 + p.engine.friction_w * engine_speed
    wheel_speed = speed / radius
    x = np.zeros(STATE_SIZE)
    x[SPEED] = speed
    x[ENGINE_SPEED] = engine_speed
    x[WHEEL_SPEED] = wheel_speed
    x[INPUT_SPEED] = wheel_speed * ratio
    x[INDICATED] = torque
    x[DEMAND] = torque
    x[RELEASED] = 1.0
    x[PHASE] = ENGAGED if rolling else STANDING
    x[GEAR] = gear
    x[NEXT_GEAR] = gear
    x[SINCE_SHIFT_S] = LONG_AGO_S
    x[MASS] = mass
    x[NEXT_CHANGE] = 1
    state: Any = contain(x)
    set_driveline.interpreted(p, state)
    return cast(State, state)
