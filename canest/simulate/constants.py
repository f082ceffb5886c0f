"""What the motion kernel is given and what it returns: true constants, record columns, driveline phases."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core.errors import ConfigError
from canest.simulate.effects import Hidden
from canest.simulate.scenario import Scenario

GRAVITY = 9.80665  #: m/s2
STEP_S = 0.001
STEPS_PER_RECORD = 5
RECORD_S = STEP_S * STEPS_PER_RECORD
TORQUE_TABLE_RPM = 25.0  #: spacing of the full-torque table

#: columns of a record
COLUMNS = (
    "speed_mps", "accel_mps2", "distance_m", "engine_radps", "wheel_radps", "indicated_Nm", "demand_Nm",
    "wheel_torque_Nm", "pedal", "brake", "retarder_Nm", "gear", "phase", "clutch_slip", "mass_kg", "load_on",
    "pitch_rad", "grade", "curvature_1pm", "crank_Nm",
)  # fmt: skip

#: phases of the driveline
ENGAGED, RAMP_OUT, NEUTRAL, RAMP_IN, LAUNCH, STANDING = range(6)


class Constants(NamedTuple):
    """The true vehicle and its hidden effects, all float; SI units."""

    engine_inertia: float
    friction_0: float  #: N m at standstill
    friction_w: float  #: N m per rad/s
    regeneration: float
    idle: float  #: rad/s; 0 for an electric motor
    fuelling_s: float
    boost_s: float
    unboosted: float
    radius: float
    wheel_inertia: float
    drag: float  #: half rho Cd A
    crr: float
    crr_per_mps: float
    wind: float
    stiffness: float
    damping: float
    gain: float
    torque_loss: float
    drag_force: float
    cornering: float
    slip: float
    retarder_max: float
    hidden_retarder_pedal: float
    hidden_retarder_brake: float
    load_power: float  #: W
    load_cubic: float  #: 1 when the power goes with the cube of engine speed, else 0
    load_at: float  #: rad/s at which the load takes `load_power`
    upshift_low: float
    upshift_high: float
    downshift: float
    ramp_s: float
    neutral_s: float
    accel_limit: float
    pitch_gain: float
    pitch_w: float
    brakes: float
    uses_retarder: float
    fixed_gear: float  #: index, or -1
    pulse_min: float
    firmness: float
    start_mps: float
    start_gear: float


def true_constants(spec: Scenario, hidden: Hidden, ratios: list[float]) -> Constants:
    """Return the true vehicle: what is declared, with everything hidden. Errors: ConfigError."""
    vehicle, driver = spec.vehicle, spec.driver
    radps = 2 * math.pi / 60
    radius = vehicle.wheel_radius_m * hidden.radius_factor
    fixed = -1 if driver.fixed_gear is None else driver.fixed_gear - 1
    if fixed >= len(ratios):
        raise ConfigError(
            "no such gear", where="driver.fixed_gear", found=fixed + 1, expected=f"1..{len(ratios)}"
        )
    gear = fixed
    if fixed < 0:
        wanted = vehicle.downshift_rpm * 1.2 * radps
        fits = [k for k, ratio in enumerate(ratios) if driver.start_mps / radius * ratio >= wanted]
        gear = max(fits, default=0)
    load = hidden.load
    rho = vehicle.air_density_kgpm3
    per_krpm = vehicle.friction_pct_per_krpm / (1000 * radps)
    return Constants(
        engine_inertia=vehicle.engine_inertia_kgm2 + hidden.inertia_kgm2,
        friction_0=vehicle.friction_pct / 100 * vehicle.reference_torque_Nm,
        friction_w=per_krpm / 100 * vehicle.reference_torque_Nm,
        regeneration=vehicle.regeneration_Nm,
        idle=0.0 if vehicle.electric else vehicle.idle_rpm * radps,
        fuelling_s=vehicle.fuelling_s,
        boost_s=vehicle.boost_s,
        unboosted=vehicle.unboosted,
        radius=radius,
        wheel_inertia=vehicle.wheel_inertia_kgm2,
        drag=0.5 * rho * (vehicle.cda_m2 + hidden.cda_delta_m2),
        crr=vehicle.crr,
        crr_per_mps=hidden.crr_per_mps,
        wind=hidden.wind_mps,
        stiffness=vehicle.stiffness_Nm,
        damping=vehicle.damping if hidden.damping is None else hidden.damping,
        gain=hidden.gain,
        torque_loss=hidden.torque_loss_Nm,
        drag_force=hidden.drag_N,
        cornering=hidden.cornering_s2pm,
        slip=hidden.slip_per_mps2,
        retarder_max=vehicle.retarder_Nm,
        hidden_retarder_pedal=hidden.retarder_Nm["pedal_up"],
        hidden_retarder_brake=hidden.retarder_Nm["brake"],
        load_power=load.power_kW * 1000 if load else 0.0,
        load_cubic=1.0 if load and load.law == "cubic" else 0.0,
        load_at=load.at_rpm * radps if load else 1.0,
        upshift_low=vehicle.upshift_rpm[0] * radps,
        upshift_high=vehicle.upshift_rpm[1] * radps,
        downshift=vehicle.downshift_rpm * radps,
        ramp_s=vehicle.torque_ramp_s,
        neutral_s=vehicle.neutral_s,
        accel_limit=vehicle.accel_limit_mps2,
        pitch_gain=vehicle.pitch_rad_per_mps2,
        pitch_w=2 * math.pi * vehicle.pitch_hz,
        brakes=float(driver.brakes),
        uses_retarder=float(driver.retarder and vehicle.layout == "j1939"),
        fixed_gear=float(fixed),
        pulse_min=getattr(driver, "min_mps", 0.0),
        firmness=driver.firmness_1ps,
        start_mps=driver.start_mps,
        start_gear=float(gear),
    )
