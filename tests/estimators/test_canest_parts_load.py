"""How loads are opened and become one, and how a delay is bounded: against moments by hand, in both forms."""

from __future__ import annotations

import numpy as np
import pytest

from canest.estimators.default import hypotheses, load, sensors
from canest.estimators.default import model as m
from canest.estimators.default.constants import CONSTANTS

from .test_canest_parts import TRUCK, dense, form, mixture

__all__ = ["form"]


def test_a_stop_changes_the_load_with_the_time_it_lasts():
    assert hypotheses.p_changed(0.0, 60.0) == 0.0
    assert hypotheses.p_changed(60.0, 60.0) == pytest.approx(1.0 - np.exp(-1.0))


@pytest.mark.parametrize("moving", [False, True])
def test_another_load_keeps_the_force_balance(moving):
    """u F - g theta has been right, whatever the load: it stays, and u is open."""
    mix, space = mixture(1)
    t = space.scratch
    mix.x[0, m.U], mix.x[0, m.GRADE] = 1 / 25_000, 0.02
    mix.P[0] *= 1e-12
    net_N, net_kg = 12_000.0, 12_000.0 / 9.80665
    count = load.open_load(mix, 1, 0.2, moving, net_N, CONSTANTS, TRUCK, t)
    assert count == 2
    np.testing.assert_allclose(mix.weight[:2], [0.8, 0.2])
    assert mix.load[0] != mix.load[1]
    assert mix.x[1, m.U] == pytest.approx(TRUCK.unknown_u)
    assert mix.P[1, m.U, m.U] == pytest.approx(TRUCK.unknown_var)
    balance = mix.x[:2, m.U] * net_kg - mix.x[:2, m.GRADE]
    assert balance[1] == pytest.approx(balance[0])
    h = dense((m.U, m.GRADE), (net_kg, -1.0))
    assert h @ mix.P[1] @ h < 1e-3 * net_kg**2 * TRUCK.unknown_var


def test_loads_that_say_the_same_leave_their_numbers_to_others():
    """Two loads 0.1 std apart become one, and then there is a number for another load in motion."""
    mix, space = mixture(3, loads=[0, 1, 2])
    std = 0.01 / 20_000
    for d, (stds, weight) in enumerate(((0.0, 0.6), (0.1, 0.3), (5.0, 0.1))):
        mix.x[d, m.U], mix.P[d, m.U], mix.P[d, :, m.U] = 1 / 20_000 + stds * std, 0.0, 0.0
        mix.P[d, m.U, m.U], mix.weight[d] = std * std, weight
    assert load.open_load(mix, 3, 0.01, True, 0.0, CONSTANTS, TRUCK, space.scratch) == 3
    load.merge_loads(mix, 3, space.scratch)
    assert list(mix.load[:3]) == [0, 0, 2]
    assert load.open_load(mix, 3, 0.01, True, 0.0, CONSTANTS, TRUCK, space.scratch) == 5


def test_a_load_of_negative_mean_is_the_densest_where_there_is_no_other():
    """A Gaussian knows no bounds; the first load, which has no density, was divided by."""
    mix, space = mixture(2, loads=[1, 1])
    mix.x[:2, m.U] = -1e-6
    assert hypotheses.set_loads(mix, 2, space.scratch) == 1
    load.merge_loads(mix, 2, space.scratch)
    assert list(mix.load[:2]) == [1, 1]


@pytest.mark.parametrize("ratio", [0.25, 0.5, 2.0, 4.0])
def test_loads_are_as_different_as_their_divergence(ratio):
    """Against the integral of p ln(p / q) by numpy."""
    mix, space = mixture(2, loads=[0, 1])
    stds = (0.01 / 20_000, 0.01 / 20_000 * np.sqrt(ratio))
    u = 1 / 20_000 + np.linspace(-0.2, 0.2, 40_001) / 20_000
    for off in (0.0, 0.2, 0.4, 0.6, 1.0):
        means = (1 / 20_000, 1 / 20_000 + off * stds[0])
        ln = [-0.5 * ((u - mean) / std) ** 2 - np.log(std) for mean, std in zip(means, stds, strict=True)]
        divergence = np.sum(np.exp(ln[1]) * (ln[1] - ln[0])) / np.sum(np.exp(ln[1]))
        for d in range(2):
            mix.load[d] = d
            mix.x[d, m.U], mix.P[d, m.U, m.U] = means[d], stds[d] ** 2
            mix.weight[d] = (0.9, 0.1)[d]
        load.merge_loads(mix, 2, space.scratch)
        assert (mix.load[1] == mix.load[0]) == (divergence < 0.1)


@pytest.mark.parametrize("delay_s", [-0.5, -0.2, 0.1, 0.4])
def test_a_delay_beyond_the_longest_is_brought_back_to_it(delay_s):
    """The most probable state within the bound: x given its delay, and the density there."""
    mix, _ = mixture(2)
    u = 1 / 20_000
    for d in range(2):
        mix.x[d, m.U] = u
    mix.P[0, m.DELAY] *= u
    mix.P[0, :, m.DELAY] *= u
    mix.x[0, m.DELAY], mix.x[1, m.DELAY] = delay_s * u, 0.0
    x, P, other = mix.x[0].copy(), mix.P[0].copy(), mix.A[1].copy()
    sensors.bound_delay(mix, 2, CONSTANTS, TRUCK)
    bound = np.clip(delay_s, -CONSTANTS.longest_delay_s, CONSTANTS.longest_delay_s) * u
    off = bound - x[m.DELAY]
    np.testing.assert_allclose(mix.x[0], x + P[m.DELAY] / P[m.DELAY, m.DELAY] * off, rtol=1e-9)
    np.testing.assert_array_equal(mix.P[0], P)
    np.testing.assert_array_equal(mix.A[1], other)
    less = np.exp(-0.5 * CONSTANTS.likelihood_power * off**2 / P[m.DELAY, m.DELAY])
    assert mix.weight[0] / mix.weight[1] == pytest.approx(less)
    assert mix.weight[0] + mix.weight[1] == pytest.approx(1.0)


def test_delays_far_beyond_the_longest_leave_probabilities():
    mix, _ = mixture(2)
    for d in range(2):
        mix.P[d] *= 1e-18
        mix.x[d, m.U], mix.x[d, m.DELAY] = 1 / 20_000, (d + 1) / 20_000
    sensors.bound_delay(mix, 2, CONSTANTS, TRUCK)
    assert sum(mix.weight[:2]) == pytest.approx(1.0)


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("count", [m.MOST - 3, m.MOST])
def test_a_new_load_has_no_more_densities_than_there_is_room_for(count, moving):
    mix, space = mixture(count)
    assert load.open_load(mix, count, 0.2, moving, 0.0, CONSTANTS, TRUCK, space.scratch) == m.MOST
    assert sum(mix.weight[: m.MOST]) == pytest.approx(1.0)


def test_a_new_load_copies_those_with_another_disturbance_too():
    """They are of the same load, whatever the wind."""
    mix, space = mixture(3, loads=[m.OTHER_DISTURBANCE] * 3)
    assert load.open_load(mix, 3, 0.2, True, 0.0, CONSTANTS, TRUCK, space.scratch) == 6
    assert sum(mix.weight[:6]) == pytest.approx(1.0)
    assert sum(mix.weight[3:6]) == pytest.approx(0.2)
