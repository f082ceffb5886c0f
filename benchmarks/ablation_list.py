"""The mechanisms of the default estimator, and what switches each of them off."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from judging import without_accelerometer
from variants import Variant, without

from canest.core.frames import FloatColumn
from canest.core.samples import VehicleFacts
from canest.estimators.default.constants import Constants, Vehicle, vehicle_of
from canest.estimators.default.driver import answer_log_likelihood
from canest.estimators.default.model import MODES, Scratch

#: a variance, limit, length or time that is never reached; and a likelihood that is none, but has a logarithm
NEVER, NOTHING = 1e12, 1e-300
#: no mode
NOWHERE = (0.0,) * MODES


def never(w: Any, surprise: float, innovation_mps: float, c: Constants) -> bool:
    """Take the place of `load.brakes_unseen`."""
    return False


def is_noise(missing_mps: float, var: float, c: Constants) -> bool:
    """Take the place of `sensors.no_noise_explains`."""
    return False


def as_modelled(levels: Any) -> float:
    """Take the place of `noise.unexplained`."""
    return 1.0


def no_noise(torque_Nm: FloatColumn) -> FloatColumn:
    """Take the place of `windows.zigzag`."""
    return np.zeros(len(torque_Nm))


def gain_unknown(is_open: bool, v: Vehicle) -> bool:
    """Take the place of `sensors.gain_is_known`."""
    return False


def on_smooth_roads(
    answered_N: float, u: float, metres: float, wander_1pm: float, bend_var: float, c: Constants
) -> float:
    """Take the place of `driver.answer_log_likelihood`."""
    found: float = answer_log_likelihood(answered_N, u, metres, c.smooth_wander_1pm, bend_var, c)
    return found


def no_evidence(
    answered_N: float, u: float, metres: float, wander_1pm: float, bend_var: float, c: Constants
) -> float:
    """Take the place of `driver.answer_log_likelihood`."""
    return 0.0


def same_bends(mix: Any, count: int, before: float, metres: float, c: Constants) -> float:
    """Take the place of `predict.follow_bends`."""
    return before


def all_differ(mix: Any, count: int, t: Scratch) -> None:
    """Take the place of `load.merge_loads`."""


def no_bound(mix: Any, count: int, c: Constants, v: Vehicle) -> None:
    """Take the place of `sensors.bound_delay`."""


def without_offset(facts: VehicleFacts, late_s: float, c: Constants) -> Vehicle:
    """Take the place of `constants.vehicle_of`, for a report that lacks no torque."""
    return vehicle_of(facts, late_s, c)._replace(offset_Nm=0.0)


def without_late(facts: VehicleFacts, late_s: float, c: Constants) -> Vehicle:
    """Take the place of `constants.vehicle_of`, for filtered states that are not late."""
    return vehicle_of(facts, late_s, c)._replace(late_s=0.0)


def pitch_as_stated(facts: VehicleFacts, late_s: float, c: Constants) -> Vehicle:
    """Take the place of `constants.vehicle_of`, for a pitch that is not learned."""
    return vehicle_of(facts, late_s, c)._replace(pitch_std=0.0)


MECHANISMS = (
    # -- the load
    Variant("another load after a stop", {"load_stop_s": NEVER}),
    Variant("stops too short for another load", {"shortest_stop_s": 0.0}),
    Variant("loads that say the same become one", patch={"kernel.merge_loads": all_differ}),
    Variant("a load that drifts", {"steady_duration_s": NEVER}),
    Variant("another load where innovations surprise", {"surprise_nis": NEVER}),
    Variant("hazard of another load in motion", {"motion_every_s": NEVER}),
    Variant("sharper bends where innovations surprise", {"sharp_curvature_1pm": 0.0}),
    Variant("brakes that nobody reports", patch={"kernel.brakes_unseen": never}),
    # -- the driver
    Variant("roads that answer the torque", {"answered_share": 0.0}),
    Variant("answers in part", patch={"driver._SHARE": 1.0, "driver._SHARE_VAR": 0.0}),
    Variant("answers drawn anew", {"answer_length_m": NEVER}),
    Variant("drivers whom the road does not answer", {"answered_share": 1.0}),
    Variant("evidence of fast torque", patch={"kernel.answer_log_likelihood": no_evidence}),
    Variant("rough roads that ask for more torque", patch={"kernel.answer_log_likelihood": on_smooth_roads}),
    # -- the road and the wind
    Variant("curved roads", {"straight_length_m": NEVER}),
    Variant("rough roads", {"smooth_length_m": NEVER}),
    Variant("curved and rough roads", {"straight_length_m": NEVER, "smooth_length_m": NEVER}),
    Variant("curvatures that follow the road", patch={"kernel.follow_bends": same_bends}),
    Variant("steps of the road", patch={"sensors.no_noise_explains": is_noise}),
    Variant("wander of a smooth road", {"smooth_wander_1pm": 0.0}),
    Variant("another wind, or torque that the report lacks, at once", {"jump_every_s": NEVER}),
    Variant("state: wind", {"wind_std_mps": 0.0}),
    Variant("state: wind, errors of the drag area", {"wind_std_mps": 0.0}, facts={"drag_area_accuracy": 0.0}),
    # -- states of the vehicle and of its signals
    Variant(
        "state: error of the rolling resistance",
        {"cold_share": 0.0},
        facts={"rolling_resistance_accuracy": 0.0},
    ),
    Variant("cold tyres", {"cold_share": 0.0}),
    Variant("state: delay of the torque", {"delay_std_s": 0.0}),
    Variant("state: lag of the torque, compliance of the driveline", {"windup_std_s2": 0.0}),
    Variant("state: crank torque that the report lacks", patch={"estimator.vehicle_of": without_offset}),
    Variant("state: bias of the accelerometer", {"bias_std_mps2": 0.0, "bias_wander_m2ps5": 0.0}),
    Variant("load that tilts the frame", {"load_tilt_mps2": 0.0}),
    Variant("state: pitch of the body", patch={"estimator.vehicle_of": pitch_as_stated}),
    Variant("wander of that bias", {"bias_wander_m2ps5": 0.0}),
    Variant("slip of the driven wheels", {"slip_per_mps2": 0.0}),
    Variant("the longest delay is a bound", patch={"kernel.bound_delay": no_bound}),
    Variant("delay kept where the road answers", patch={"sensors._HIDES_DELAY": NOWHERE}),
    Variant("torque that acts 0.08 s before its report", patch={"windows.SHIFT": 0, "estimator.SHIFT": 0}),
    Variant("noise of the speed kept from the accelerometer", patch={"kernel.gain_is_known": gain_unknown}),
    Variant("pitch of the body", facts={"pitch_rad_per_mps2": 0.0}),
    # -- noise
    Variant("force that the model lacks", {"force_std_share": 0.0}),
    Variant("rounding errors of the torque", {"longest_rounding_s": 0.0}),
    Variant("rounding errors that last", {"longest_rounding_s": 0.2}),
    Variant("noise levels that follow", {"noise_memory_windows": NEVER, "first_noise_windows": NEVER}),
    Variant("innovations of states left out of levels", {"noise_dominates": NEVER}),
    Variant("start of the level at a driveline's swing", {"driveline_swing_mps": 0.0}),
    Variant("driveline that swings", {"torque_rise_s": NEVER}),
    Variant("what a windup leaves", patch={"sensors._MISSED": 0.0}),
    Variant("noise of the torque", patch={"windows.zigzag": no_noise}),
    Variant("outliers cut", {"outlier_nis": NEVER}),
    Variant("mean of the innovations squared", patch={"noise._INCONSISTENT": NEVER}),
    Variant("variances that follow low-passed innovations", patch={"kernel.unexplained": as_modelled}),
    Variant("heavy tails of the likelihood", {"likelihood_floor": NOTHING}),
    Variant("dependent windows (power 1)", {"likelihood_power": 1.0}),
    # -- windows and gated samples
    Variant("retarders, bends and dwells while gated", {"hidden_force_share": 1e6}),
    Variant("mass kept while gated", patch={"sensors._HIDES_MASS": NOWHERE}),
    Variant("pitch kept while gated", patch={"sensors._HIDES_PITCH": NOWHERE}),
    Variant("speed of an undriven axle", edit=partial(without, "undriven_mps")),
    Variant("coasting", edit=partial(without, "coasting_N")),
    Variant("altitude", edit=partial(without, "altitude_m")),
    Variant("wander of the altitude", {"altitude_wander_m2ps": 0.0}),
    Variant("accelerometer", edit=without_accelerometer),
    Variant(
        "faults of the accelerometer",
        patch={"accelerometer._FEWEST": NEVER, "accelerometer._FEWEST_S": NEVER},
    ),
    # -- hypotheses and report
    Variant("improbable loads left out", {"left_out_share": 0.0}),
    Variant("sums over nodes", patch={"report._WIDEST": NEVER}),
    Variant("grade where the vehicle is by now", patch={"estimator.vehicle_of": without_late}),
)
