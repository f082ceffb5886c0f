"""The driver's feet, every 5 ms: accelerator and brake for what the plan wants."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import BRAKE, GRAVITY, MASS, PEDAL, RECORD_S, SPEED
from canest.simulation.engine import TINY_NM
from canest.simulation.parameters import DriverParameters
from canest.simulation.states import (
    BRAKING,
    EXPECTED,
    FRICTION,
    HIGHEST,
    LEAST_FORCE,
    LIFTED,
    PUSHED,
    ROAD_LOAD,
    TORQUE_PER_FORCE,
    State,
)

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
def accelerate(p: DriverParameters, x: State, wanted: float, throttle: float) -> float:
    """Move the accelerator; return the force (N) to slow down with that the engine lacks.

    wanted: speed of the plan (m/s). throttle: of the plan, negative for none.
    """
    speed = x[SPEED]
    expected = x[EXPECTED]
    expected += (x[ROAD_LOAD] - expected) * RECORD_S / EXPECTATION_S
    x[EXPECTED] = expected
    missing = 0.0
    if throttle >= 0.0:
        # beyond the upper speed the rest of the pulse is dropped, below the lower one it is prolonged
        if speed > wanted:
            x[LIFTED] = True
        elif throttle == 0.0:
            x[LIFTED] = False
        if speed < p.pulse_min:
            x[PUSHED] = True
        elif speed > p.pulse_min + PULSE_BAND_MPS:
            x[PUSHED] = False
        want = 1.0 if x[PUSHED] else 0.0 if x[LIFTED] else throttle
    else:
        accel = p.firmness * (wanted - speed)
        if accel > p.accel_limit:
            accel = p.accel_limit
        elif accel < DECELERATION_MPS2:
            accel = DECELERATION_MPS2
        force = expected + x[MASS] * accel
        asked = force * x[TORQUE_PER_FORCE] + x[FRICTION] + p.regeneration
        want = asked / (x[HIGHEST] + p.regeneration + TINY_NM)
        missing = x[LEAST_FORCE] - force
        if wanted < HALTING_MPS and speed < ROLLING_OUT_MPS:
            want = 0.0
    if want < 0.0:
        want = 0.0
    elif want > 1.0:
        want = 1.0
    pedal = x[PEDAL]
    change = want - pedal
    if change < RELEASE:
        change = RELEASE
    elif change > PRESS:
        change = PRESS
    x[PEDAL] = pedal + change
    return missing


@kernel
def slow_down(x: State, wanted: float, throttle: float, missing: float) -> None:
    """Move the brake for the force (N) that is still missing; the others as in `accelerate`."""
    mass = x[MASS]
    speed = x[SPEED]
    braking = missing > 0.0
    if not x[BRAKING]:
        braking = missing > mass * BRAKES_BEYOND_MPS2 and wanted - speed < TOO_FAST_MPS
    want = 0.0
    if throttle < 0.0 and wanted < HALTING_MPS and speed < HOLD_BELOW_MPS:
        braking = True
        want = HOLDING_BRAKE
    elif braking:
        want = min(1.0, missing / (mass * GRAVITY * FULL_BRAKE_G))
    brake = x[BRAKE]
    brake += (want - brake) * RECORD_S / BRAKE_S
    if not braking and brake < BRAKE_OFF:
        brake = 0.0
    x[BRAKE] = brake
    x[BRAKING] = braking
