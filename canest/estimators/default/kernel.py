"""The loop over windows: what has happened, predict, update, weigh, report (docs/theory.md, section 12)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.core.jit import borrowed
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default import model as m
from canest.estimators.default.accelerometer import Comparison, compare
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.driver import answer_log_likelihood, answered_force
from canest.estimators.default.hypotheses import change_modes, p_changed, prune, set_loads, take, weigh
from canest.estimators.default.joining import Joined, add_window, begin_sums, join, tells_coasting, waits
from canest.estimators.default.load import brakes_unseen, in_overrun, merge_loads, open_disturbance, open_load
from canest.estimators.default.model import Mixture, Scratch, Space
from canest.estimators.default.noise import Levels, first_levels, follow, force_noise, swing_var, unexplained
from canest.estimators.default.predict import accelerate, climb, fade, follow_bends, travel, widen
from canest.estimators.default.report import Report, leave_out, report_grade, report_mass, unknown_load_var
from canest.estimators.default.road_map import RoadUse, cell_var, follow_road
from canest.estimators.default.sensors import (
    UNKNOWN_V,
    accelerometer,
    altitude,
    bound_delay,
    closed_balance,
    coasting,
    delay_is_too_long,
    ends_at,
    felt_var,
    gain_is_known,
    learn_open,
    mapped_slope,
    mean_delay,
    momentum_speed,
    row_of_gain,
    slow_traction,
    speed,
    windup_var,
)
from canest.estimators.windowing import WINDOW_S

#: after a gap this long the height is unknown, and so much of one counts as driven, s; a coasting further
#: back says nothing of this road, m
_LOST_S, _DRIVEN_GAP_S, _FAR_M = 60.0, 10.0, 100.0
#: columns of the output, one row per window
OUTPUTS = 8
OUT_MASS, OUT_VAR, OUT_GRADE, OUT_GRADE_VAR, OUT_SLOPE, OUT_WANDER, OUT_LEARNED, OUT_SPEED = range(OUTPUTS)


class Progress(NamedTuple):
    """What is carried from window to window beside the densities."""

    alive: int  #: densities
    u: float  #: inverse mass, mean of all densities, each within the vehicle's bounds
    mixed_m: float = 0.0  #: metres, and seconds of motion, since modes exchanged probability
    mixed_s: float = 0.0
    force_N: float = math.nan  #: of the window before; NaN where it was not known
    was_open: bool = False
    learned: bool = False  #: once a window was open
    surprise: float = 0.0  #: cumulative sum of what innovations are more than usual
    braked: bool = False  #: while a brake seems to act that nobody reports
    height_known: bool = False
    climbed_m: float = 0.0  #: metres, forwards, and seconds since the height followed the slope
    climbed_s: float = 0.0
    delay_s: float = 0.0  #: delay of the torque beyond the usual one
    driven_s: float = 0.0  #: seconds with open gates since another load was due in motion
    swing: float = 0.0  #: variance of the speed by a driveline that swings
    slow_N: float = math.nan  #: see `slow_traction`; NaN before the first window
    bend_var: float = 0.0  #: see `follow_bends`
    undriven: bool = False  #: whether the speed is that of an undriven axle


class Carried(NamedTuple):
    """All of it."""

    progress: Progress
    levels: Levels
    comparison: Comparison
    report: Report
    road: RoadUse
    joined: Joined


@jit.kernel
def mean_inverse_mass(mix: Mixture, count: int, v: Vehicle, t: Scratch) -> float:
    """Return the mean of u over all densities, each within the vehicle's bounds."""
    mean = 0.0
    for d in range(count):
        mean += mix.weight[d] * min(max(t.columns[0][d], v.least_u), v.most_u)
    return mean


@jit.kernel
def write(row: Any, given: Report, q: Joined, p: Progress, levels: Levels, c: Constants, v: Vehicle) -> None:
    """Write what is known after a window, the grade carried on since the last update."""
    mass_kg, slope_1pm, wander_1pm = given.mass_kg, given.slope_1pm, given.wander_1pm
    wider = unexplained(levels)
    var = wider * given.mass_var + unknown_load_var(mass_kg, q.unseen_s, p.braked, c, v)
    if levels.refuted or delay_is_too_long(p.delay_s, c):
        var += mass_kg * mass_kg
    grade = given.grade + slope_1pm * q.distance_m
    grade_var = wider * given.grade_var + wander_1pm * abs(q.distance_m)
    learned, speed_mps = 1.0 if p.learned else 0.0, max(q.last_mps, 0.0)
    row[:] = mass_kg, var, grade, grade_var, slope_1pm, wander_1pm, learned, speed_mps


