"""What `canest` believes before the first sample: priors of states and noise levels, each with its source.

All of it follows from vehicle facts and signal resolution; nothing is tuned to one vehicle. What a vehicle
can be wrong by (wind, tyres, torque map) is a distribution here, so that its share never averages out of
the standard deviations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from canest.core.samples import GRAVITY_MPS2, VehicleFacts
from canest.estimators.canest_0_1.states import (
    BIAS,
    CURVATURE,
    DELAY,
    GRADE,
    PITCH,
    SENSE_LAG,
    SLIP,
    STATES,
    WIND,
    WINDUP,
    U,
)

#: reported torque over true net torque: within 2 % (uniform), so std 2 % / sqrt(3); never observable
TORQUE_GAIN_STD = 0.0115
#: declared over true rolling resistance: within 15 %, the spread of tyres, load and temperature
ROLLING_SHARE_STD = 0.087
#: wind along the road: within 3 m/s
WIND_STD_MPS = 1.7
#: torque is reported about this much later or less late than usual (engine controller, 20 ms cycle, gateway);
#: what is usual is `canest_windows.SHIFT`
DELAY_STD_S = 0.04
#: slip of driven wheels per m/s2 of traction: tyre stiffness of some 20 to 30 per unit of slip
SLIP_STD_PER_MPS2 = 0.005
#: a driveline winds up (half-shafts of 200 kNm/rad, half-metre wheels, 16 t), and a swinging one
#: looks the other way: change of speed per change of specific traction, m/s per m/s3
WINDUP_STD_S2 = 0.02
#: an undriven axle's speed comes later (100 ms cycle) and from another tyre radius
LAG_S, LAG_STD_S, SCALE_STD = 0.05, 0.05, 0.02
#: the axle's own filter begins this much less sure of slip than the main one: it only adds what it measures
UNSURE = 100.0
#: an accelerometer is this much later than the speed, its own filter and the body's springs included
SENSE_LAG_STD_S = 0.06
#: accelerometer offset, tilt of its mounting included
BIAS_STD_MPS2 = 0.3
#: body pitch per m/s2: as declared within 20 %, else what springs do
PITCH_RAD_PER_MPS2, PITCH_STD_RAD_PER_MPS2, PITCH_SHARE_STD = 0.006, 0.006, 0.2
#: a speed's noise is at first taken this many times coarser than its resolution: drivelines swing
CAREFUL = 20.0
#: speed that a driveline's oscillation may leave in one window until the data says how much, m/s
OSCILLATION_MPS = 0.05
#: and never more than this many times coarser than it is at first
LOUDEST = 2.0
#: grades of roads: std of the grade, and of its change per metre on a crest or in a sag (radii from 2 km)
GRADE_STD, CURVATURE_STD_1PM = 0.03, 2e-4


@dataclass(frozen=True, slots=True)
class Prior:
    """Mean and standard deviation of every state, shape (STATES,), and the floors of the noise levels.

    axle_mean, axle_std: the same of the undriven axle's own filter, shape (AXLE_STATES,).
    Noise levels are standard deviations of one window's measurement: speed (m/s), accelerometer (m/s2),
    undriven speed (m/s). torque_std_Nm: std of the reported crank torque within its resolution.
    """

    mean: list[float]
    std: list[float]
    axle_mean: list[float]
    axle_std: list[float]
    noise_floor: tuple[float, float, float]
    noise_start: tuple[float, float, float]
    torque_std_Nm: float


def prior_of(facts: VehicleFacts, mass_kg: float | None = None, mass_std_kg: float | None = None) -> Prior:
    """Return the prior for a vehicle: its whole range of masses, or a remembered mass with its std.

    A user's guess does not enter: levers are taken at the state, so none would be forgotten quite.
    """
    light, heavy = 1.0 / facts.mass_min_kg, 1.0 / facts.mass_max_kg
    typical = math.sqrt(light * heavy)
    mean, std = [0.0] * STATES, [0.0] * STATES
    mean[U] = 1.0 / mass_kg if mass_kg is not None else 0.5 * (light + heavy)
    std[U] = mass_std_kg * mean[U] ** 2 if mass_std_kg is not None else 0.5 * (light - heavy)
    # products with the inverse mass stay linear; their prior is that of a typical mass
    std[DELAY] = typical * DELAY_STD_S
    std[SLIP] = typical * SLIP_STD_PER_MPS2
    std[WIND] = typical * WIND_STD_MPS
    std[WINDUP] = typical * WINDUP_STD_S2
    mean[GRADE], std[GRADE] = facts.initial_grade or 0.0, GRADE_STD
    std[CURVATURE] = CURVATURE_STD_1PM
    std[BIAS] = BIAS_STD_MPS2
    std[SENSE_LAG] = SENSE_LAG_STD_S
    if facts.pitch_rad_per_mps2 is None:
        mean[PITCH] = GRAVITY_MPS2 * PITCH_RAD_PER_MPS2
        std[PITCH] = GRAVITY_MPS2 * PITCH_STD_RAD_PER_MPS2
    else:
        mean[PITCH] = GRAVITY_MPS2 * facts.pitch_rad_per_mps2
        std[PITCH] = GRAVITY_MPS2 * max(PITCH_SHARE_STD * abs(facts.pitch_rad_per_mps2), 1e-3)
    floors = (
        facts.speed_step_mps / math.sqrt(12.0),
        facts.accelerometer_step_mps2 / 2.0,
        facts.speed_step_mps,
    )
    start = (
        max(CAREFUL * floors[0], OSCILLATION_MPS),
        2.0 * floors[1],
        max(CAREFUL * floors[2], OSCILLATION_MPS),
    )
    axle_mean, axle_std = [0.0, LAG_S, 0.0], [UNSURE * std[SLIP], LAG_STD_S, SCALE_STD]
    return Prior(mean, std, axle_mean, axle_std, floors, start, facts.torque_step_Nm / math.sqrt(12.0))
