"""The loop over windows: what has changed, predict and update every hypothesis, weigh, merge, report."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.accelerometer import Comparison, compare
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.hypotheses import (
    Filters,
    Room,
    exchange,
    mean_inverse_mass,
    merge_alike,
    prune_impossible,
    weigh_loads,
    weigh_modes,
)
from canest.estimators.default.load import Standing, changed_probability, open_load, question_drift, stand
from canest.estimators.default.model import (
    CURVATURE,
    CURVED_ANSWERED,
    CURVED_FREE,
    MODES,
    RESPONSE,
    STRAIGHT_ANSWERED,
    STRAIGHT_FREE,
    WIND,
    Window,
)
from canest.estimators.default.noise import Innovations, Levels, follow, unknown_force
from canest.estimators.default.predict import decay
from canest.estimators.default.report import Report, report, unknown_load_var
from canest.estimators.default.road_map import RoadUse, follow_road
from canest.estimators.default.sensors import Levers, Scratch
from canest.estimators.default.step import Common, step
from canest.estimators.default.windows import WINDOW_S

#: an accelerometer is used in every other window: its filter correlates neighbours
_SEE_EVERY = 2.0
#: weight of the newest window in the slow speed; all of it in the first windows of a balance
_CALM, _FRESH = 0.02, 3.0
#: columns of the output, one row per window
OUTPUTS = 8
OUT_MASS, OUT_VAR, OUT_GRADE, OUT_GRADE_VAR, OUT_BEND, OUT_LEARNED, OUT_SPEED, OUT_LIVE = range(OUTPUTS)


class Progress(NamedTuple):
    """What is carried from window to window beside the densities."""

    mixed_m: float = 0.0  #: metres since the modes of the road exchanged probability
    driven_m: float = 0.0  #: since those of the driver did
    open_windows: float = 0.0  #: of this balance
    calm_mps: float = 0.0  #: slow speed
    slow_N: float = 0.0  #: slow traction
    force_N: float = 0.0  #: of the window before
    follows: float = 0.0  #: 1 where that force was known
    unseen: float = 0.0  #: windows since the accelerometer was used
    height_known: float = 0.0
    learned: float = 0.0  #: 1 once a window was open
    accel_mps2: float = 0.0  #: of the window before
    challenged_s: float = 0.0  #: open gates since the last challenge
    faulty: float = 0.0  #: 1 where the accelerometer is left out
    surprised: float = 0.0  #: 1 where an innovation was beyond all noise


class Carried(NamedTuple):
    """All of it."""

    progress: Progress
    standing: Standing
    levels: Levels
    comparison: Comparison
    report: Report
    road: RoadUse


@jit.kernel
def window_at(c: Any, k: int) -> Window:
    """Return window k of the columns."""
    return Window(
        c[0][k], c[1][k], c[2][k], c[3][k], c[4][k], c[5][k], c[6][k], c[7][k], c[8][k], c[9][k],
        c[10][k], c[11][k], c[12][k], c[13][k], c[14][k], c[15][k], c[16][k], c[17][k], c[18][k], c[19][k],
        c[20][k], c[21][k], c[22][k], c[23][k], c[24][k], c[25][k], c[26][k], c[27][k], c[28][k],
    )  # fmt: skip


@jit.kernel
def answered_force(w: Window, p: Progress, metres: float, u: float, begins: bool, c: Constants) -> float:
    """Return dF / g, the change of the force that the road may answer, kg.

    No road answers faster than it can bend: |u dF / g| <= most ds.
    """
    change = 0.0
    if w.open > 0.0:
        change = w.traction_N - w.before_N
    elif w.retarding > 0.0 and p.follows > 0.0 and w.gap_s == 0.0:
        change = w.force_N - p.force_N
    if change == 0.0:
        return 0.0
    most = c.driver.most_1pm * metres * GRAVITY_MPS2 / u
    return min(max(change, -most), most) / GRAVITY_MPS2


@jit.kernel
def own_torque(fast_N: float, u: float, speed_mps: float, roughness_1pm: float, c: Constants) -> float:
    """Return how much less probable a change of torque is where it answers the road (log likelihood).

    A road bends by about `usual_1pm`; what moves faster within a second is the driver's own. A free driver
    may do anything, so slow changes speak for neither.
    """
    d = c.driver
    usual = GRAVITY_MPS2 * d.usual_1pm * max(speed_mps, 1.0)
    rough = GRAVITY_MPS2 * GRAVITY_MPS2 * roughness_1pm * max(speed_mps, 1.0)
    ratio = u * u * fast_N * fast_N / (usual * usual + rough + d.usual_mps2 * d.usual_mps2)
    return -d.weight * min(0.5 * max(ratio - 1.0, 0.0), 30.0)


@jit.kernel
def change_modes(
    filters: Filters, metres: float, driven_m: float, u: float, c: Constants, v: Vehicle, room: Room
) -> None:
    """Let wind, curvature and response fade, and modes exchange probability.

    metres: since the last exchange of the road's modes (0: none now). driven_m: of the driver's, likewise.
    """
    road, driver = c.road, c.driver
    bends, ends = 1.0 - math.exp(-metres / road.straight_m), 1.0 - math.exp(-metres / road.curved_m)
    bent, calm = math.exp(-metres / road.curve_m), math.exp(-metres / c.wind.wind_m)
    alike = math.exp(-metres / driver.response_m)
    switch = 1.0 - math.exp(-driven_m / driver.switch_m)
    curvature_var, response_var = road.curvature_1pm * road.curvature_1pm, v.response * v.response
    wind_var = v.wind_mps * u * v.wind_mps * u
    answers, frees = switch * driver.answered_share, switch * (1.0 - driver.answered_share)
    for k in range(len(filters.weight)):
        if filters.weight[k] <= 0.0:
            continue
        if metres > 0.0:
            for m in range(MODES):
                if filters.mode[k][m] > 0.0:
                    x, P = filters.x[k][m], filters.P[k][m]
                    decay(x, P, WIND, calm, wind_var * (1.0 - calm * calm))
                    if m >= STRAIGHT_ANSWERED:
                        decay(x, P, RESPONSE, alike, response_var * (1.0 - alike * alike))
                    if m in (CURVED_FREE, CURVED_ANSWERED):
                        decay(x, P, CURVATURE, bent, curvature_var * (1.0 - bent * bent))
            exchange(filters, k, STRAIGHT_FREE, CURVED_FREE, bends, ends, CURVATURE, curvature_var, room)
            exchange(
                filters, k, STRAIGHT_ANSWERED, CURVED_ANSWERED, bends, ends, CURVATURE, curvature_var, room
            )
        if driven_m > 0.0:
            exchange(
                filters, k, STRAIGHT_FREE, STRAIGHT_ANSWERED, answers, frees, RESPONSE, response_var, room
            )
            exchange(filters, k, CURVED_FREE, CURVED_ANSWERED, answers, frees, RESPONSE, response_var, room)


@jit.kernel
def step_all(
    filters: Filters, found: Any, scratch: Scratch, w: Window, common: Common, c: Constants
) -> Innovations:
    """Take a window into every hypothesis, weigh the modes; return the mean innovations.

    found: scratch, one per mode. The loads' log likelihoods gather until a gate opens.
    """
    nis = speed_surplus = sensed_surplus = innovation = 0.0
    for k in range(len(filters.weight)):
        weight = filters.weight[k]
        if weight <= 0.0:
            continue
        mode = filters.mode[k]
        for m in range(MODES):
            if mode[m] > 0.0:
                share = weight * mode[m]
                drifting = filters.drifting[k] > 0.0
                one = step(filters.x[k][m], filters.P[k][m], m, drifting, scratch, w, common, c)
                found[m] = one.log_likelihood
                nis += share * one.nis
                speed_surplus += share * one.speed_surplus
                sensed_surplus += share * one.sensed_surplus
                innovation += share * one.innovation
        filters.pending[k] += c.noise.power * weigh_modes(mode, found, weight)
    return Innovations(nis, speed_surplus, sensed_surplus, innovation)


@jit.kernel
def live(filters: Filters) -> float:
    """Return how many densities are alive."""
    count = 0.0
    for k in range(len(filters.weight)):
        if filters.weight[k] > 0.0:
            for m in range(MODES):
                if filters.mode[k][m] > 0.0:
                    count += 1.0
    return count


@jit.kernel
def run(
    n: int, columns: Any, filters: Filters, carried: Carried, scratch: Scratch, room: Room, found: Any,
    means: Any, variances: Any, centres: Any, nodes: Any, prior_var: Any, roll_share: float, c: Constants,
    v: Vehicle, out: Any,
) -> Carried:  # fmt: skip
    """Take n windows; out[k] holds what is known after window k (OUT_*). Returns what is carried on.

    centres: inverse masses of an unknown load. nodes: those over which wide mixtures are summed.
    prior_var: variances of the states before the first sample. The rest is scratch.
    """
    p, standing, levels, comparison, given, road = carried
    for k in range(n):
        w = window_at(columns, k)
        is_open, still = w.open > 0.0, w.stopped > 0.0
        # -- what has happened since the window before
        metres = w.distance_m + w.gap_s * max(w.speed_mps, 0.0)
        standing = stand(standing, w)
        height_known = p.height_known > 0.0 and w.gap_s <= c.road.height_lost_s
        before = 0.0 if w.gap_s > 0.0 else p.open_windows
        begins = is_open and before == 0.0
        comparison = compare(comparison, w.sensed_mps2, w.accel_mps2, w.speed_mps, v.speed_floor_mps)
        road = follow_road(road, filters, w, metres)
        failed = comparison.faulty != p.faulty or road.lost > 0.0
        challenged_s = p.challenged_s + (WINDOW_S if is_open else 0.0)
        if failed or (begins and standing.unknown_s >= c.load.least_stop_s):
            if p.learned > 0.0:
                probability = 1.0 if failed else changed_probability(standing.unknown_s, c.load)
                for i in range(len(filters.pending)):
                    filters.pending[i] = 0.0
                loosened = 1.0 if failed else 0.0
                open_load(
                    filters, probability, loosened, centres, prior_var, False, w.rotating_kg, c, v, room
                )
            standing = Standing(0.0)
        elif is_open and not begins and (challenged_s > c.load.challenge_s or p.surprised > 0.0):
            if challenged_s > c.load.challenge_s:
                challenged_s = 0.0
                question_drift(filters, c.load)
            changed = c.load.surprised_probability if p.surprised > 0.0 else c.load.moving_probability
            open_load(
                filters, changed, 0.0, centres, prior_var, True,
                w.rotating_kg, c, v, room,
            )  # fmt: skip
        # -- what all hypotheses share
        u = mean_inverse_mass(filters, v.least_u, v.most_u)
        mixed_m, driven_m = p.mixed_m + metres, p.driven_m + metres
        road_m = mixed_m if mixed_m >= c.road.mix_m else 0.0
        driver_m = driven_m if driven_m >= c.driver.mix_m else 0.0
        if road_m > 0.0 or driver_m > 0.0:
            change_modes(filters, road_m, driver_m, u, c, v, room)
        calm = w.speed_mps
        began = calm
        if is_open:
            began = w.before_mps if begins else p.calm_mps
            calm = began + max(_CALM, min(1.0, _FRESH / (before + 1.0))) * (w.speed_mps - began)
        slow_N = w.traction_N if begins else p.slow_N
        fast_N = w.traction_N - slow_N
        slow_N += WINDOW_S * fast_N
        unseen = p.unseen + 1.0
        sees = (
            not math.isnan(w.sensed_mps2) and comparison.faulty == 0.0 and not still and unseen >= _SEE_EVERY
        )
        swing = c.noise.swing_mpN * u * w.rotating_kg
        speed_var = levels.speed_var + swing * swing * levels.ringing_N2
        levers = Levers(u, calm, v.least_u, v.most_u, speed_var, levels.sensed_var)
        moved = w.traction_N - w.before_N
        common = Common(
            levers, begins, began, metres, answered_force(w, p, metres, u, begins, c),
            own_torque(fast_N, u, w.speed_mps, levels.roughness_1pm, c) if is_open else 0.0,
            unknown_force(w.traction_N, abs(moved), v.torque_std_Nm * w.gear_1pm, w.drag_N_per_mps, c.noise),
            height_known, sees, p.accel_mps2, WINDOW_S + min(w.gap_s, 10.0), roll_share, road.uses > 0.0,
            levels.roughness_1pm,
        )  # fmt: skip
        # -- each hypothesis, and what they learn together
        innovations = step_all(filters, found, scratch, w, common, c)
        if is_open:
            weigh_loads(filters.weight, filters.pending)
            if road_m > 0.0:
                merge_alike(filters, means, variances, room.d)
            prune_impossible(filters, v.least_u, v.most_u)
        changed_N = w.traction_N if begins else moved
        levels = follow(levels, innovations, changed_N, is_open, sees, c.noise, c.road, v)
        given = report(filters, given, nodes, metres, is_open, begins, c, v)
        p = Progress(
            mixed_m if road_m == 0.0 else 0.0, driven_m if driver_m == 0.0 else 0.0,
            before + 1.0 if is_open else 0.0, calm, slow_N, w.force_N,
            1.0 if is_open or w.retarding > 0.0 else 0.0, 0.0 if sees else unseen,
            1.0 if height_known or not math.isnan(w.altitude_m) else 0.0,
            1.0 if is_open or p.learned > 0.0 else 0.0, w.accel_mps2, challenged_s, comparison.faulty,
            1.0 if innovations.nis > c.load.surprise_nis else 0.0,
        )  # fmt: skip
        row = out[k]
        row[OUT_MASS] = given.mass_kg
        row[OUT_VAR] = given.mass_var + unknown_load_var(given.mass_kg, standing, c, v)
        row[OUT_GRADE], row[OUT_GRADE_VAR], row[OUT_BEND] = given.grade, given.grade_var, given.slope_1pm
        row[OUT_LEARNED], row[OUT_SPEED] = p.learned, max(w.speed_mps, 0.0)
        row[OUT_LIVE] = live(filters)
    return Carried(p, standing, levels, comparison, given, road)
