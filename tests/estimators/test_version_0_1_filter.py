"""The kernel against an independent oracle: the same model as a dense matrix Kalman filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.canest_0_1 import kernel as k
from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.axle import slip_seen
from canest.estimators.canest_0_1.coarse import surer
from canest.estimators.canest_0_1.doubt import HILL_EFFORT, HILL_M, ORDINARY, ROAD_S, begin_stretch, credit
from canest.estimators.canest_0_1.estimator import Canest
from canest.estimators.canest_0_1.filter import OUTLIER, correct, fade, travel
from canest.estimators.canest_0_1.noise import (
    DOUBTED,
    FORCE_S,
    FORCE_SHARE,
    GUST_MPS,
    GUST_S,
    LEAST_SWING_MPN,
    LONGEST_WINDOWS,
    MOST_SWING_MPN,
    NOISE_MEMORY,
    NOISE_START,
    OVERRUN_SHARE,
    RINGS,
    SWING_MPN,
)
from canest.estimators.canest_0_1.roads import (
    CURVE_M,
    CURVED_M,
    GUESS_M,
    MIX_M,
    ROADS_M,
    STRAIGHT_M,
    WIND_M,
    mix,
    usual_curvature,
)
from canest.estimators.canest_0_1.senses import HEIGHT_STD_M, HEIGHT_WANDER
from canest.estimators.canest_0_1.windows import COLUMNS
from canest.estimators.windowing import WINDOW_S

from .synthetic import FACTS

AT = {name: i for i, name in enumerate(COLUMNS)}


def random_windows(n, seed=0, **columns):
    rng = np.random.default_rng(seed)
    w = np.zeros((len(COLUMNS), n))
    truth_u, grade = 1 / 21000, 0.01
    traction = 6000 + 5000 * np.sin(np.arange(n) / 7) + rng.normal(0, 300, n)
    force = traction - 900.0
    accel = truth_u * force - 0.06 - GRAVITY_MPS2 * grade
    speed = 20 + np.cumsum(accel) * WINDOW_S + rng.normal(0, 0.002, n)
    w[AT["distance_m"]] = speed * WINDOW_S
    w[AT["before_mps"]], w[AT["speed_mps"]] = np.roll(speed, 1), speed
    w[AT["before_N"]], w[AT["traction_N"]] = np.roll(traction, 1), traction
    w[AT["force_N"]], w[AT["roll_mps2"]], w[AT["accel_mps2"]] = force, 0.06, accel
    w[AT["drag_N_per_mps"]], w[AT["gear_1pm"]] = 100.0, 7.0
    w[AT["before_mps"], 0] = speed[0] - accel[0] * WINDOW_S
    w[AT["before_N"], 0] = traction[0]
    w[AT["undriven_mps"]] = w[AT["sensed_mps2"]] = w[AT["altitude_m"]] = w[AT["coast_mps2"]] = np.nan
    w[AT["open"]] = 1.0
    for name, column in columns.items():
        w[AT[name]] = column
    return w


class Dense:
    """The textbook filter on all states: x = F x, P = F P F' + Q; K = P h / s; nothing clever."""

    def __init__(self, estimator, road):
        self.x, self.P = np.array(estimator._X[road]), np.array(estimator._PP[road])
        self.n = len(self.x)
        self.wind_var, self.inverse_std = estimator._prior.std[at.WIND] ** 2, estimator._prior.std[at.U]
        self.bend_var = estimator._prior.std[at.CURVATURE] ** 2 if road == at.CURVED else 0.0

    def predict(self, F, Q):
        self.x, self.P = F @ self.x, F @ self.P @ F.T + Q

    def travel(self, ds):
        Q = np.zeros((self.n, self.n))
        Q[at.GRADE, at.GRADE] = k._ROUGHNESS * ds
        Q[at.U, at.U] = k._MASS_DRIFT * ds * self.x[at.U] ** 2
        # one after the other, as the filter does: height with the grade before it changes
        first, second = np.eye(self.n), np.eye(self.n)
        first[at.HEIGHT, at.GRADE] = ds
        second[at.GRADE, at.CURVATURE] = ds
        self.predict(second @ first, Q)

    def fade(self, ds):
        F, Q = np.eye(self.n), np.zeros((self.n, self.n))
        bent, calm = np.exp(-ds / CURVE_M), np.exp(-ds / WIND_M)
        F[at.CURVATURE, at.CURVATURE], Q[at.CURVATURE, at.CURVATURE] = bent, self.bend_var * (1 - bent**2)
        F[at.WIND, at.WIND], Q[at.WIND, at.WIND] = calm, self.wind_var * (1 - calm**2)
        self.predict(F, Q)

    def push(self, force, roll, drag, noise):
        F, Q = np.eye(self.n), np.zeros((self.n, self.n))
        F[at.Q, at.U], F[at.Q, at.GRADE] = WINDOW_S * force, -WINDOW_S * GRAVITY_MPS2
        F[at.Q, at.WIND], Q[at.Q, at.Q] = -WINDOW_S * drag, noise
        self.predict(F, Q)
        self.x[at.Q] -= WINDOW_S * roll

    def begin(self, z, t, rate, rotating, noise_var):
        whole = 1 + self.inverse() * rotating
        late = t + self.halfway() * rate
        lever = h(DELAY=-late * whole, SLIP=-z * t * whole, WINDUP=-rate / whole, U=rotating * z)
        noise_var = noise_var * whole**2
        self.x[at.Q] = z + lever @ self.x
        cross = self.P @ lever
        self.P[at.Q, :], self.P[:, at.Q] = cross, cross
        self.P[at.Q, at.Q] = noise_var + lever @ cross

    def inverse(self):
        return max(self.x[at.U], k._LEAST_SHARE * self.inverse_std)

    def halfway(self):
        return 0.5 * np.clip(self.x[at.DELAY] / self.inverse(), -k._DELAY_S, k._DELAY_S)

    def correct(self, h, z, r, first=0):
        s = h @ self.P @ h + r
        e = z - h @ self.x
        gain = self.P @ h / max(s, e * e / OUTLIER)
        gain[:first] = 0.0
        total = r + max(s, e * e / OUTLIER) - s  # an outlier counts as a noisier measurement
        A = np.eye(self.n) - np.outer(gain, h)
        self.x = self.x + gain * e
        self.P = A @ self.P @ A.T + total * np.outer(gain, gain)
        return e, s


