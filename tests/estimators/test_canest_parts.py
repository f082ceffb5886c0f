"""The steps of `canest` against dense linear algebra and moments by hand, compiled and interpreted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core import jit
from canest.estimators.default import hypotheses, predict, report, sensors, update
from canest.estimators.default import model as m
from canest.estimators.default.constants import CONSTANTS, Vehicle, vehicle_of
from canest.estimators.default.estimator import _room, _space
from canest.estimators.default.model import MODES, MOST, Ends, Mixture, Window

from .momentum import FACTS

N = m.STATES
FAR = 1e9  #: no innovation is cut
TRUCK = Vehicle(**{**dict.fromkeys(Vehicle._fields, 0.0), "least_u": 1 / 40_000, "most_u": 1 / 8_000,
                   "unknown_u": 1 / 18_000, "unknown_var": (0.4 / 18_000) ** 2})  # fmt: skip


@pytest.fixture(autouse=True, params=["interpreted", "compiled"])
def form(request):
    """Every step in both forms."""
    if request.param == "compiled" and not jit.available():
        pytest.skip("numba is not installed")
    was = jit.enabled()
    jit.enable(request.param == "compiled")
    yield
    jit.enable(was)


def columns(mix):
    return Mixture(*mix[:3], *(np.array(c) if jit.enabled() else list(c) for c in mix[3:]))


def mixture(count, seed=0, modes=None, loads=None):
    """A mixture of random densities, and the room to work in."""
    rng = np.random.default_rng(seed)
    mix = _room(N)
    for d in range(count):
        A = rng.normal(size=(N, N))
        mix.x[d], mix.P[d] = rng.normal(size=N), A @ A.T + np.eye(N)
        mix.weight[d] = 1.0 / count
        mix.mode[d] = modes[d] if modes else 0
        mix.load[d] = loads[d] if loads else 0
    nodes = np.exp(np.linspace(np.log(TRUCK.least_u), np.log(TRUCK.most_u), 2001)).tolist()
    return columns(mix), _space(_room(N), nodes)


def dense(states, values):
    h = np.zeros(N)
    h[list(states)] = values
    return h


def test_propagate_is_one_row_of_F():
    mix, space = mixture(3)
    t = space.scratch
    before, states = (mix.x[:3].copy(), mix.P[:3].copy()), (1, 4, 10)
    f = np.array([[0.3, -1.2, 0.7], [1.0, 0.0, 2.0], [-0.1, 0.2, 0.3]])
    for j in range(3):
        for d in range(3):
            t.f[j * 3 + d] = f[d, j]
    predict.propagate(mix, 3, 2, states, t)
    for d in range(3):
        F = np.eye(N)
        F[2] += dense(states, f[d])
        np.testing.assert_allclose(mix.x[d], F @ before[0][d], rtol=1e-12)
        np.testing.assert_allclose(mix.P[d], F @ before[1][d] @ F.T, rtol=1e-12, atol=1e-12)


def test_decay_keeps_the_stationary_variance():
    """x <- a x + noise of (1 - a^2) std^2: the variance of an Ornstein-Uhlenbeck process stays std^2."""
    mix, _ = mixture(2, modes=[1, 0])
    without, (left, std) = mix.P[1].copy(), (0.9, 1.7)
    mix.P[0, :, m.CURVATURE] = mix.P[0, m.CURVATURE] = 0.0
    mix.P[0, m.CURVATURE, m.CURVATURE] = std**2
    predict.decay(mix, 2, m.CURVATURE, left, std, m.BENDS)
    assert mix.P[0, m.CURVATURE, m.CURVATURE] == pytest.approx(std**2)
    np.testing.assert_array_equal(mix.P[1], without)  # a straight has no curvature


def test_the_speed_follows_newtons_law():
    """F of the speed against differences of dv = dt (u F - g mu - g theta - c omega - G xi) / (1 + u J)."""
    mix, space = mixture(1)
    t = space.scratch
    w = Window(**{**dict.fromkeys(Window._fields, 0.0), "force_N": 9_000.0, "roll_mps2": 0.06,
                  "rotating_kg": 900.0, "drag_N_per_mps": 110.0, "gear_1pm": 30.0})  # fmt: skip
    states = (m.V, m.GRADE, m.U, m.WIND, m.OFFSET)
    x0 = dense(states, (20.0, 0.01, 1 / 20_000, 2.0 / 20_000, 8.0 / 20_000))

    def moved(x):
        net = x[m.U] * 9_000.0 - 0.06 - 9.80665 * x[m.GRADE] - 110.0 * x[m.WIND] - 30.0 * x[m.OFFSET]
        return x[m.V] + 0.2 * net / (1 + 900.0 * x[m.U])

    for state in (None, *states[1:]):
        P = np.zeros((N, N))
        step = 1e-7 if state == m.U else 1e-3
        if state is not None:
            P[state, state] = step**2
        mix.x[0], mix.P[0] = x0, P
        predict.accelerate(mix, 1, w, 0.2, 0.0, 1 / 20_000, TRUCK, t)
        assert mix.x[0, m.V] == pytest.approx(moved(x0))
        assert mix.x[0, m.BEGIN] == x0[m.V]
        if state is not None:
            ahead = x0 + dense((state,), (step,))
            slope = (moved(ahead) - moved(x0)) / step
            assert mix.P[0, m.V, state] == pytest.approx(slope * step**2, rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_condition_on_is_the_kalman_update(seed):
    mix, space = mixture(2, seed)
    t = space.scratch
    before = mix.x[:2].copy(), mix.P[:2].copy()
    states, values, z, r = (0, 3, 5, 10), (1.0, 0.5, -2.0, 0.1), 1.7, 0.4
    update.condition_on(mix, 2, states, values, z, r, FAR, t)
    h = dense(states, values)
    for d in range(2):
        x, P = before[0][d], before[1][d]
        s = h @ P @ h + r
        K = P @ h / s
        assert t.e[d] == pytest.approx(z - h @ x)
        assert t.s[d] == pytest.approx(s)
        np.testing.assert_allclose(mix.x[d], x + K * (z - h @ x), rtol=1e-10)
        np.testing.assert_allclose(mix.P[d], P - np.outer(K, K) * s, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("lags", [True, False])
def test_an_accelerometer_is_compared_with_the_speed_that_the_states_gained(lags):
    """Against the Kalman update of states and the process noise of one window, written as matrices."""
    mix, space = mixture(1)
    t = space.scratch
    x, P = mix.x[0].copy(), mix.P[0].copy()
    copied = np.eye(N)
    copied[m.BEGIN] = copied[m.V]
    x, P = copied @ x, copied @ P @ copied.T
    mix.x[0], mix.P[0] = x, P
    vehicle = vehicle_of(replace(FACTS, torque_lags=lags), 0.1, CONSTANTS)
    gain = sensors.row_of_gain(Ends(9.0, 1_000.0, 500.0), Ends(9.5, 3_000.0, 1_500.0), 0.4, vehicle)
    sensors.accelerometer(mix, 1, True, (0.7, 1.3, *gain), 0.4, (0.08, 0.02), CONSTANTS, t)
    P[m.BIAS, m.BIAS] += 0.4 * CONSTANTS.bias_wander_m2ps5
    h = dense(sensors._GAINED, (9.80665, 1.0, 1.3, 2.5, -2.5, 5_000.0, 2_500.0 * lags))
    s = h @ P @ h + 0.08 * 0.2 / 0.4 + 0.02
    expected = x + P @ h / s * (0.7 - h @ x) * min(1.0, 3.0 * np.sqrt(s) / abs(0.7 - h @ x)) ** 2
    np.testing.assert_allclose(mix.x[0], expected, rtol=1e-6, atol=1e-9)


def test_beyond_three_stds_an_outlier_moves_the_states_the_less_the_larger_it_is():
    moved = []
    for size in (3.0, 30.0):
        mix, space = mixture(1)
        t = space.scratch
        x, P = mix.x[0].copy(), mix.P[0].copy()
        s = P[2, 2] + 0.4
        update.condition_on(mix, 1, (2,), (1.0,), x[2] + size * np.sqrt(s), 0.4, 9.0, t)
        moved.append(mix.x[0] - x)
    np.testing.assert_allclose(moved[1], moved[0] * 3.0 / 30.0, rtol=1e-9)


def test_a_gross_error_speaks_for_no_hypothesis():
    """ln (N(e; 0, s) + floor): two densities that both miss by far differ by next to nothing."""
    mix, space = mixture(2)
    t = space.scratch
    t.e[0], t.e[1], t.s[0], t.s[1] = 50.0, 60.0, 1.0, 1.0
    update.judge(mix, 2, 1.0, 1.0, CONSTANTS, t)
    assert mix.found[0] == pytest.approx(mix.found[1], abs=1e-6)


def test_a_swing_that_is_taken_for_larger_than_it_is_leaves_the_level_alone():
    """Every launch pushed the level of the speed down, and what followed was a surprise."""
    mix, space = mixture(1)
    t, swing, level = space.scratch, 1e-2, 1e-6
    t.e[0], t.s[0] = 0.0, swing + level
    _, surplus, _ = sensors.learn_open(mix, 1, (0.0, 0.0), 0.0, swing + level, level, CONSTANTS, t)
    assert -10.0 * level < surplus < 0.0


def test_a_hidden_force_leaves_the_density_of_the_mass():
    mix, space = mixture(1)
    t = space.scratch
    w = Window(**{**dict.fromkeys(Window._fields, 0.0), "force_N": -4_000.0, "accel_mps2": -0.4})
    u, P = mix.x[0, m.U], mix.P[0].copy()
    sensors.closed_balance(mix, 1, w, 1e-4, 1 / 20_000, CONSTANTS, t)
    assert mix.x[0, m.U] == u
    assert mix.P[0, m.U, m.U] == P[m.U, m.U]
    assert mix.P[0, m.GRADE, m.GRADE] < P[m.GRADE, m.GRADE]


@pytest.mark.parametrize("lasts", ["load", "driver", "drift"])
def test_densities_are_weighed_by_bayes_rule(lasts):
    """Roads by their likelihoods, what lasts by a power of its own."""
    other = {"load": 0, "driver": m.ROADS, "drift": m.STEADY_MODES}[lasts]
    mix, space = mixture(3, loads=[0, 0, 1 if lasts == "load" else 0], modes=[0, m.CURVED, other])
    t = space.scratch
    found = np.array([-1.0, -2.0, -0.5])
    for d in range(3):
        mix.found[d] = found[d]
    hypotheses.weigh(mix, 3, 0.5, t)
    likelihood = np.exp(found)
    first = likelihood[:2].sum() / 2  # given that it is the first
    lasting = np.array([2 / 3 * np.sqrt(first), 1 / 3 * np.sqrt(likelihood[2])])
    lasting /= lasting.sum()
    expected = [*(lasting[0] * likelihood[:2] / likelihood[:2].sum()), lasting[1]]
    np.testing.assert_allclose(mix.weight[:3], expected)


def test_transitions_are_probabilities():
    roads, drivers, loads = hypotheses.transitions(120.0, 9.0, CONSTANTS)
    np.testing.assert_allclose(np.reshape(roads, (3, 3)).sum(axis=1), 1.0)
    for chain in (drivers, loads):
        np.testing.assert_allclose(np.reshape(chain, (2, 2)).sum(axis=1), 1.0)


def test_modes_exchange_probability_and_moments():
    """Two modes of one load: weights by the Markov chain, moments of what comes to each."""
    mix, space = mixture(2, modes=[0, m.ROUGH])
    t = space.scratch
    x, P = mix.x[:2].copy(), mix.P[:2].copy()
    for states in (m.CURVATURE, m.RATE, m.ANSWER):
        x[:, states] = P[:, states] = P[:, :, states] = 0.0
    mix.x[:2], mix.P[:2] = x, P
    roads = (0.9, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.3, 0.7)
    hypotheses.set_loads(mix, 2, t)
    count = hypotheses.exchange(mix, 2, (roads, (1, 0, 0, 1), (1, 0, 0, 1)), 1e-9, space)
    weights = {int(mix.mode[d]): mix.weight[d] for d in range(count)}
    assert weights == pytest.approx({0: 0.45, m.CURVED: 0.15, m.ROUGH: 0.05 + 0.35})
    rough = next(d for d in range(count) if mix.mode[d] == m.ROUGH)
    p = np.array([0.05, 0.35]) / 0.4
    mean = p @ x
    spread = sum(p[d] * (P[d] + np.outer(x[d] - mean, x[d] - mean)) for d in range(2))
    np.testing.assert_allclose(mix.x[rough], mean, atol=1e-12)
    np.testing.assert_allclose(mix.P[rough], spread, atol=1e-10)


def test_a_steady_load_has_no_rate_even_where_a_drifting_one_became_part_of_it():
    mix, space = mixture(2, modes=[0, m.STEADY_MODES])
    t = space.scratch
    hypotheses.set_loads(mix, 2, t)
    chains = ((1, 0, 0, 0, 1, 0, 0, 0, 1), (1, 0, 0, 1), (0.5, 0.5, 0.5, 0.5))
    count = hypotheses.exchange(mix, 2, chains, 1e-9, space)
    assert count == 2
    for d in range(count):
        drifts = mix.mode[d] >= m.STEADY_MODES
        assert (mix.x[d, m.RATE] != 0.0) == drifts
        assert mix.P[d, m.RATE].any() == drifts


def test_what_comes_to_a_mode_has_its_prior():
    """A steady load that begins to drift: the moments of its own density and of the prior, side by side."""
    mix, space = mixture(2, modes=[0, m.STEADY_MODES])
    rate = 1e-8
    hypotheses.give_priors(mix, 2, 4e-8, 5e-5, rate, 0.5)
    assert mix.P[0, m.CURVATURE, m.CURVATURE] == 4e-8
    x, P = mix.x[:2].copy(), mix.P[:2].copy()
    assert (x[0, m.RATE], P[0, m.RATE, m.RATE]) == (rate, rate * rate)
    assert x[1, m.RATE] != rate
    hypotheses.set_loads(mix, 2, space.scratch)
    chains = ((1, 0, 0, 0, 1, 0, 0, 0, 1), (1, 0, 0, 1), (0.75, 0.25, 0.0, 1.0))
    count = hypotheses.exchange(mix, 2, chains, 1e-9, space)
    drifting = next(d for d in range(count) if mix.mode[d] == m.STEADY_MODES)
    p = np.array([0.2, 0.8])
    mean = p @ x[:, m.RATE]
    variance = p @ (P[:, m.RATE, m.RATE] + (x[:, m.RATE] - mean) ** 2)
    np.testing.assert_allclose(mix.x[drifting, m.RATE], mean, rtol=1e-12)
    np.testing.assert_allclose(mix.P[drifting, m.RATE, m.RATE], variance, rtol=1e-12)


def test_pruning_keeps_what_is_probable():
    mix, _ = mixture(4)
    x = mix.x[:4].copy()
    for d, weight in enumerate((0.5, 1e-9, 0.3, 0.2)):
        mix.weight[d] = weight
    assert hypotheses.prune(mix, 4, 1e-6) == 3
    np.testing.assert_allclose(mix.weight[:3], [0.5, 0.2, 0.3])
    np.testing.assert_array_equal(mix.x[:3], x[[0, 3, 2]])


def test_a_wide_mixture_is_summed_over_the_masses():
    """One normal density of u, against a fine sum by numpy (uniform in log u, weight u)."""
    mix, space = mixture(1)
    t = space.scratch
    mean, std = 1 / 20_000, 0.2 / 20_000
    mix.x[0, m.U], mix.P[0, m.U, m.U] = mean, std * std
    hypotheses.set_loads(mix, 1, t)
    report.leave_out(mix, 1, 0.0, t)
    found, var = report.sum_over_nodes(1, 1.0, space)
    nodes = np.array(space.nodes)
    weight = nodes * np.exp(-0.5 * ((nodes - mean) / std) ** 2)
    expected = np.sum(weight / nodes) / weight.sum()
    assert found == pytest.approx(expected, rel=1e-6)
    assert var == pytest.approx(np.sum(weight / nodes**2) / weight.sum() - expected**2, rel=1e-5)


def test_an_improbable_load_is_no_part_of_the_report():
    mix, space = mixture(2, loads=[0, 1])
    t = space.scratch
    mix.weight[0], mix.weight[1] = 0.995, 0.005
    hypotheses.set_loads(mix, 2, t)
    report.leave_out(mix, 2, CONSTANTS.left_out_share, t)
    np.testing.assert_allclose(t.columns[2][:2], [1.0, 0.0])


def test_there_is_room_for_every_mode_of_every_load():
    assert len(m.BENDS) == len(m.IS_ROUGH) == len(m.ANSWERS) == len(m.DRIFTS) == MODES
    assert MOST >= m.LOADS * MODES
