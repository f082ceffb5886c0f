"""The state of a simulated vehicle: one named tuple for each part, in SI units."""

from __future__ import annotations

from typing import NamedTuple


class Motion(NamedTuple):
    """What is integrated at 1 kHz, with the torques of the last step."""

    speed: float  #: m/s
    distance: float  #: m along the road
    engine_speed: float  #: rad/s
    wheel_speed: float  #: driven wheels, rad/s
    input_speed: float  #: wheels seen through the gear, rad/s
    twist: float  #: of the driveline, rad at the gearbox input
    torque: float  #: indicated, N m
    clutch_torque: float  #: N m
    wheel_torque: float  #: N m
    crank_torque: float  #: N m: what is left at the crank for clutch and engine inertia


class EngineState(NamedTuple):
    """Engine control."""

    boost: float  #: 0..1
    demand: float  #: indicated torque asked for, N m
    released: float  #: share of the asked torque that a shift lets through, 0..1


class Pedals(NamedTuple):
    """The driver's feet, and what the driver has come to expect."""

    accelerator: float  #: 0..1
    brake: float  #: 0..1
    braking: bool
    lifted: bool  #: a throttle pulse is cut short
    pushed: bool  #: a throttle pulse is prolonged
    expected_resistance: float  #: N


class Retarders(NamedTuple):
    """Engine brakes, N m at the crank."""

    reported: float
    unreported: float


class GearboxState(NamedTuple):
    """Clutch and gears; a gear is an index from 0."""

    phase: int  #: ENGAGED, RAMP_OUT, NEUTRAL, RAMP_IN, LAUNCH or STANDING
    gear: int
    next_gear: int
    phase_s: float  #: time in this phase
    since_shift_s: float


class Cargo(NamedTuple):
    """Mass now, and the index of its next change."""

    mass: float  #: kg
    next_change: int


class Pitch(NamedTuple):
    """Pitch of the body."""

    angle: float  #: rad
    rate: float  #: rad/s


class Driveline(NamedTuple):
    """Driveline in the present gear with the present mass."""

    gear: int
    mass: float  #: kg
    ratio: float  #: crank to wheels
    efficiency: float  #: undeclared losses included
    torque_per_force: float  #: crank torque per newton at the wheels by the declared efficiency, m
    stiffness: float  #: at the gearbox input, N m per rad
    damping: float  #: at the gearbox input, N m per rad/s
    inertia: float  #: mass and wheels, kg
    slip_gain: float  #: slip of the driven wheels per N m at the wheels


class State(NamedTuple):
    """The whole vehicle, every 5 ms."""

    motion: Motion
    engine: EngineState
    pedals: Pedals
    retarders: Retarders
    gearbox: GearboxState
    cargo: Cargo
    pitch: Pitch
    driveline: Driveline


class Resistance(NamedTuple):
    """Road load: the part that holds for 5 ms, the air's, and their sum."""

    fixed: float  #: N
    drag: float  #: half rho Cd A, kg/m
    total: float  #: N


class OperatingPoint(NamedTuple):
    """What driver and control units go by at the beginning of a record."""

    torque_per_force: float  #: crank torque per newton at the wheels, m
    friction: float  #: of the engine, N m
    highest: float  #: full torque at this speed, N m
    available: float  #: full torque with the present boost, N m
    ceiling: float  #: torque at which the acceleration limit is reached, N m
    pedal_up: float  #: torque of a motor with the pedal up, N m
    least_force: float  #: lowest force that the engine can give, N
    torque_row: int  #: row of the full-torque table at this speed


class CrankTorques(NamedTuple):
    """Torques that hold for 5 ms, N m at the crank."""

    demand: float  #: indicated, asked for
    friction: float
    taken: float  #: by accessories, losses and engine brakes
    ceiling: float  #: indicated, at the acceleration limit
    highest: float  #: full torque