def moments(weights, xs, Ps):
    """Return the mean and covariance of a mixture of Gaussians."""
    mean = sum(w * x for w, x in zip(weights, xs, strict=True))
    spread = (np.outer(x - mean, x - mean) for x in xs)
    return mean, sum(w * (P + S) for w, P, S in zip(weights, Ps, spread, strict=True))


def redrawn(x, P, variance):
    """Return a Gaussian whose curvature is drawn anew."""
    x, P = x.copy(), P.copy()
    x[at.CURVATURE], P[at.CURVATURE, :], P[:, at.CURVATURE] = 0.0, 0.0, 0.0
    P[at.CURVATURE, at.CURVATURE] = variance
    return x, P


def mixed(straight, curved, weight, far_m, variance):
    """Mix two dense filters by the book (Blom and Bar-Shalom 1988); return the new probabilities."""
    bends, ends = 1 - np.exp(-far_m / STRAIGHT_M), 1 - np.exp(-far_m / CURVED_M)
    stay = np.array([[1 - bends, bends], [ends, 1 - ends]])
    joint = weight[:, None] * stay
    after = joint.sum(axis=0)
    to_straight = [(straight.x, straight.P), redrawn(curved.x, curved.P, 0.0)]
    to_curved = [redrawn(straight.x, straight.P, variance), (curved.x, curved.P)]
    results = []
    for road, sources in enumerate((to_straight, to_curved)):
        xs, Ps = zip(*sources, strict=True)
        results.append(moments(joint[:, road] / after[road], xs, Ps))
    (straight.x, straight.P), (curved.x, curved.P) = results
    return after


def h(n=at.BASE_STATES, **levers):
    out = np.zeros(n)
    for name, value in levers.items():
        out[getattr(at, name)] = value
    return out


