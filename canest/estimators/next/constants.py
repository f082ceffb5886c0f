"""Every constant of the estimator, once."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core.samples import VehicleFacts


class Constants(NamedTuple):
    """All."""

    # prior
    grade: float = 0.03
    delay_s: float = 0.04
    slip_per_mps2: float = 0.005
    windup_s2: float = 0.02
    bias_mps2: float = 0.3
    pitch_rad_per_mps2: float = 0.006
    pitch_share: float = 0.2
    height_var_m2: float = 6.25
    wind_mps: float = 2.0
    wind_m: float = 20000.0
    usual_mps: float = 20.0
    # road
    curvature_1pm: float = 2e-4
    straight_m: float = 500.0
    curved_m: float = 150.0
    curve_m: float = 300.0
    smooth_1pm: float = 1e-8
    rough_1pm: float = 6e-6
    roughens_m: float = 20000.0
    smoothens_m: float = 10000.0
    step_nis: float = 25.0
    mix_m: float = 20.0
    height_wander_m2ps: float = 0.2
    height_lost_s: float = 60.0
    # driver
    answered_share: float = 0.9
    driver_m: float = 10_000.0
    response_share: float = 0.5
    response_m: float = 1000.0
    scatter_share: float = 1.0
    most_1pm: float = 2.5e-4
    usual_1pm: float = 3e-4
    usual_mps2: float = 0.02
    own_weight: float = 2.0
    # load
    stop_s: float = 130.0
    least_stop_s: float = 3.0
    surprised_probability: float = 0.1
    surprise: float = 25.0
    call_m: float = 150.0
    usual_nis: float = 3.0
    spread: float = 0.7
    drift_1ps: float = 3e-4
    drift_begins_s: float = 2000.0
    drift_ends_s: float = 600.0
    # noise
    careful: float = 20.0
    oscillation_mps: float = 0.05
    loudest: float = 2.0
    windows: float = 300.0
    first_windows: float = 10.0
    doubted: float = 5.0
    force_share: float = 0.02
    overrun_share: float = 0.1
    force_s: float = 0.2
    longest_windows: float = 25.0
    gust_mps: float = 0.1
    gust_s: float = 5.0
    ringing: float = 0.75
    swing_mpN: float = 0.0
    outlier: float = 9.0
    outliers: float = 3e-4
    power: float = 0.5
    mode_power: float = 1.0
    closed_share: float = 0.1
    open_drag_mps2: float = 0.03
    far_m: float = 100.0
    prune: float = 1e-4
    merge: float = 0.02
    coarse_u: float = 1.0


CONSTANTS = Constants()


class Vehicle(NamedTuple):
    """What the loop needs of the vehicle and of its signals' resolution."""

    least_u: float
    most_u: float
    mean_u: float  #: of an unknown load
    var_u: float
    wind_mps: float
    speed_floor_mps: float
    speed_loudest_mps: float
    sensed_floor_mps2: float
    torque_std_Nm: float
    response: float
    roll_share: float
    late_s: float


def vehicle_of(facts: VehicleFacts, c: Constants, late_s: float) -> Vehicle:
    """Return what the loop needs of a vehicle."""
    least, most = 1.0 / facts.mass_max_kg, 1.0 / facts.mass_min_kg
    floor = facts.speed_step_mps / math.sqrt(12.0)
    drag_mps = 0.5 * c.usual_mps * facts.drag_area_accuracy
    width = math.log(most / least)
    mean = math.sqrt(least * most)
    var = (c.spread * width * mean) ** 2
    return Vehicle(
        least_u=least,
        most_u=most,
        mean_u=mean,
        var_u=var,
        wind_mps=math.hypot(c.wind_mps, drag_mps),
        speed_floor_mps=floor,
        speed_loudest_mps=c.loudest * max(c.careful * floor, c.oscillation_mps),
        sensed_floor_mps2=facts.accelerometer_step_mps2 / 2.0,
        torque_std_Nm=facts.torque_step_Nm / math.sqrt(12.0),
        response=c.response_share * math.sqrt(least * most),
        roll_share=facts.rolling_resistance_accuracy,
        late_s=late_s,
    )


def gain_std(facts: VehicleFacts) -> float:
    """Return the std of the mass, as a share, that no driving takes away."""
    return math.hypot(facts.torque_accuracy, 2.0 * facts.wheel_radius_accuracy)
