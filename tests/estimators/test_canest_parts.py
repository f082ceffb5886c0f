"""The parts of `canest` against dense linear algebra and moments by hand."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core import jit
from canest.estimators.default import hypotheses, noise, predict, update
from canest.estimators.default.constants import CONSTANTS, Vehicle
from canest.estimators.default.load import Standing, changed_probability, stand
from canest.estimators.default.model import GRADE, RATE, RESPONSE, U, Window
from canest.estimators.default.report import summed_mixture

N = 11
FAR = 1e9  #: no innovation is cut


@pytest.fixture(autouse=True)
def interpreted():
    """Lists go to interpreted kernels, whatever a replay before has switched on."""
    jit.enable(False)


def density(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(N, N))
    return rng.normal(size=N), A @ A.T + np.eye(N)


def dense(states, values):
    h = np.zeros(N)
    h[list(states)] = values
    return h


@pytest.mark.parametrize("seed", range(5))
def test_propagate_is_one_row_of_F(seed):
    x, P = density(seed)
    states, f = (1, 4, 10), [0.3, -1.2, 0.7]
    F = np.eye(N)
    F[2] += dense(states, f)
    xs, Ps = x.tolist(), P.tolist()
    predict.propagate(xs, Ps, 2, states, f, [0.0] * N)
    np.testing.assert_allclose(xs, F @ x, rtol=1e-12)
    np.testing.assert_allclose(Ps, F @ P @ F.T, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_condition_on_is_the_kalman_update(seed):
    x, P = density(seed)
    states, values, z, r = (0, 3, 5, 10), [1.0, 0.5, -2.0, 0.1], 1.7, 0.4
    h = dense(states, values)
    s = h @ P @ h + r
    K = P @ h / s
    xs, Ps = x.tolist(), P.tolist()
    e, var = update.condition_on(xs, Ps, states, values, z, r, FAR, [0.0] * N)
    assert e == pytest.approx(z - h @ x)
    assert var == pytest.approx(s)
    np.testing.assert_allclose(xs, x + K * (z - h @ x), rtol=1e-10)
    np.testing.assert_allclose(Ps, P - np.outer(K, K) * s, rtol=1e-9, atol=1e-10)


def test_beyond_three_stds_an_outlier_moves_the_states_the_less_the_larger_it_is():
    x, P = density(1)
    states, values, r = (0, 3), [1.0, 0.5], 0.4
    h = dense(states, values)
    s = h @ P @ h + r
    moved = []
    for size in (3.0, 30.0):
        xs, Ps = x.tolist(), P.tolist()
        update.condition_on(xs, Ps, states, values, h @ x + size * np.sqrt(s), r, 9.0, [0.0] * N)
        moved.append(np.array(xs) - x)
    np.testing.assert_allclose(moved[1], moved[0] * 3.0 / 30.0, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_conditioning_all_but_the_mass_leaves_its_density(seed):
    x, P = density(seed)
    states, values, lever, z, r = (GRADE, 4), [9.8, 2.0], 3.0, 0.3, 0.5
    xs, Ps = x.tolist(), P.tolist()
    update.condition_all_but_mass(xs, Ps, states, values, lever, z, r, FAR, [0.0] * N, [0.0] * N)
    assert xs[U] == pytest.approx(x[U], rel=1e-9)
    assert Ps[U][U] == pytest.approx(P[U, U], rel=1e-9)
    # given u, the density is that of a Kalman update of the others given u
    others = [i for i in range(N) if i != U]
    slope = P[others, U] / P[U, U]
    C = P[np.ix_(others, others)] - np.outer(slope, slope) * P[U, U]
    h = dense(states, values)[others]
    s = h @ C @ h + r
    K = C @ h / s
    new = np.array(Ps)
    given = new[np.ix_(others, others)] - np.outer(new[others, U], new[others, U]) / new[U, U]
    np.testing.assert_allclose(given, C - np.outer(K, K) * s, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_joining_keeps_mean_and_covariance_of_both(seed):
    (x, P), (y, R) = density(seed), density(seed + 50)
    weight, other = 0.7, 0.2
    p, q = weight / 0.9, other / 0.9
    mean = p * x + q * y
    covariance = p * (P + np.outer(x - mean, x - mean)) + q * (R + np.outer(y - mean, y - mean))
    xs, Ps = x.tolist(), P.tolist()
    hypotheses.join(xs, Ps, weight, y.tolist(), R.tolist(), other, [0.0] * N)
    np.testing.assert_allclose(xs, mean, rtol=1e-12)
    np.testing.assert_allclose(Ps, covariance, rtol=1e-11)


def merged_loads(drifting):
    x, P = density(7)
    x = np.append(x, 3e-9)
    P = np.pad(P, (0, 1)) + 0.1 * np.eye(N + 1)
    P[RATE, U] = P[U, RATE] = 0.01
    filters = hypotheses.Filters(
        *(np.array(a).tolist() for a in ([[x] * 4] * 2, [[P] * 4] * 2, [[0.4, 0.3, 0.2, 0.1]] * 2)),
        [0.7, 0.3],
        [0.0, 0.0],
        drifting,
    )
    hypotheses.merge_loads(filters, 1, 0, [0.0] * (N + 1))
    return filters


def test_a_steady_load_has_no_rate_even_where_a_drifting_one_became_part_of_it():
    filters = merged_loads([0.0, 1.0])
    for m in range(4):
        assert filters.x[0][m][RATE] == 0.0
        assert not np.array(filters.P[0][m])[RATE].any()
    assert merged_loads([1.0, 1.0]).x[0][0][RATE] == pytest.approx(3e-9)


def roughness_after(innovations, *, is_open=True):
    """The roughness, 1e-7 at first, after speeds with these innovations."""
    road, vehicle = CONSTANTS.road, Vehicle(1 / 40_000, 1 / 8_000, 1.0, 1e-3, 0.1, 1e-3, 1.0, 1e-5)
    levels = noise.Levels(1e-4, 1e-3, 0.0, 0.0, 0.0, 1e-7, 0.0, 0.0, 0.0)
    for innovation in innovations:
        found = noise.Innovations(1.0, 0.0, 0.0, innovation)
        levels = noise.follow(levels, found, 0.0, is_open, False, CONSTANTS.noise, road, vehicle)
    return levels.roughness_1pm


def test_the_roughness_follows_the_product_of_an_innovation_and_the_three_before():
    """d ln r = whiteness (product - alike smooth^2), smooth = 1 at the floor, 0 at the roughest."""
    road = CONSTANTS.road
    roughness = 1e-7
    for product in (0.0, 1 / 3, 2 / 3, 1.0, 1.0):
        smooth = np.log(road.roughest_1pm / roughness) / np.log(road.roughest_1pm / road.roughness_1pm)
        roughness *= np.exp(road.whiteness * (product - road.alike * smooth**2))
    assert roughness_after([1.0] * 5) == pytest.approx(roughness)
    assert roughness_after([1.0] * 500) == CONSTANTS.road.roughest_1pm
    assert roughness_after([1.0, -1.0] * 500) == CONSTANTS.road.roughness_1pm
    assert roughness_after([1.0] * 12, is_open=False) == 1e-7


def test_a_speed_that_is_held_for_a_second_makes_no_road_rough():
    """Five windows per report: what the first gains too little the others gain too much."""
    assert roughness_after([2.0, 0.5, -0.5, -1.0, -1.0] * 200) < 2.0 * CONSTANTS.road.roughness_1pm


def test_modes_exchange_probability_like_a_markov_chain():
    x, P = density(3)
    x[RESPONSE] = 0.0
    mode = [0.6, 0.0, 0.4, 0.0]
    filters = hypotheses.Filters(
        [[x.tolist() for _ in range(4)]], [[P.tolist() for _ in range(4)]], [mode], [1.0], [0.0], [0.0]
    )
    room = hypotheses.Room(
        [0.0] * N, np.zeros((N, N)).tolist(), [0.0] * N, np.zeros((N, N)).tolist(), [0.0] * N
    )
    hypotheses.exchange(filters, 0, 0, 2, 0.1, 0.3, RESPONSE, 5.0, room)
    assert mode == pytest.approx([0.6 * 0.9 + 0.4 * 0.3, 0.0, 0.6 * 0.1 + 0.4 * 0.7, 0.0])


def test_a_stop_changes_the_load_with_the_time_it_lasts():
    load = CONSTANTS.load
    assert changed_probability(0.0, load) == 0.0
    assert changed_probability(load.stop_s, load) == pytest.approx(1.0 - np.exp(-1.0))


def test_gaps_and_stops_count_as_time_in_which_the_load_is_not_seen():
    standing, blank = Standing(), dict.fromkeys(Window._fields, 0.0)
    still, gap = Window(**{**blank, "stopped": 1.0}), Window(**{**blank, "gap_s": 7.0})
    for window in [still] * 10 + [Window(**blank)] * 4 + [gap]:
        standing = stand(standing, window)
    assert standing.unknown_s == pytest.approx(9.0)


def test_a_wide_mixture_is_summed_over_the_masses():
    """One normal density of u, against a fine sum by numpy (uniform in log u, weight u)."""
    nodes = np.exp(np.linspace(np.log(1 / 40_000), np.log(1 / 8_000), 2001))
    mean, std = 1 / 20_000, 0.2 / 20_000
    x, P = np.zeros((1, 4, N)), np.zeros((1, 4, N, N))
    x[:, :, U], P[:, :, U, U] = mean, std * std
    filters = hypotheses.Filters(x.tolist(), P.tolist(), [[1.0, 0.0, 0.0, 0.0]], [1.0], [0.0], [0.0])
    found, var = summed_mixture(filters, nodes.tolist(), 0.0, 1.0)
    weight = nodes * np.exp(-0.5 * ((nodes - mean) / std) ** 2)
    expected = np.sum(weight / nodes) / weight.sum()
    assert found == pytest.approx(expected, rel=1e-6)
    assert var == pytest.approx(np.sum(weight / nodes**2) / weight.sum() - expected**2, rel=1e-5)