@pytest.mark.parametrize("compiled", [False, True])
def test_momentum_balance_equals_two_dense_filters(compiled):
    jit.enable(compiled)
    try:
        n = 60
        swings = np.random.default_rng(2).normal(0, 9000, (2, n))
        w = random_windows(n, traction_Nps=swings[0], before_Nps=swings[1], rotating_kg=1500.0)
        estimator = Canest("canest-0.1", replace(FACTS, mass_max_kg=400_000.0))  # no bound is ever met
        roads = [Dense(estimator, at.STRAIGHT), Dense(estimator, at.CURVED)]
        weight = np.array(estimator._weight)
        out = estimator._filter(w)
    finally:
        jit.enable(False)
    prior = estimator._prior
    noise_var, calm = prior.noise_start[0] ** 2, w[AT["before_mps"], 0]
    stretch_m = bent_m = bent_1pm = steady_N = rings = 0.0
    swing = SWING_MPN**2
    for i in range(n):
        memory = min(NOISE_MEMORY, NOISE_START + i)
        c = {name: w[AT[name], i] for name in COLUMNS}
        stretch_m += c["distance_m"]
        if stretch_m >= MIX_M:
            stays = np.exp(-stretch_m * weight[at.CURVED] / ROADS_M)
            square = roads[1].x[at.CURVATURE] ** 2 + roads[1].P[at.CURVATURE, at.CURVATURE]
            bent_m = stays * bent_m + (1 - stays) * ROADS_M
            bent_1pm = stays * bent_1pm + (1 - stays) * ROADS_M * square
            guessed = GUESS_M * prior.std[at.CURVATURE] ** 2
            roads[1].bend_var = (guessed + bent_1pm) / (GUESS_M + bent_m)
            for dense in roads:
                dense.fade(stretch_m)
            weight = mixed(*roads, weight, stretch_m, roads[1].bend_var)
            stretch_m = 0.0
        began = calm
        calm += max(k._CALM, min(1.0, k._FRESH / (i + 1))) * (c["speed_mps"] - calm)
        t = c["traction_N"]
        share = FORCE_SHARE if t > 0 else OVERRUN_SHARE
        step = prior.torque_std_Nm * c["gear_1pm"]
        lasts = min(max(np.sqrt(12) * step / abs(t - c["before_N"]), 1), LONGEST_WINDOWS) if i else 25.0
        persistent = step**2 * lasts * WINDOW_S + (GUST_MPS * c["drag_N_per_mps"]) ** 2 * GUST_S
        unknown = (share * t) ** 2 * FORCE_S + 2 * persistent
        found = []
        least = k._LEAST_SHARE * prior.std[at.U]
        u = max(sum(p * d.x[at.U] for p, d in zip(weight, roads, strict=True)), least)
        usual = ORDINARY * GRAVITY_MPS2 * prior.std[at.CURVATURE] * calm * ROAD_S
        steady = u * abs(c["force_N"] - steady_N) < usual
        steady_N = c["force_N"] if i == 0 else steady_N + (c["force_N"] - steady_N) * WINDOW_S / ROAD_S
        rings = RINGS * rings + (t if i == 0 else t - c["before_N"]) ** 2
        swing_var = swing * (u * c["rotating_kg"]) ** 2 * rings
        for dense in roads:
            dense.travel(c["distance_m"])
            inverse, rate = dense.inverse(), c["traction_Nps"]
            whole = 1 + inverse * c["rotating_kg"]
            if i == 0:
                dense.begin(began, c["before_N"], c["before_Nps"], c["rotating_kg"], noise_var + swing_var)
            late = t + dense.halfway() * rate
            slow = -c["rotating_kg"] * calm
            lever = h(Q=1.0, DELAY=late * whole, SLIP=calm * t * whole, U=slow, WINDUP=rate / whole)
            dense.push(c["force_N"], c["roll_mps2"], c["drag_N_per_mps"], inverse**2 * unknown * WINDOW_S)
            kept = dense.x[at.U], dense.P[at.U, at.U]
            jitter_var = (inverse * rate * k._JITTER_S) ** 2
            z = c["speed_mps"] + c["rotating_kg"] * (c["speed_mps"] - calm) * dense.x[at.U]
            e, s = dense.correct(lever, z, (noise_var + swing_var + jitter_var) * whole**2)
            found.append((e, s, whole))
            if steady:  # Schmidt: considered, not moved
                dense.x[at.U], dense.P[at.U, at.U] = kept
        told = np.array([-0.5 * (min(e * e / s, OUTLIER) + np.log(s)) for e, s, _ in found])
        loud = noise_var + swing_var
        shares = [min(DOUBTED * loud * whole**2 / s, 1.0) for _, s, whole in found]
        surplus = [(min(e * e, OUTLIER * s) - s) / whole**2 for e, s, whole in found]
        surplus = weight @ np.multiply(shares, surplus)
        if swing_var > noise_var:
            swing += surplus * swing / swing_var / NOISE_MEMORY
            swing = np.clip(swing, LEAST_SWING_MPN**2, MOST_SWING_MPN**2)
        noise_var = max(prior.noise_floor[0] ** 2, noise_var + surplus / memory)
        weight = weight * np.exp(told - told.max())
        weight /= weight.sum()
        mean, cov = moments(weight, [d.x for d in roads], [d.P for d in roads])
        assert out[i, at.OUT_U] == pytest.approx(mean[at.U], rel=1e-6), i
        untold = out[i, at.OUT_UNTOLD] * mean[at.U]
        assert out[i, at.OUT_U_VAR] == pytest.approx(cov[at.U, at.U] + untold**2, rel=1e-5)
        assert out[i, at.OUT_GRADE] == pytest.approx(mean[at.GRADE], abs=1e-7)
        assert out[i, at.OUT_GRADE_VAR] == pytest.approx(cov[at.GRADE, at.GRADE], rel=1e-5)


