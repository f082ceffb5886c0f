"""Automated gearbox: its shift programme, and the phases of a shift and of a launch."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import (
    BRAKE,
    ENGAGED,
    ENGINE_SPEED,
    GEAR,
    LAUNCH,
    MASS,
    NEUTRAL,
    PEDAL,
    PHASE,
    RAMP_IN,
    RAMP_OUT,
    RECORD_S,
    SPEED,
    STANDING,
    WHEEL_SPEED,
)
from canest.simulation.engine import ROWS_PER_RADPS
from canest.simulation.parameters import GearboxParameters
from canest.simulation.states import (
    BRAKING,
    CLUTCH_TORQUE,
    HIGHEST,
    INPUT_SPEED,
    NEXT_GEAR,
    PHASE_S,
    ROAD_LOAD,
    SINCE_SHIFT_S,
    TORQUE_ROW,
    State,
)

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
def gear_for(p: GearboxParameters, x: State) -> int:
    """Return the gear to be in, the present one where nothing speaks for another."""
    ratios = p.ratios
    etas = p.efficiencies
    full = p.full_torque
    gear = int(x[GEAR])
    pedal = x[PEDAL]
    resistance = x[ROAD_LOAD]
    speed = x[ENGINE_SPEED]
    input_speed = x[INPUT_SPEED]
    chosen = gear
    if speed > p.upshift_low + (p.upshift_high - p.upshift_low) * pedal:
        for h in range(gear + 1, min(len(ratios), gear + UPSHIFT_REACH)):
            after = input_speed * ratios[h] / ratios[gear]
            row = min(len(full) - 1, int(after * ROWS_PER_RADPS))
            spare = UPSHIFT_SHARE * full[row] * ratios[h] * etas[h] / p.wheel_radius - resistance
            if after > p.downshift * ABOVE_DOWNSHIFT and (
                spare > x[MASS] * UPSHIFT_ACCEL_MPS2 or speed > p.upshift_high * OVERSPEED
            ):
                chosen = h
    elif (
        speed < p.downshift * (1.0 + DOWNSHIFT_BY_PEDAL * pedal)
        and gear > 0
        and (pedal > PEDAL_PRESSED or speed < p.downshift)
    ):
        chosen = gear - 1
        row = int(x[TORQUE_ROW])
        pull = DOWNSHIFT_SHARE * full[row] * ratios[chosen] * etas[chosen] / p.wheel_radius
        if gear > 1 and resistance > pull:
            chosen = gear - 2
        if input_speed * ratios[chosen] / ratios[gear] > p.upshift_high * LOWER_OVERSPEED:
            chosen = gear
    return chosen


@kernel
def starting_gear(p: GearboxParameters, speed: float, mass: float, resistance: float) -> int:
    """Return the highest of the lowest three gears that pulls away; a higher one while it still rolls.

    speed: of the vehicle (m/s). mass: kg. resistance: N.
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
def shift(p: GearboxParameters, x: State, wanted: float) -> None:
    """Take one step of the sequence of phases. wanted: speed of the plan (m/s)."""
    before = x[PHASE]
    phase = before
    phase_s = x[PHASE_S] + RECORD_S
    x[SINCE_SHIFT_S] += RECORD_S
    too_slow = not p.electric and x[INPUT_SPEED] < DECLUTCH * p.idle
    if phase == ENGAGED:
        if too_slow:
            phase = STANDING
        elif may_shift(p, x):
            x[NEXT_GEAR] = gear_for(p, x)
            if x[NEXT_GEAR] != x[GEAR]:
                phase = RAMP_OUT
    elif phase == RAMP_OUT:
        if phase_s >= p.ramp_s and comes_out(x[CLUTCH_TORQUE], x[HIGHEST], phase_s):
            phase = NEUTRAL
            x[GEAR] = x[NEXT_GEAR]
    elif phase == NEUTRAL:
        if phase_s >= p.neutral_s and abs(x[ENGINE_SPEED] - x[INPUT_SPEED]) < SYNCHRONISED_RADPS:
            phase = RAMP_IN
        elif phase_s > NEUTRAL_LIMIT_S or too_slow:
            phase = STANDING
    elif phase == RAMP_IN:
        if phase_s >= p.ramp_s:
            phase = ENGAGED
            x[SINCE_SHIFT_S] = 0.0
    elif phase == LAUNCH:
        if x[PEDAL] < RELEASED_PEDAL and wanted < HALTING_MPS:
            phase = STANDING
    elif x[PEDAL] > STARTING_PEDAL and x[BRAKE] < STARTING_BRAKE:
        gear = p.fixed_gear
        if gear < 0:
            gear = starting_gear(p, x[SPEED], x[MASS], x[ROAD_LOAD])
        x[GEAR] = gear
        rolling = x[WHEEL_SPEED] * p.ratios[gear] >= p.idle * LAUNCH_BELOW
        phase = NEUTRAL if rolling else LAUNCH
    x[PHASE] = phase
    kept = before == phase
    # a launch that is given up goes on counting
    x[PHASE_S] = phase_s if kept or before == LAUNCH else 0.0


@kernel
def may_shift(p: GearboxParameters, x: State) -> bool:
    """Return whether an engaged gearbox may look for another gear."""
    ready = x[SINCE_SHIFT_S] > BETWEEN_SHIFTS_S and x[SPEED] > SHIFTS_ABOVE_MPS
    return ready and p.fixed_gear < 0 and not p.electric and not x[BRAKING]


@kernel
def comes_out(clutch_torque: float, highest: float, phase_s: float) -> bool:
    """Return whether so little torque is left that the gear can be taken out."""
    return abs(clutch_torque) < RELEASED_SHARE * highest + RELEASED_NM or phase_s > RELEASE_LIMIT_S