@jit.kernel
def run(
    n: int, windows: Any, mix: Mixture, carried: Carried, c: Constants, v: Vehicle, space: Space, out: Any
) -> Carried:
    """Take n windows (records; interpreted tuples); returns what is carried on. out: (n, OUTPUTS)."""
    p, levels, comparison, given, road, joined = carried
    mix, space, windows, out = borrowed(mix), borrowed(space), borrowed(windows), borrowed(out)
    t = space.scratch
    count = p.alive
    for k in range(n):
        last, was_faulty = windows[k], comparison.faulty
        comparison = compare(comparison, last, v)
        failed = comparison.faulty != was_faulty
        braked = p.braked and (last.open == 0.0 or in_overrun(last))
        is_open, still = last.open > 0.0 and not braked, last.stopped > 0.0
        starts = is_open and (not p.was_open or last.gap_s > 0.0)
        undriven = not math.isnan(last.undriven_mps) and (starts or not is_open or p.undriven)
        begins = starts or (is_open and p.undriven and not undriven)  # one balance has one speed
        ratio = p.u * last.rotating_kg
        moves_mps = momentum_speed(last, ratio, undriven)
        joined = add_window(joined, last, moves_mps, begins)
        if not failed and waits(joined, last, p.was_open and not begins, v):
            write(out[k], given, joined, p, levels, c, v)
            continue
        w, dt = join(joined, last), WINDOW_S * joined.windows
        # -- what has happened since the window before
        metres = w.distance_m + w.gap_s * max(w.speed_mps, 0.0)
        ahead_m = max(w.speed_mps, 0.0) * (v.late_s + 0.5 * dt)  # theta is that of the window's middle
        road = follow_road(road, given, w, metres, v.late_s)
        failed = failed or road.lost
        height_known = p.height_known and w.gap_s <= _LOST_S and not failed
        # -- other loads, other modes, another disturbance
        unseen_s, surprise, bend_var, opened = joined.unseen_s, p.surprise, p.bend_var, False
        load_changed = p_changed(unseen_s, c.load_stop_s) if begins else 0.0
        if failed or 1.0 - load_changed < c.left_out_share:  # nothing of what was learned holds
            take(space.prior, m.MODES, mix)
            count, begins = m.MODES, is_open
            unseen_s = surprise = 0.0
            braked = height_known = False
            levels = first_levels(v) if failed else levels
            bend_var = c.curvature_std_1pm * c.curvature_std_1pm
        elif begins and unseen_s >= c.shortest_stop_s:
            if p.learned:
                count = open_load(mix, count, load_changed, False, 0.0, c, v, t)
                opened = True
            unseen_s = surprise = 0.0
        surprised = is_open and surprise > c.gross_nis
        way_m = abs(metres)
        mixed_m = p.mixed_m + way_m
        mixed_s = p.mixed_s + (0.0 if still else dt + min(w.gap_s, _DRIVEN_GAP_S))
        due = mixed_s >= c.exchange_every_s or surprised or opened
        if due:
            by_drag = 0.5 * w.speed_mps * v.drag_share  # math.hypot rounds otherwise where it is compiled
            wind = math.sqrt(c.wind_std_mps * c.wind_std_mps + by_drag * by_drag) * p.u
            bend_var = follow_bends(mix, count, bend_var, mixed_m, c)
            fade(mix, count, mixed_m, mixed_s, (wind, math.sqrt(bend_var), v.offset_Nm * p.u), c, t)
            bound_delay(mix, count, c, v)
            merge_loads(mix, count, t)
            count = change_modes(mix, count, mixed_m, mixed_s, p.u, bend_var, c, space)
            mixed_m = mixed_s = 0.0
        driven_s = p.driven_s + (dt if is_open else 0.0)
        surprising = 0.0
        if surprised:  # by a load, or by a bend sharper than usual: a road explains larger surprises less
            surprising = min(c.surprise_share * surprise / c.gross_nis, 0.5)
            widen(mix, count, m.CURVATURE, c.sharp_curvature_1pm * c.sharp_curvature_1pm, m.BENDS)
            surprise = 0.0
        if surprised or (is_open and driven_s >= c.motion_every_s):
            probability = max(p_changed(driven_s, c.motion_change_s), surprising)
            net_N = 0.0 if p.braked else w.force_N - w.rotating_kg * w.accel_mps2
            count = open_load(mix, count, probability, True, net_N, c, v, t)
            driven_s = 0.0
        sees = not math.isnan(w.sensed_mps2) and not comparison.faulty and not still
        if due and is_open and sees:  # else a bend would explain as much
            probability = max(p_changed(p.mixed_s + dt, c.jump_every_s), surprising)
            count = open_disturbance(mix, count, probability, p.u, c, v)
        # -- predict and update every density
        climbed_m, climbed_s = p.climbed_m + metres, p.climbed_s + joined.seconds
        measured = not math.isnan(w.altitude_m)
        if height_known and (measured or due):
            climb(mix, count, climbed_m, c.altitude_wander_m2ps * climbed_s, t)
            climbed_m = climbed_s = 0.0
        swing = swing_var(0.0, w.begin_N, w, dt, p.u, c) if begins else p.swing
        skipped = joined.seconds > dt + 0.5 * WINDOW_S  # a gap, or windows that are no part of this one
        slow_N = w.begin_N if skipped or math.isnan(p.slow_N) else p.slow_N
        before = ends_at(joined.before_mps, (w.begin_N, slow_N), ratio, undriven)
        if begins:
            widen(mix, count, m.V, UNKNOWN_V, m.EVERYWHERE)  # no known force has led to the speed before it
            follows = w.gap_s == 0.0 and joined.windows == 1.0 and undriven == p.undriven
            if follows and not math.isnan(joined.before_mps):
                speed(mix, count, before, p.u, levels.speed_var + swing, c, v, t)
        slow_N = slow_traction(slow_N, w, dt)
        end = ends_at(moves_mps, (w.traction_N, slow_N), ratio, undriven)
        answered_N = answered_force(w, is_open, p.force_N)
        travel(mix, count, metres, answered_N, c, t)
        motion = w.accel_mps2
        nis = innovation = speed_surplus = sensed_surplus = 0.0
        if is_open:
            motion = accelerate(mix, count, w, dt, force_noise(w, levels.torque_Nm2s, c, v), p.u, v, t)
            swing = swing_var(swing, w.traction_N - w.begin_N, w, dt, p.u, c)
            speed_var = levels.speed_var + swing + windup_var(mix, count, end)
            speed(mix, count, end, p.u, speed_var, c, v, t)
            answers = (
                answer_log_likelihood(answered_N, p.u, way_m, c.smooth_wander_1pm, bend_var, c),
                answer_log_likelihood(answered_N, p.u, way_m, c.rough_wander_1pm, bend_var, c),
            )
            lever = (1.0 + ratio) / (dt * GRAVITY_MPS2)
            level = levels.speed_var
            nis, speed_surplus, innovation = learn_open(mix, count, answers, lever, speed_var, level, c, t)
        elif w.retarding > 0.0 or w.coarse > 0.0:
            closed_balance(mix, count, w, levels.speed_var, p.u, c, t)
        if measured:
            altitude(mix, count, w.altitude_m, height_known, c, t)
            height_known, climbed_m, climbed_s = True, 0.0, 0.0
        if sees:
            gained = gain_is_known(is_open, v)
            felt = w.sensed_mps2 - (0.0 if gained else w.accel_mps2), motion, *row_of_gain(before, end, dt, v)
            var = levels.sensed_var, felt_var(w, gained, levels.speed_var, dt, p.u, v)
            sensed_surplus = accelerometer(mix, count, gained, felt, dt, var, c, t)
        if road.uses:
            mapped_slope(mix, count, w.road_sine, 0.5 * w.distance_m, cell_var(w), c, t)
        if tells_coasting(w, v) and w.coast_back_s * w.speed_mps < _FAR_M:
            coasting(mix, count, w, c, t)
        # -- weigh, follow the noise, report
        learns = mix.found[0] != 0.0  # what teaches no mass leaves the likelihoods alone
        weigh(mix, count, c.likelihood_power, t)
        count = prune(mix, count, c.least_weight)
        if is_open:
            surprise = max(surprise + nis - c.surprise_nis, 0.0)
            braked = sees and brakes_unseen(w, surprise, innovation, c)
            levels = follow(levels, w, (nis, innovation), speed_surplus, sensed_surplus, sees, c, v)
        delay_s = mean_delay(mix, count, p.u) if is_open else p.delay_s
        best = set_loads(mix, count, t)
        u = mean_inverse_mass(mix, count, v, t)
        leave_out(mix, count, c.left_out_share, t)
        mass = (given.mass_kg, given.mass_var, 0.0 if begins else given.windows)
        if failed or (learns and not still and (is_open or p.learned)):
            mass = report_mass(count, best, mass, c, v, space)
        given = report_grade(mix, count, mass, ahead_m, c, v, t)
        p = Progress(
            count, u, mixed_m, mixed_s, w.force_N if is_open or w.retarding > 0.0 else math.nan,
            is_open and not braked, is_open or p.learned, surprise, braked, height_known,
            climbed_m, climbed_s, delay_s, driven_s, swing, slow_N, bend_var, undriven,
        )  # fmt: skip
        joined = begin_sums(moves_mps, unseen_s)
        write(out[k], given, joined, p, levels, c, v)
    return Carried(p, levels, comparison, given, road, joined)
