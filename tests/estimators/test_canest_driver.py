"""Drivers whom the road answers: the share of their torque that does is a state."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.default import driver
from canest.estimators.default import model as m
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.default.estimator import GaussianSum
from tests.estimators.momentum import trip
from tests.estimators.test_canest_loads_and_roads import STATED
from tests.estimators.test_canest_parts import mixture

U = 1.0 / 20_000.0


@pytest.mark.parametrize("left", [0.0, 0.3, 1.0])
def test_an_answer_is_drawn_anew_as_sums_of_random_numbers_are(left):
    """The state becomes left S + (1 - left) u / 2 + noise: F x and F P F' + Q with dense matrices."""
    mix, _ = mixture(1)
    mix.x[0, m.U], x, P = U, mix.x[0].copy(), mix.P[0].copy()
    x[m.U] = U
    F = np.eye(len(x))
    F[m.ANSWER, m.ANSWER], F[m.ANSWER, m.U] = left, (1.0 - left) / 2.0
    expected = F @ P @ F.T
    expected[m.ANSWER, m.ANSWER] += (1.0 - left * left) * U * U / 12.0
    driver.draw_answer(mix, 0, left, U)
    np.testing.assert_allclose(mix.x[0], F @ x, rtol=1e-12)
    np.testing.assert_allclose(mix.P[0], expected, rtol=1e-9, atol=1e-22)


def test_what_a_road_asks_for_grows_with_the_metres():
    """9.8 (2e-4 4 m) = 0.008 m/s2: 0.1 m/s2 in a window at 20 m/s is the driver's own, in 60 m a crest's."""
    N, wander = 0.1 / U, CONSTANTS.smooth_wander_1pm
    fast = driver.answer_log_likelihood.interpreted(N, U, 4.0, wander, 4e-8, CONSTANTS)
    slow = driver.answer_log_likelihood.interpreted(N, U, 60.0, wander, 4e-8, CONSTANTS)
    assert fast < -3.0
    assert slow == 0.0
    assert driver.answer_log_likelihood.interpreted(100.0 * N, U, 4.0, wander, 4e-8, CONSTANTS) == -30.0


@pytest.mark.parametrize(("gain", "mass_kg"), [(0.3, 12_000.0), (0.6, 30_000.0), (0.3, 20_000.0)])
def test_a_cruise_control_that_follows_traffic_over_hills_makes_no_wrong_mass_valid(gain, mass_kg):
    """A part of its torque answers the road: u times the rest is all that speeds and torque show."""

    def follow(t, v):
        traffic_mps = 22.0 + np.sin(t / 7.0) + 0.6 * np.sin(t / 3.1 + 2.0)
        return float(np.clip(0.27 + gain * (traffic_mps - v), -0.03, 0.85))

    def road(s):
        return 0.01 * np.sin(s / 100.0) + 0.008 * np.sin(s / 230.0 + 1.0)

    drive = trip(300.0, mass_kg=mass_kg, road=road, throttle=follow, seed=2, start_mps=22.0)
    e = GaussianSum("canest", STATED).update(drive.block)
    wrong = (e.status == Status.VALID) & (np.abs(drive.error(e)) > 0.08)
    assert wrong.sum() == 0