def random_gaussian(rng, n=at.STATES):
    A = rng.normal(size=(n, n))
    return rng.normal(size=n), A @ A.T


def test_mixing_equals_the_moments_of_the_mixtures():
    rng = np.random.default_rng(5)
    dense = [Dense(Canest("canest-0.1", FACTS), road) for road in (at.STRAIGHT, at.CURVED)]
    for d in dense:
        d.x, d.P = random_gaussian(rng)
    dense[0].x, dense[0].P = redrawn(dense[0].x, dense[0].P, 0.0)  # a straight knows no curvature
    X, PP, weight = [list(d.x) for d in dense], [d.P.tolist() for d in dense], [0.7, 0.3]
    mix(X, PP, weight, 40.0, 2.5)
    after = mixed(*dense, np.array([0.7, 0.3]), 40.0, 2.5)
    np.testing.assert_allclose(weight, after, rtol=1e-12)
    for x, P, d in zip(X, PP, dense, strict=True):
        np.testing.assert_allclose(x, d.x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(P, d.P, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("first", [0, at.FREE])
def test_a_considered_state_keeps_its_value_and_variance_but_widens_the_others(first):
    n = at.STATES
    x0, P0 = random_gaussian(np.random.default_rng(3))
    dense = Dense(Canest("canest-0.1", FACTS), at.CURVED)
    dense.x, dense.P, dense.n = x0.copy(), P0.copy(), n
    dense.correct(h(n, GRADE=2.0, U=0.5, BIAS=1.0, PITCH=0.3), 0.3, 5.0, first=first)
    x, P = list(x0), [list(row) for row in P0]
    levers = (at.GRADE, 2.0, at.U, 0.5, at.BIAS, 1.0, at.PITCH, 0.3, at.Q, 0.0)
    correct(x, P, [0.0] * n, first, 0.3, 5.0, *levers)
    np.testing.assert_allclose(x, dense.x, rtol=1e-9)
    np.testing.assert_allclose(P, dense.P, rtol=1e-9, atol=1e-12)
    assert x[:first] == list(x0[:first])
    np.testing.assert_array_equal(np.array(P)[:first, :first], P0[:first, :first])


def test_the_axle_filter_separates_slip_as_one_filter_of_all_would():
    """What the small filter adds, summed up, is what a joint filter of slip, lag and scale knows."""
    rng = np.random.default_rng(8)
    prior = Canest("canest-0.1", FACTS)._prior
    y, Y = list(prior.axle_mean), np.diag(np.square(prior.axle_std)).tolist()
    memory = [0.0] * at.MEMORY
    memory[at.UNDRIVEN_VAR] = noise_var = 0.01**2
    floor = 0.01  # and so the noise level stays where it is
    slip_std, slip = prior.std[at.SLIP], 0.0
    x, P = np.array([0.0, prior.axle_mean[1], 0.0]), np.diag([slip_std**2, *np.square(prior.axle_std[1:])])
    info, told = 1 / slip_std**2, 0.0
    for _ in range(50):
        v, t, a = rng.uniform(5, 25), rng.uniform(-5e3, 3e4), rng.normal(0, 0.5)
        lever = np.array([v * t, a, v])
        seen = lever @ np.array([1.5e-7, 0.06, 0.003]) + rng.normal(0, 0.002)
        s = lever @ P @ lever + noise_var
        gain = P @ lever / s
        x, P = x + gain * (seen - lever @ x), P - np.outer(gain, P @ lever)
        z, r = slip_seen(y, Y, [0.0] * 3, memory, floor, seen, v, t, a)
        memory[at.UNDRIVEN_VAR] = noise_var
        info, told = info + 1 / r, told + z / r
    slip = told / info
    assert slip == pytest.approx(x[0], rel=1e-3)
    assert 1 / info == pytest.approx(P[0, 0], rel=1e-3)


@pytest.mark.parametrize("road", [at.STRAIGHT, at.CURVED])
@pytest.mark.parametrize("states", [at.BASE_STATES, at.STATES])
def test_travel_and_fading_equal_the_dense_prediction(road, states):
    dense = Dense(Canest("canest-0.1", FACTS), road)
    dense.n = states
    dense.x, dense.P = random_gaussian(np.random.default_rng(11), states)
    if road == at.STRAIGHT:
        dense.x, dense.P = redrawn(dense.x, dense.P, 0.0)
    x, P = list(dense.x), dense.P.tolist()
    travel(x, P, 7.0, road == at.CURVED, True, k._ROUGHNESS * 7.0)
    P[at.U][at.U] += k._MASS_DRIFT * 7.0 * dense.x[at.U] ** 2
    dense.travel(7.0)
    calm, bent = np.exp(-40.0 / WIND_M), np.exp(-40.0 / CURVE_M)
    fade(x, P, at.WIND, calm, dense.wind_var * (1 - calm**2))
    fade(x, P, at.CURVATURE, bent, dense.bend_var * (1 - bent**2))
    dense.fade(40.0)
    np.testing.assert_allclose(x, dense.x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(P, dense.P, rtol=1e-12, atol=1e-14)


def test_a_satellite_altitude_keeps_the_variance_of_its_wander_while_the_vehicle_stands():
    """Against the scalar random walk, read once a second: or the first metres driven would be a hill."""
    n = 600
    altitude = np.full(n, np.nan)
    altitude[::5] = 100.0
    still = dict.fromkeys(("distance_m", "open", "speed_mps", "before_mps", "accel_mps2"), 0.0)
    estimator = Canest("canest-0.1", FACTS)
    estimator._filter(random_windows(n, altitude_m=altitude, stopped=1.0, **still))
    reading = variance = HEIGHT_STD_M**2
    for i in range(1, n):
        variance += HEIGHT_WANDER * WINDOW_S
        if i % 5 == 0:
            variance *= reading / (variance + reading)
    for P in estimator._PP:
        assert P[at.HEIGHT][at.HEIGHT] == pytest.approx(variance, rel=1e-6)
    assert np.sqrt(variance) > 0.7  # averaging 120 readings of a white noise would say 0.2 m


def test_one_stretch_of_road_is_one_witness_however_much_the_driver_does():
    """200 m at full swing of the force, and again; an accelerometer, which feels the road, is not doubted."""
    credited = {}
    for feels in (False, True):
        memory = [0.0] * at.MEMORY
        efforts = []
        for i in range(100):
            force = 20_000.0 if i // 5 % 2 else -2_000.0
            credit(memory, 1 / 20_000, force, 0.003, i == 0, feels, 4.0)
            efforts.append(memory[at.EFFORT])
        credited[feels] = np.array(efforts)
    stretches = np.arange(1, 101) * 4.0 // (HILL_M + 4.0) + 1
    assert (credited[False] <= stretches * HILL_EFFORT + 1e-12).all()
    assert credited[False][-1] == pytest.approx(2 * HILL_EFFORT)
    assert credited[True][-1] > 10 * HILL_EFFORT


def test_where_a_coasting_has_shown_the_road_another_stretch_begins():
    memory = [0.0] * at.MEMORY
    for i in range(40):
        if i == 20:
            begin_stretch(memory)
        credit(memory, 1 / 20_000, 20_000.0 if i // 5 % 2 else -2_000.0, 0.003, i == 0, False, 1.0)
    assert memory[at.EFFORT] == pytest.approx(2 * HILL_EFFORT)


def test_noise_free_windows_give_the_exact_mass_and_grade():
    n = 400
    w = random_windows(n)
    accel, speed = w[AT["accel_mps2"]], np.empty(n)
    speed[:] = 20 + np.cumsum(accel) * WINDOW_S
    w[AT["speed_mps"]], w[AT["before_mps"]] = speed, speed - accel * WINDOW_S
    estimator = Canest("canest-0.1", FACTS)
    out = estimator._filter(w)
    assert 1 / out[-1, at.OUT_U] == pytest.approx(21000, rel=3e-3)
    assert out[-1, at.OUT_GRADE] == pytest.approx(0.01, abs=1e-3)
    assert estimator.consistency()["nis"] < 1.0


def test_the_grade_with_the_smaller_variance_is_reported():
    memory = [0.0] * at.MEMORY
    memory[at.COARSE_VAR] = memory[at.LAST_VAR] = 1.0
    assert surer(memory, 0.02, 1e-6, True, 0.0, 0.0) == (0.02, 1e-6)
    # the gate closes: both follow the road's curvature and grow as unsure as each other
    assert surer(memory, 0.021, 5e-5, False, 0.0, 0.0) == pytest.approx((0.021, 5e-5))
    # a coarse force: precision-weighted mean by hand, 1/v = 1/5e-5 + 1/1e-4
    grade, var = surer(memory, 0.021, 5e-5, False, 0.024, 1e-4)
    assert var == pytest.approx(1.0 / (1.0 / 5e-5 + 1.0 / 1e-4))
    assert grade == pytest.approx((0.021 / 5e-5 + 0.024 / 1e-4) * var)
    # both go on with what the filter adds
    assert surer(memory, 0.022, 6e-5, False, 0.0, 0.0) == pytest.approx((grade + 0.001, var + 1e-5))
    # an outlier moves it no further than three of its standard deviations would
    far = surer(list(memory), 0.022, 6e-5, False, 1.0, 1e-4)[0] - grade - 0.001
    assert 0 < far < 0.03
    # the filter learns again: soon it is the surer one
    told = [surer(memory, 0.03, 2e-5, True, 0.0, 0.0)[0] for _ in range(4)]
    assert told[-1] == 0.03


def test_the_usual_curvature_is_learned_and_never_beyond_reason():
    """Hundred curves of 200 m, three times as sharp as guessed; the guess counts 400 m."""
    memory, weight = [0.0] * at.MEMORY, [0.0, 1.0]
    x, P = [0.0] * at.STATES, [[0.0] * at.STATES for _ in range(at.STATES)]
    guess = 1e-8
    x[at.CURVATURE] = 3e-4
    memory[at.STRETCH_M] = 20.0
    found = [usual_curvature(x, P, memory, weight[at.CURVED], guess) for _ in range(1000)]
    assert np.all(np.diff(found) > 0)
    remembered = ROADS_M * (1 - np.exp(-20_000.0 / ROADS_M))
    assert found[-1] == pytest.approx((GUESS_M * guess + remembered * 9e-8) / (GUESS_M + remembered))
    x[at.CURVATURE], memory[at.STRETCH_M] = 0.0, 1e6  # hours that nobody saw: all is forgotten but the guess
    assert 0.0 < usual_curvature(x, P, memory, weight[at.CURVED], guess) < guess
