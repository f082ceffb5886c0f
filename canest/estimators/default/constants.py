"""The constants of the theory: symbol, unit and source beside each (docs/theory.md, section 9)."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from canest.core.samples import GRAVITY_MPS2, VehicleFacts
from canest.estimators.windowing import WINDOW_S


class Constants(NamedTuple):
    """All of them, each with its symbol, unit and source: chosen (the trade-off), measured, or literature."""

    # -- before the first sample
    grade_std: Annotated[float, "s_theta", "1", "chosen: country roads end at about 10 %"] = 0.03
    delay_std_s: Annotated[float, "s_delta", "s", "chosen: two cycles of an engine message"] = 0.04
    longest_delay_s: Annotated[float, "d_max", "s", "measured: vehicles to 0.19 s; masses fail at 0.4"] = 0.32
    windup_std_s2: Annotated[float, "s_gamma", "s2", "chosen: a lag of 0.14 s; more hides the mass"] = 0.02
    bias_std_mps2: Annotated[float, "s_b", "m/s2", "chosen: 1.8 degrees of tilt of a mounting"] = 0.3
    pitch_rad_per_mps2: Annotated[float, "p_m", "rad s2/m", "measured: mean and std; trucks 0.01"] = 0.005
    cold_share: Annotated[float, "k_rho", "1", "literature: cold tyres roll 20 to 50 % harder"] = 0.25
    altitude_std_m: Annotated[float, "s_h", "m", "chosen: a satellite receiver"] = 2.5
    wind_std_mps: Annotated[float, "s_w", "m/s", "chosen: 7 m/s in three; more widens cruises"] = 2.3
    wind_length_m: Annotated[float, "L_w", "m", "chosen: roads turn; less widens a cruise"] = 20e3
    jump_every_s: Annotated[float, "T_j", "s", "measured: 1000 makes gusts loads, 150 cruises wide"] = 250.0
    jump_stds: Annotated[float, "k_j", "1", "measured: at 2 accessories that switch are loads"] = 3.0
    unknown_load_share: Annotated[float, "k_u", "1", "measured: std by range of ln u; 0.3 is too sure"] = 0.7
    curvature_std_1pm: Annotated[float, "s_kappa", "1/m", "chosen: radius 5 km, country roads"] = 2e-4
    sharp_curvature_1pm: Annotated[float, "s_K", "1/m", "chosen: streets; less takes crests for loads"] = 8e-4
    straight_length_m: Annotated[float, "L_s", "m", "chosen: shorter says less of the mass"] = 500.0
    curved_length_m: Annotated[float, "L_c", "m", "chosen: length of a crest"] = 150.0
    curvature_length_m: Annotated[float, "L_kappa", "m", "chosen: a crest keeps a curvature"] = 300.0
    smooth_wander_1pm: Annotated[float, "q_s", "1/m", "chosen: 0.3 % of grade in a kilometre"] = 1e-8
    rough_wander_1pm: Annotated[float, "q_r", "1/m", "measured: 1.5 % RMS, waves from 50 m"] = 6e-6
    smooth_length_m: Annotated[float, "L_r", "m", "chosen: rough roads are rare"] = 20e3
    rough_length_m: Annotated[float, "L_rs", "m", "measured: at 2 km rough is forgotten"] = 10e3
    exchange_every_s: Annotated[float, "t_x", "s", "chosen: cost against delay"] = 1.0
    altitude_wander_m2ps: Annotated[float, "q_h", "m2/s", "chosen: a receiver, 3.5 m a minute"] = 0.2
    # -- engine
    offset_duration_s: Annotated[float, "T_xi", "s", "chosen: accessories run for minutes"] = 600.0
    # -- driver
    answered_share: Annotated[float, "P_a", "1", "chosen: less makes a cruise less safe"] = 0.8
    answer_length_m: Annotated[float, "L_a", "m", "measured: less fails on waves, more on unloading"] = 500.0
    driver_length_m: Annotated[float, "L_d", "m", "chosen: a habit is kept for ten minutes"] = 10e3
    answer_noise_mps2: Annotated[float, "a_d", "m/s2", "measured: less finds cruise controls free"] = 0.03
    # -- load
    load_stop_s: Annotated[float, "T_l", "s", "chosen: less costs `valid` at every light"] = 130.0
    shortest_stop_s: Annotated[float, "T_min", "s", "chosen: up to here rarer than a miss of two std"] = 7.0
    motion_change_s: Annotated[float, "T_g", "s", "measured: less finds loads sooner, costs `valid`"] = 10e3
    motion_every_s: Annotated[float, "t_m", "s", "chosen: cost against delay"] = 20.0
    load_tilt_mps2: Annotated[float, "s_t", "m/s2", "chosen: 0.3 degrees; more takes brakes for loads"] = 0.05
    drift_1ps: Annotated[float, "m_r", "1/s", "measured: 5 kg/s of 20 t; more costs `valid`"] = 2.5e-4
    steady_duration_s: Annotated[float, "T_rb", "s", "measured: more finds late, less widens cruises"] = 2e3
    drift_duration_s: Annotated[float, "T_re", "s", "measured: at 900 a car is 17 % off"] = 600.0
    gross_nis: Annotated[float, "S_max", "1", "chosen: five std; a road's step, in sum a surprise"] = 25.0
    surprise_nis: Annotated[float, "S_0", "1", "measured: at 2, rough driving is a surprise"] = 3.0
    surprise_share: Annotated[float, "P_S", "1", "measured: less misses tippers, more costs `valid`"] = 0.009
    # -- noise
    force_std_share: Annotated[float, "k_F", "1", "chosen: a controller's momentary torque"] = 0.02
    torque_noise_times: Annotated[float, "k_n", "1", "measured: at 2 masses are 12 % too high"] = 4.0
    longest_rounding_s: Annotated[float, "t_q", "s", "measured: less is too sure of a car"] = 2.0
    slip_per_mps2: Annotated[float, "k_lambda", "s2/m", "literature: Gustafsson 1997, stiffness 40"] = 0.0025
    driveline_swing_mps: Annotated[float, "s_v", "m/s", "measured: 0.02 is too sure, 0.05 too wide"] = 0.038
    torque_rise_s: Annotated[float, "t_v", "s", "measured: more makes first masses light, less wide"] = 0.1
    swing_damping: Annotated[float, "D", "1", "chosen: drivelines 0.05 to 0.2, clutches add to it"] = 0.3
    first_noise_steps: Annotated[float, "k_v", "1", "chosen: first level, in rounding errors"] = 20.0
    noise_memory_windows: Annotated[float, "N_v", "1", "chosen: a minute of open gates"] = 300.0
    first_noise_windows: Annotated[float, "N_0", "1", "chosen: weight of the start"] = 10.0
    noise_dominates: Annotated[float, "k_R", "1", "measured: without it a bus is less valid"] = 5.0
    outlier_nis: Annotated[float, "k_e", "1", "textbook: three standard deviations"] = 9.0
    likelihood_floor: Annotated[float, "c_0", "1", "chosen: one window in seventy is anything"] = 6e-4
    likelihood_power: Annotated[float, "alpha", "1", "measured: at 1 cruises are too sure"] = 0.5
    bias_wander_m2ps5: Annotated[float, "q_b", "(m/s2)2/s", "chosen: 0.04 m/s2 an hour; more is wide"] = 4e-7
    # -- closed gates
    hidden_force_share: Annotated[float, "k_c", "1", "chosen: retarder, gearbox that closes"] = 0.1
    hidden_windows: Annotated[float, "N_c", "1", "chosen: such an error lasts 5 s"] = 25.0
    coasting_std_mps2: Annotated[float, "s_c", "m/s2", "chosen: an open driveline's 300 N on 20 t"] = 0.015
    # -- hypotheses and report
    least_weight: Annotated[float, "P_min", "1", "measured: at 1e-3 modes are missing later"] = 3e-4
    left_out_share: Annotated[float, "P_out", "1", "chosen: false alarms against new loads"] = 0.01


CONSTANTS = Constants()

#: no signal is finer than this, m/s and m/s2: noise levels stay above zero
_FINEST = 1e-4
#: variance of what a body does that its pitch does not tell, by acceleration squared: a stated pitch (0.007
#: rad per m/s2), a learned one, and one that slow signals do not teach, whose error lasts
_STATED, _LEARNED, _UNKNOWN = 0.005, 0.015, 0.05
#: a pitch that nobody states may be 0.02 rad per m/s2 from the mean: g times that, m/s2 per m/s2
_ANY_PITCH = 0.2


class Vehicle(NamedTuple):
    """What the loop needs of the vehicle, and of its signals' resolution."""

    least_u: float  #: 1/kg, of the heaviest mass
    most_u: float
    unknown_u: float  #: mean and variance of the inverse mass of an unknown load
    unknown_var: float
    drag_share: float  #: std of the drag area, as a share
    speed_floor_mps: float
    speed_first_mps: float  #: first noise level
    sensed_floor_mps2: float
    torque_std_Nm: float
    slip_per_mps2: float  #: of the driven wheels per m/s2 of traction
    offset_Nm: float  #: std of the crank torque that the report lacks: half a step at least
    period_windows: float  #: windows between two reports of a slow signal
    late_s: float  #: how much older than the samples the filtered states are
    pitch: float  #: of the body, m/s2 of the accelerometer per m/s2
    pitch_std: float  #: zero where it is stated, or is not learned
    pitch_slack: float  #: share by which the accelerometer's ratio may be off because the pitch is not known
    felt_windup: float  #: share that a body feels: 1 where the torque lags, 0 where a driveline gives way
    rocking: float  #: variance of what it does beside, by acceleration squared


