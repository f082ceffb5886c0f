"""The true vehicle and its course, as the kernels take them: one named tuple for each part, in SI units.

Each kernel is given the parts that it needs. A table is a list when the kernels are interpreted and an array
when they are compiled (see `canest.core.jit`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

Table = Sequence[float]


class EngineParameters(NamedTuple):
    """Engine or electric motor."""

    electric: bool
    inertia: float  #: kg m2 at the crank
    friction_0: float  #: N m at standstill
    friction_w: float  #: N m per rad/s
    regeneration: float  #: N m with the pedal up, electric only
    idle: float  #: rad/s; 0 for an electric motor
    fuelling_s: float  #: time constant from demand to torque
    boost_s: float  #: time constant of the turbocharger
    unboosted: float  #: share of the full torque without boost
    gain: float  #: true over reported torque
    full_torque: Table  #: N m every `TORQUE_TABLE_RPM`


class AccessoryParameters(NamedTuple):
    """What is taken at the crank: a load that is switched, and a constant loss."""

    power: float  #: W
    cubic: bool  #: the power goes with the cube of engine speed
    rated_speed: float  #: rad/s at which a cubic load takes `power`
    torque_loss: float  #: N m
    idle: float  #: of the engine, rad/s
    electric: bool


class GearboxParameters(NamedTuple):
    """Automated gearbox: its gears and its shift programme."""

    electric: bool  #: one gear, no clutch, no shifts
    ratios: Table  #: crank to wheels, by gear
    efficiencies: Table  #: as declared, by gear
    wheel_radius: float  #: m
    full_torque: Table  #: of the engine, N m every `TORQUE_TABLE_RPM`
    idle: float  #: of the engine, rad/s
    upshift_low: float  #: rad/s without pedal
    upshift_high: float  #: rad/s at full pedal
    downshift: float  #: rad/s
    ramp_s: float  #: time in which the torque is taken away before a shift
    neutral_s: float  #: shortest time out of gear
    fixed_gear: int  #: index, or -1


class DrivelineParameters(NamedTuple):
    """Shafts, wheels and tyres."""

    kept: Table  #: share of the traction that undeclared losses leave, by gear
    wheel_radius: float  #: m
    wheel_inertia: float  #: kg m2, all wheels
    stiffness: float  #: N m per rad at the wheels
    damping: float  #: damping ratio of the twist
    slip: float  #: slip of the driven wheels per m/s2 of traction


class ResistanceParameters(NamedTuple):
    """Air drag, rolling resistance and other forces against the motion."""

    half_rho_cda: float  #: kg/m
    crr: float
    crr_per_mps: float
    wind: float  #: m/s, positive against the motion
    drag_force: float  #: N
    cornering: float  #: s2/m


class RetarderParameters(NamedTuple):
    """Engine brake at the crank, N m: the reported one, and the undeclared one by its cause."""

    highest: float
    unreported: bool  #: whether there is an undeclared one
    pedal_up: float
    brake: float


class DriverParameters(NamedTuple):
    """How a driver follows the plan."""

    firmness: float  #: acceleration wanted per speed error, 1/s
    accel_limit: float  #: m/s2
    pulse_min: float  #: speed below which a throttle pulse is prolonged, m/s
    brakes: bool
    uses_retarder: bool
    regeneration: float  #: torque with the pedal up, N m


class PitchParameters(NamedTuple):
    """Pitch of the body on its springs."""

    gain: float  #: rad per m/s2
    natural: float  #: rad/s


class VehicleParameters(NamedTuple):
    """The true vehicle with its driver: what is declared, and every undeclared effect."""

    engine: EngineParameters
    accessory: AccessoryParameters
    gearbox: GearboxParameters
    driveline: DrivelineParameters
    resistance: ResistanceParameters
    retarder: RetarderParameters
    driver: DriverParameters
    pitch: PitchParameters


class Course(NamedTuple):
    """What comes from outside: road every metre, plan and conditions every `PLAN_S`, changes of mass."""

    grades: Table  #: tan(beta)
    curvatures: Table  #: 1/m
    wanted_speed: Table  #: m/s
    throttle: Table  #: 0..1, negative for none
    crr_extra: Table  #: added to the rolling resistance coefficient
    drag_scale: Table  #: share of the drag area
    load_on: Table  #: 1 while the switched load is on
    mass_times: Table  #: s; a mass holds from the first standstill after its time; the last is infinite
    masses: Table  #: kg
    mass_in_motion: Table  #: 1 where a mass holds from its time itself
    mass_rates: Table  #: kg/s while the vehicle moves, until the next mass


class Plan(NamedTuple):
    """What a course plans for the next `PLAN_S`."""

    wanted_speed: float  #: m/s
    throttle: float  #: 0..1, negative for none
    crr_extra: float  #: added to the rolling resistance coefficient
    drag_scale: float  #: share of the drag area
    load_on: float  #: 1 while the switched load is on
