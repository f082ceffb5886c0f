"""Every constant of the estimator, once, with its unit (docs/theory.md, section 9, gives each its source)."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core.samples import VehicleFacts


class Prior(NamedTuple):
    """Standard deviations of the states before the first sample. Those "times u" hold for a known mass."""

    grade: float = 0.03  #: slope of a road
    delay_s: float = 0.04  #: beyond the usual delay of the reported torque
    slip_per_mps2: float = 0.005  #: slip of driven wheels per m/s2 of traction
    windup_s2: float = 0.02  #: speed that a driveline gives way per change of specific traction
    bias_mps2: float = 0.3  #: offset of an accelerometer, tilt of its mounting included
    pitch_rad_per_mps2: float = 0.006  #: mean and std of the pitch where the config does not state it
    pitch_share: float = 0.2  #: std of a stated pitch, as a share of it
    lag_s: float = 0.06  #: delay of the accelerometer against the speed
    height_var_m2: float = 6.25  #: variance of an altitude


class Road(NamedTuple):
    """How the grade changes along the road."""

    curvature_1pm: float = 2e-4  #: std of the change of the grade per metre, on a crest or in a sag
    straight_m: float = 500.0  #: mean length of a straight
    curved_m: float = 150.0  #: mean length of a crest or sag
    curve_m: float = 300.0  #: correlation length of the curvature
    roughness_1pm: float = 1e-8  #: variance that the grade gains per metre, on a smooth road
    roughest_1pm: float = 2e-5  #: and on the roughest
    whiteness: float = 0.1  #: gain of the roughness, per window, on the product of neighbouring innovations
    alike: float = 0.3  #: mean of that product beyond which a smooth road becomes a rough one
    mix_m: float = 20.0  #: distance between two exchanges of probability
    step_nis: float = 25.0  #: a normalised innovation squared beyond this is a step of the road
    height_wander_m2ps: float = 0.2  #: variance that the height gains per second (receiver drift)
    height_lost_s: float = 60.0  #: after a gap this long the height is unknown


class Driver(NamedTuple):
    """How torque follows the road: not at all, or the road's slope answers every change of the force."""

    answered_share: float = 0.9  #: prior probability of the second
    switch_m: float = 10_000.0  #: mean distance between two changes
    mix_m: float = 40.0  #: distance between two exchanges of probability
    response_share: float = 0.5  #: std of the response, as a share of the inverse mass
    response_m: float = 1000.0  #: its correlation length
    scatter_share: float = 1.0  #: std of one answer, as a share of the answer
    most_1pm: float = 2.5e-4  #: no road answers faster: change of the grade per metre
    usual_1pm: float = (
        3e-4  #: changes of the force beyond what this asks for in a second are the driver's own
    )
    usual_mps2: float = 0.02  #: and beyond this, whatever the road
    weight: float = 2.0  #: weight of that evidence, per open window


class Load(NamedTuple):
    """The load as a process."""

    stop_s: float = 130.0  #: mean standing time after which it has changed
    least_stop_s: float = 3.0  #: in a shorter stop nobody loads
    moving_probability: float = 0.01  #: that it has changed in motion, taken again at each challenge
    surprised_probability: float = 0.1  #: the same where an innovation has no other cause
    surprise_nis: float = 25.0
    drift_probability: float = 0.3  #: that it drifts (spreading, leaking, snow), likewise
    drift_1ps: float = 3e-4  #: std of a drift of the inverse mass, a share of it per second
    drifted_s: float = 10.0  #: how long it may have drifted before it is noticed
    challenge_s: float = 8.0  #: open gates between two challenges
    banks: int = 4  #: normal densities that stand for an unknown load, log-spaced
    spread: float = 0.7  #: their std, in their spacing


class Noise(NamedTuple):
    """What the model lacks."""

    careful: float = 20.0  #: a speed's noise starts this many times coarser than its resolution
    oscillation_mps: float = 0.05  #: or at this, what a driveline's oscillation may leave in one window
    loudest: float = 2.0  #: and is never more than this many times its start
    windows: float = 300.0  #: memory of a noise level
    first_windows: float = 10.0  #: that its start counts for
    doubted: float = 5.0  #: an innovation counts less once its variance is this many times the noise
    force_share: float = 0.02  #: force that the model lacks, as a share of the traction
    overrun_share: float = 0.1  #: the same in overrun (friction torque, blended brakes)
    force_s: float = 0.2  #: correlation time of the two
    longest_windows: float = 25.0  #: a rounding error of the torque lasts at most this long
    gust_mps: float = 0.1  #: std of the gusts
    gust_s: float = 5.0  #: their correlation time
    jitter_s: float = 0.004  #: the delay of the torque changes from frame to frame by this
    ringing: float = 0.75  #: share of a driveline's swing, squared, left a window later
    swing_mpN: float = 1e-6  #: speed of that swing per change of the traction, (m/s)/N
    outlier: float = 9.0  #: innovations are cut at the root of this, in stds
    power: float = 0.5  #: windows are not independent: share of the log likelihood that counts for the mass


class Wind(NamedTuple):
    """Wind along the road."""

    wind_mps: float = 1.7  #: std
    wind_m: float = 5000.0  #: correlation length
    usual_mps: float = 20.0  #: speed at which an error of the drag area is taken for a wind


class Closed(NamedTuple):
    """What is measured while the gates are closed."""

    force_share: float = 0.1  #: std of a retarder's force, of what a gate hides
    drag_mps2: float = 0.03  #: drag of an open driveline, and a vehicle that rocks on its tyres
    far_m: float = 100.0  #: further back a coasting happened on another road


class Constants(NamedTuple):
    """All of them."""

    prior: Prior = Prior()
    road: Road = Road()
    driver: Driver = Driver()
    load: Load = Load()
    noise: Noise = Noise()
    wind: Wind = Wind()
    closed: Closed = Closed()


CONSTANTS = Constants()


class Vehicle(NamedTuple):
    """What the loop needs of the vehicle, and of its signals' resolution."""

    least_u: float  #: 1/kg, of the heaviest mass
    most_u: float
    wind_mps: float  #: std, errors of the drag area included
    speed_floor_mps: float
    speed_loudest_mps: float
    sensed_floor_mps2: float
    torque_std_Nm: float
    response: float  #: std of the driver's response, 1/kg


def vehicle_of(facts: VehicleFacts, constants: Constants) -> Vehicle:
    """Return what the loop needs of a vehicle."""
    least, most = 1.0 / facts.mass_max_kg, 1.0 / facts.mass_min_kg
    wind, noise = constants.wind, constants.noise
    floor = facts.speed_step_mps / math.sqrt(12.0)
    # F = c v / 2: a drag area wrong by a share e is a wind of e v / 2
    drag_mps = 0.5 * wind.usual_mps * facts.drag_area_accuracy
    return Vehicle(
        least_u=least,
        most_u=most,
        wind_mps=math.hypot(wind.wind_mps, drag_mps),
        speed_floor_mps=floor,
        speed_loudest_mps=noise.loudest * max(noise.careful * floor, noise.oscillation_mps),
        sensed_floor_mps2=facts.accelerometer_step_mps2 / 2.0,
        torque_std_Nm=facts.torque_step_Nm / math.sqrt(12.0),
        response=constants.driver.response_share * math.sqrt(least * most),
    )


def gain_std(facts: VehicleFacts) -> float:
    """Return the std of the mass, as a share, that no driving takes away.

    M = F / a, F proportional to torque / radius, a to the radius: the radius counts twice.
    """
    return math.hypot(facts.torque_accuracy, 2.0 * facts.wheel_radius_accuracy)
