"""Automated gearbox: its shift programme, and the phases of a shift and of a launch."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import ENGAGED, LAUNCH, NEUTRAL, RAMP_IN, RAMP_OUT, RECORD_S, STANDING
from canest.simulation.engine import ROWS_PER_RADPS
from canest.simulation.parameters import GearboxParameters
from canest.simulation.states import GearboxState, Motion, OperatingPoint, Pedals

# All chosen. Speeds as multiples of a shift point or of the idle speed, torques as shares of full torque.
UPSHIFT_REACH = 3  #: an upshift goes this many gears up, less one
UPSHIFT_SHARE = 0.9  #: torque counted on in the higher gear
ABOVE_DOWNSHIFT = 1.08  #: speed after an upshift
UPSHIFT_ACCEL_MPS2 = 0.04  #: acceleration left after an upshift ...
OVERSPEED = 1.1  #: ... unless the engine turns this fast
DOWNSHIFT_BY_PEDAL = 0.12  #: at full pedal downshifts come this much earlier
PEDAL_PRESSED = 0.05
DOWNSHIFT_SHARE = 0.9  #: torque counted on in the next lower gear
LOWER_OVERSPEED = 1.05  #: speed after a downshift
STARTING_GEARS = 3
STARTING_SHARE = 0.6  #: torque counted on when starting
STARTING_ROW = 48  #: row of the full-torque table that counts when starting: 1200 rpm
STARTING_ACCEL_MPS2 = 1.0
ROLLING = 1.15  #: speed above the downshift point in the gear to start in

DECLUTCH = 0.88  #: the clutch opens below it
BETWEEN_SHIFTS_S = 1.2
SHIFTS_ABOVE_MPS = 0.5
RELEASED_SHARE, RELEASED_NM = 0.03, 5.0  #: clutch torque at which the gear comes out ...
RELEASE_LIMIT_S = 0.6  #: ... or after this time
SYNCHRONISED_RADPS = 2.0
NEUTRAL_LIMIT_S = 4.0
RELEASED_PEDAL = 0.005
HALTING_MPS = 0.05
STARTING_PEDAL = 0.03
STARTING_BRAKE = 0.3
LAUNCH_BELOW = 1.25  #: input speed below which a start needs the clutch


@kernel
def gear_for(
    p: GearboxParameters, gear: int, motion: Motion, point: OperatingPoint, pedal: float, mass: float,
    resistance: float,
) -> int:  # fmt: skip
    """Return the gear to be in, the present one where nothing speaks for another.

    pedal: 0..1. mass: kg. resistance: N.
    """
    ratios = p.ratios
    etas = p.efficiencies
    full = p.full_torque
    speed = motion.engine_speed
    chosen = gear
    if speed > p.upshift_low + (p.upshift_high - p.upshift_low) * pedal:
        for h in range(gear + 1, min(len(ratios), gear + UPSHIFT_REACH)):
            after = motion.input_speed * ratios[h] / ratios[gear]
            row = min(len(full) - 1, int(after * ROWS_PER_RADPS))
            spare = UPSHIFT_SHARE * full[row] * ratios[h] * etas[h] / p.wheel_radius - resistance
            if after > p.downshift * ABOVE_DOWNSHIFT and (
                spare > mass * UPSHIFT_ACCEL_MPS2 or speed > p.upshift_high * OVERSPEED
            ):
                chosen = h
    elif (
        speed < p.downshift * (1.0 + DOWNSHIFT_BY_PEDAL * pedal)
        and gear > 0
        and (pedal > PEDAL_PRESSED or speed < p.downshift)
    ):
        chosen = gear - 1
        pull = DOWNSHIFT_SHARE * full[point.torque_row] * ratios[chosen] * etas[chosen] / p.wheel_radius
        if gear > 1 and resistance > pull:
            chosen = gear - 2
        if motion.input_speed * ratios[chosen] / ratios[gear] > p.upshift_high * LOWER_OVERSPEED:
            chosen = gear
    return chosen


@kernel
def starting_gear(p: GearboxParameters, speed: float, mass: float, resistance: float) -> int:
    """Return the highest of the lowest three gears that pulls away; a higher one while it still rolls.

    speed: of the vehicle (m/s); the others as in `gear_for`.
    """
    ratios = p.ratios
    gears = len(ratios)
    gear = 0
    for h in range(min(STARTING_GEARS, gears)):
        torque = STARTING_SHARE * p.full_torque[min(len(p.full_torque) - 1, STARTING_ROW)]
        pull = torque * ratios[h] * p.efficiencies[h] / p.wheel_radius
        if pull > resistance + mass * STARTING_ACCEL_MPS2 and h < gears - 1:
            gear = h
    while gear < gears - 1 and speed / p.wheel_radius * ratios[gear] > p.downshift * ROLLING:
        gear += 1
    return gear


@kernel
def shift(
    p: GearboxParameters, state: GearboxState, motion: Motion, point: OperatingPoint, pedals: Pedals,
    mass: float, resistance: float, wanted: float,
) -> GearboxState:  # fmt: skip
    """Return the gearbox 5 ms later: one step of the sequence of phases.

    wanted: speed of the plan (m/s); the others as in `gear_for`.
    """
    before, gear, next_gear, phase_s, since_shift_s = state
    phase = before
    phase_s += RECORD_S
    since_shift_s += RECORD_S
    shifts = p.fixed_gear < 0 and not p.electric and motion.speed > SHIFTS_ABOVE_MPS
    too_slow = not p.electric and motion.input_speed < DECLUTCH * p.idle
    if phase == ENGAGED:
        if too_slow:
            phase = STANDING
        elif since_shift_s > BETWEEN_SHIFTS_S and shifts and not pedals.braking:
            next_gear = gear_for(p, gear, motion, point, pedals.accelerator, mass, resistance)
            if next_gear != gear:
                phase = RAMP_OUT
    elif phase == RAMP_OUT:
        if phase_s >= p.ramp_s and comes_out(motion.clutch_torque, point.highest, phase_s):
            phase = NEUTRAL
            gear = next_gear
    elif phase == NEUTRAL:
        if phase_s >= p.neutral_s and abs(motion.engine_speed - motion.input_speed) < SYNCHRONISED_RADPS:
            phase = RAMP_IN
        elif phase_s > NEUTRAL_LIMIT_S or too_slow:
            phase = STANDING
    elif phase == RAMP_IN:
        if phase_s >= p.ramp_s:
            phase = ENGAGED
            since_shift_s = 0.0
    elif phase == LAUNCH:
        if pedals.accelerator < RELEASED_PEDAL and wanted < HALTING_MPS:
            phase = STANDING
    elif pedals.accelerator > STARTING_PEDAL and pedals.brake < STARTING_BRAKE:
        gear = p.fixed_gear
        if gear < 0:
            gear = starting_gear(p, motion.speed, mass, resistance)
        rolling = motion.wheel_speed * p.ratios[gear] >= p.idle * LAUNCH_BELOW
        phase = NEUTRAL if rolling else LAUNCH
    # a launch that is given up goes on counting
    if before not in (phase, LAUNCH):
        phase_s = 0.0
    return GearboxState(phase, gear, next_gear, phase_s, since_shift_s)


@kernel
def comes_out(clutch_torque: float, highest: float, phase_s: float) -> bool:
    """Return whether so little torque is left that the gear can be taken out."""
    return abs(clutch_torque) < RELEASED_SHARE * highest + RELEASED_NM or phase_s > RELEASE_LIMIT_S
