"""The loop over windows."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.next.accelerometer import Comparison, compare
from canest.estimators.next.constants import Constants, Vehicle
from canest.estimators.next.hypotheses import Prior, drop_impossible, exchange, merge_alike, prune, weigh
from canest.estimators.next.load import Standing, changed_probability, open_load, stand
from canest.estimators.next.model import ANSWERS, BENDS, CURVATURE, GRADE, HEIGHT, RATE, RESPONSE, U, V, WIND, Bank, Window
from canest.estimators.next.noise import Innovations, Levels, follow, unknown_force
from canest.estimators.next.predict import accelerate, add_variance, climb, decay, drift, travel
from canest.estimators.next.report import Report, report, unknown_load_var
from canest.estimators.next.sensors import (
    UNKNOWN_V, Scratch, accelerometer, altitude, closed_balance, coasting, has_coasted, mean_surplus, speed,
)
from canest.estimators.next.update import add_log_likelihood
from canest.estimators.next.windows import WINDOW_S

_SEE_EVERY = 2.0
OUTPUTS = 8
OUT_MASS, OUT_VAR, OUT_GRADE, OUT_GRADE_VAR, OUT_BEND, OUT_LEARNED, OUT_SPEED, OUT_LIVE = range(OUTPUTS)


class Progress(NamedTuple):
    """What is carried from window to window beside the densities."""

    mixed_m: float = 0.0
    mixed_s: float = 0.0
    open_windows: float = 0.0
    slow_N: float = 0.0
    force_N: float = 0.0
    follows: float = 0.0
    unseen: float = 0.0
    height_known: float = 0.0
    learned: float = 0.0
    accel_mps2: float = 0.0
    faulty: float = 0.0
    surprise: float = 0.0
    count: float = 0.0


class Carried(NamedTuple):
    """All of it."""

    progress: Progress
    standing: Standing
    levels: Levels
    comparison: Comparison
    report: Report


@jit.kernel
def window_at(c: Any, k: int) -> Window:
    """Return window k of the columns."""
    return Window(
        c[0][k], c[1][k], c[2][k], c[3][k], c[4][k], c[5][k], c[6][k], c[7][k], c[8][k], c[9][k],
        c[10][k], c[11][k], c[12][k], c[13][k], c[14][k], c[15][k], c[16][k], c[17][k], c[18][k], c[19][k],
        c[20][k], c[21][k], c[22][k], c[23][k], c[24][k], c[25][k], c[26][k], c[27][k], c[28][k],
    )


@jit.kernel
def answered_force(w: Window, p: Progress, metres: float, u: float, begins: bool, c: Constants) -> float:
    """Return dF / g, the change of the force that the road may answer, kg."""
    change = 0.0
    if w.open > 0.0:
        change = w.traction_N - w.before_N
    elif w.retarding > 0.0 and p.follows > 0.0 and w.gap_s == 0.0:
        change = w.force_N - p.force_N
    if change == 0.0:
        return 0.0
    most = c.most_1pm * metres * GRAVITY_MPS2 / u
    return min(max(change, -most), most) / GRAVITY_MPS2


@jit.kernel
def own_torque(fast_N: float, u: float, speed_mps: float, c: Constants) -> float:
    """Return how much less probable a change of torque is where it answers the road (log likelihood)."""
    usual = GRAVITY_MPS2 * c.usual_1pm * max(speed_mps, 1.0)
    ratio = u * u * fast_N * fast_N / (usual * usual + c.usual_mps2 * c.usual_mps2)
    return -c.own_weight * min(0.5 * max(ratio - 1.0, 0.0), 30.0)


@jit.kernel
def mean_u(bank: Bank, count: int, v: Vehicle) -> float:
    """Return the mean of u over all densities, each within the bounds."""
    mean = 0.0
    for d in range(count):
        mean += bank.weight[d] * min(max(bank.x[d, U], v.least_u), v.most_u)
    return mean


@jit.kernel
def run(
    n: int, columns: Any, bank: Bank, room: Bank, carried: Carried, t: Scratch, nodes: Any, c: Constants, v: Vehicle, out: Any,
) -> Carried:
    """Take n windows; out[k] holds what is known after window k."""
    p, standing, levels, comparison, given = carried
    count = int(p.count)
    curvature_var = c.curvature_1pm * c.curvature_1pm
    response_var = v.response * v.response
    for k in range(n):
        w = window_at(columns, k)
        is_open, still = w.open > 0.0, w.stopped > 0.0
        metres = w.distance_m + w.gap_s * max(w.speed_mps, 0.0)
        standing = stand(standing, w)
        height_known = p.height_known > 0.0 and w.gap_s <= c.height_lost_s
        before = 0.0 if w.gap_s > 0.0 else p.open_windows
        begins = is_open and before == 0.0
        comparison = compare(comparison, w.sensed_mps2, w.accel_mps2, w.speed_mps, v.speed_floor_mps)
        failed = comparison.faulty != p.faulty
        surprise = p.surprise
        if failed or (begins and standing.unknown_s >= c.least_stop_s):
            if p.learned > 0.0:
                probability = 1.0 if failed else changed_probability(standing.unknown_s, c.stop_s)
                count = open_load(bank, count, probability, False, 0.0, c, v, t.a)
                count = prune(bank, count, 1e-300)
            standing = Standing(0.0)
            surprise = 0.0
        elif is_open and surprise > c.surprise:
            surprise = 0.0
            rate = c.drift_1ps * mean_u(bank, count, v)
            count = exchange(
                bank, count, c.call_m, 0.0, Prior(curvature_var, response_var, rate * rate), c.prune, c, t.table, t.share, room
            )
            net_kg = (w.force_N - w.rotating_kg * w.accel_mps2) / GRAVITY_MPS2
            count = open_load(
                bank, count, c.surprised_probability, True, net_kg, c, v, t.a
            )
        u = mean_u(bank, count, v)
        # modes
        mixed_m, mixed_s = p.mixed_m + metres, p.mixed_s + (0.0 if still else WINDOW_S)
        if mixed_m >= c.mix_m:
            calm, bent = math.exp(-mixed_m / c.wind_m), math.exp(-mixed_m / c.curve_m)
            alike = math.exp(-mixed_m / c.response_m)
            wind_var = v.wind_mps * u * v.wind_mps * u
            decay(bank, count, WIND, calm, wind_var * (1.0 - calm * calm))
            for d in range(count):
                fade_mode(bank, d, bent, curvature_var, alike, response_var)
            merge_alike(bank, count, c.merge)
            rate = c.drift_1ps * u
            count = exchange(
                bank, count, mixed_m, mixed_s, Prior(curvature_var, response_var, rate * rate), c.prune, c, t.table, t.share, room
            )
            mixed_m = mixed_s = 0.0
        # predict
        for d in range(count):
            bank.found[d] = 0.0
        slow_N = w.traction_N if begins else p.slow_N
        fast_N = w.traction_N - slow_N
        slow_N += WINDOW_S * fast_N
        answered = answered_force(w, p, metres, u, begins, c)
        drift(bank, count, WINDOW_S + min(w.gap_s, 10.0), t.f, t.K)
        if height_known:
            add_variance(bank, count, HEIGHT, c.height_wander_m2ps * (WINDOW_S + w.gap_s))
            if metres > 0.0:
                climb(bank, count, metres, t.f, t.K)
        if metres > 0.0 or answered != 0.0:
            travel(bank, count, metres, answered, c.scatter_share * u, c.smooth_1pm, c.rough_1pm, t.f, t.K)
        moved = w.traction_N - w.before_N
        motion = w.accel_mps2
        if is_open:
            motion = accelerate(bank, count, w, v.least_u, v.most_u, t.f, t.K)
            density = unknown_force(w.traction_N, abs(moved), v.torque_std_Nm * w.gear_1pm, w.drag_N_per_mps, c)
            lever = u / (1.0 + u * w.rotating_kg)
            add_variance(bank, count, V, lever * lever * density * WINDOW_S)
        if not is_open or w.gap_s > 0.0:
            add_variance(bank, count, V, UNKNOWN_V)
        # update
        swing = c.swing_mpN * u * w.rotating_kg
        speed_var = levels.speed_var + swing * swing * levels.ringing_N2
        speed(bank, count, t, w, u, speed_var, c)
        nis = speed_surplus = sensed_surplus = 0.0
        if is_open:
            add_log_likelihood(bank.found, count, t.e, t.s, speed_var, c.outliers)
            own = own_torque(fast_N, u, w.speed_mps, c)
            for d in range(count):
                bank.found[d] += own * ANSWERS[int(bank.mode[d])]
                nis += bank.weight[d] * t.e[d] * t.e[d] / t.s[d]
            speed_surplus = mean_surplus(bank, count, t, speed_var, c)
            step_of_road(bank, count, w, t, c)
        elif w.retarding > 0.0 or w.coarse > 0.0:
            closed_balance(bank, count, t, w, speed_var, u, v.roll_share, c)
        if not math.isnan(w.altitude_m):
            altitude(bank, count, t, w.altitude_m, height_known, c)
        unseen = p.unseen + 1.0
        sees = (
            not math.isnan(w.sensed_mps2) and comparison.faulty == 0.0 and not still and unseen >= _SEE_EVERY
        )
        if sees:
            sensed_surplus = accelerometer(bank, count, t, w, levels.sensed_var, motion, p.accel_mps2, u, c)
        if has_coasted(w, c):
            coasting(bank, count, t, w, c)
        # weigh
        weigh(bank, count, c.power, c.mode_power, t.per_load)
        count = prune(bank, count, c.prune)
        if is_open:
            count = drop_impossible(bank, count, v.least_u, v.most_u)
        if is_open:
            surprise = max(surprise + nis - c.usual_nis, 0.0)
        levels = follow(levels, Innovations(nis, speed_surplus, sensed_surplus), w.traction_N if begins else moved, is_open, sees, c, v)
        given = report(bank, count, t.share, given, nodes, w.speed_mps * v.late_s, is_open, begins, c, v)
        p = Progress(
            mixed_m, mixed_s, before + 1.0 if is_open else 0.0, slow_N, w.force_N,
            1.0 if is_open or w.retarding > 0.0 else 0.0, 0.0 if sees else unseen,
            1.0 if height_known or not math.isnan(w.altitude_m) else 0.0,
            1.0 if is_open or p.learned > 0.0 else 0.0, w.accel_mps2, comparison.faulty,
            surprise, float(count),
        )
        row = out[k]
        row[OUT_MASS] = given.mass_kg
        row[OUT_VAR] = given.mass_var + unknown_load_var(given.mass_kg, standing, c, v)
        row[OUT_GRADE], row[OUT_GRADE_VAR], row[OUT_BEND] = given.grade, given.grade_var, given.slope_1pm
        row[OUT_LEARNED], row[OUT_SPEED] = p.learned, max(w.speed_mps, 0.0)
        row[OUT_LIVE] = count
    return Carried(p, standing, levels, comparison, given)


@jit.kernel
def step_of_road(bank: Bank, count: int, w: Window, t: Scratch, c: Constants) -> None:
    """Where no noise explains an innovation, the road has a step, and the speed is what was measured."""
    for d in range(count):
        missing = t.e[d]
        if missing * missing > c.step_nis * t.s[d]:
            u = min(max(bank.x[d, U], 0.0), 1e-3)
            step = missing * (1.0 + u * w.rotating_kg) / (WINDOW_S * GRAVITY_MPS2)
            bank.P[d, GRADE, GRADE] += min(step * step, c.grade * c.grade)
            bank.P[d, V, V] += missing * missing


@jit.kernel
def fade_mode(bank: Bank, d: int, bent: float, curvature_var: float, alike: float, response_var: float) -> None:
    """Let curvature and response of one density fade, where it has them."""
    x, P = bank.x, bank.P
    mode = int(bank.mode[d])
    if BENDS[mode] > 0.0:
        x[d, CURVATURE] *= bent
        for k in range(x.shape[1]):
            P[d, CURVATURE, k] *= bent
            P[d, k, CURVATURE] *= bent
        P[d, CURVATURE, CURVATURE] += curvature_var * (1.0 - bent * bent)
    if ANSWERS[mode] > 0.0:
        x[d, RESPONSE] *= alike
        for k in range(x.shape[1]):
            P[d, RESPONSE, k] *= alike
            P[d, k, RESPONSE] *= alike
        P[d, RESPONSE, RESPONSE] += response_var * (1.0 - alike * alike)
