"""The driver's feet, every 5 ms: accelerator and brake for what the plan wants."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import GRAVITY, RECORD_S
from canest.simulation.engine import TINY_NM
from canest.simulation.parameters import DriverParameters
from canest.simulation.states import OperatingPoint, Pedals

# All chosen.
FULL_BRAKE_G = 0.6  #: deceleration at full braking, in standard gravities
EXPECTATION_S = 0.8  #: a driver expects the resistance of this long ago
PULSE_BAND_MPS = 2.0  #: a prolonged throttle pulse ends this much above the lower speed
DECELERATION_MPS2 = -2.5  #: strongest that is wanted
HALTING_MPS = 0.05  #: a wanted speed below it means to stand
ROLLING_OUT_MPS = 2.0  #: the accelerator is released below it to come to a stop
PRESS, RELEASE = 0.02, -0.025  #: change of the pedal per record: a foot needs a quarter of a second
BRAKES_BEYOND_MPS2 = 0.2  #: deceleration missing from which the brake is used ...
TOO_FAST_MPS = -0.8  #: ... when the wanted speed is exceeded by this
HOLD_BELOW_MPS = 0.6  #: the brake holds the vehicle below it
HOLDING_BRAKE = 0.25  #: share of full braking
BRAKE_S = 0.12  #: time constant of the brakes
BRAKE_OFF = 0.002  #: share of full braking that is none


@kernel
def accelerate(
    p: DriverParameters, pedals: Pedals, point: OperatingPoint, mass: float, speed: float, wanted: float,
    throttle: float, resistance: float,
) -> tuple[Pedals, float]:  # fmt: skip
    """Return the pedals, the accelerator moved, and the force (N) to slow down with that the engine lacks.

    mass: kg. speed, wanted: by the plan (m/s). throttle: of the plan, negative for none. resistance: N.
    """
    accelerator, brake, braking, lifted, pushed, expected = pedals
    expected += (resistance - expected) * RECORD_S / EXPECTATION_S
    missing = 0.0
    if throttle >= 0.0:
        # beyond the upper speed the rest of the pulse is dropped, below the lower one it is prolonged
        if speed > wanted:
            lifted = True
        elif throttle == 0.0:
            lifted = False
        if speed < p.pulse_min:
            pushed = True
        elif speed > p.pulse_min + PULSE_BAND_MPS:
            pushed = False
        want = 1.0 if pushed else 0.0 if lifted else throttle
    else:
        accel = p.firmness * (wanted - speed)
        accel = min(accel, p.accel_limit)
        accel = max(accel, DECELERATION_MPS2)
        force = expected + mass * accel
        asked = force * point.torque_per_force + point.friction + p.regeneration
        want = asked / (point.highest + p.regeneration + TINY_NM)
        missing = point.least_force - force
        if wanted < HALTING_MPS and speed < ROLLING_OUT_MPS:
            want = 0.0
    want = min(1.0, max(0.0, want))
    pedal = accelerator + min(PRESS, max(RELEASE, want - accelerator))
    return Pedals(pedal, brake, braking, lifted, pushed, expected), missing


@kernel
def slow_down(
    p: DriverParameters,
    pedals: Pedals,
    mass: float,
    speed: float,
    wanted: float,
    throttle: float,
    missing: float,
) -> Pedals:
    """Return the pedals, the brake moved for the force (N) that is still missing.

    The others as in `accelerate`. A driver who does not brake never moves it.
    """
    if not p.brakes:
        return pedals
    braking = pedals.braking
    if braking:
        braking = missing > 0.0
    else:
        braking = missing > mass * BRAKES_BEYOND_MPS2 and wanted - speed < TOO_FAST_MPS
    want = 0.0
    if throttle < 0.0 and wanted < HALTING_MPS and speed < HOLD_BELOW_MPS:
        braking = True
        want = HOLDING_BRAKE
    elif braking:
        want = min(1.0, missing / (mass * GRAVITY * FULL_BRAKE_G))
    brake = pedals.brake + (want - pedals.brake) * RECORD_S / BRAKE_S
    if not braking and brake < BRAKE_OFF:
        brake = 0.0
    return Pedals(
        pedals.accelerator, brake, braking, pedals.lifted, pedals.pushed, pedals.expected_resistance
    )