def vehicle_of(facts: VehicleFacts, late_s: float, c: Constants) -> Vehicle:
    """Return what the loop needs of a vehicle."""
    least, most = 1.0 / facts.mass_max_kg, 1.0 / facts.mass_min_kg
    unknown = math.sqrt(least * most)
    floor = max(facts.speed_step_mps, _FINEST) / math.sqrt(12.0)
    stated, windows = facts.pitch_rad_per_mps2, facts.report_period_s / WINDOW_S
    learns_pitch = stated is None and windows <= 1.0
    return Vehicle(
        least_u=least,
        most_u=most,
        unknown_u=unknown,
        unknown_var=(c.unknown_load_share * math.log(most / least) * unknown) ** 2,
        drag_share=facts.drag_area_accuracy,
        speed_floor_mps=floor,
        speed_first_mps=max(c.first_noise_steps * floor, c.driveline_swing_mps),
        sensed_floor_mps2=max(facts.accelerometer_step_mps2, _FINEST) / 2.0,
        torque_std_Nm=facts.torque_step_Nm / math.sqrt(12.0),
        slip_per_mps2=c.slip_per_mps2 if facts.slips else 0.0,
        offset_Nm=max(0.5 * facts.torque_step_Nm, facts.unreported_torque_Nm),
        period_windows=float(math.ceil(windows - 1e-6)) if windows > 1.0 else 0.0,
        late_s=late_s,
        pitch=GRAVITY_MPS2 * (c.pitch_rad_per_mps2 if stated is None else stated),
        pitch_std=GRAVITY_MPS2 * c.pitch_rad_per_mps2 if learns_pitch else 0.0,
        pitch_slack=_ANY_PITCH if stated is None else 0.0,
        felt_windup=1.0 if facts.torque_lags else 0.0,
        rocking=_LEARNED if learns_pitch else _UNKNOWN if stated is None else _STATED,
    )
