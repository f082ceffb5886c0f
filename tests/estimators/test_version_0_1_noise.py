"""Noise levels that `canest` follows: learned from noise, not from what the states are in doubt."""

from __future__ import annotations

import numpy as np
import pytest

from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.noise import (
    LEAST_SWING_MPN,
    MOST_SWING_MPN,
    RINGS,
    SWING_MPN,
    follow_swing,
    level,
    ring,
    surplus,
)


@pytest.mark.parametrize("doubt", [0.0, 0.3, 3.0])
def test_a_level_is_found_whatever_the_states_covariance(doubt):
    """doubt: variance of what the states add to an innovation, in true noise variances."""
    rng, true, found, ends = np.random.default_rng(4), 4e-4, 1e-3, []
    for i in range(20_000):
        e = rng.normal(0.0, np.sqrt(true * (1.0 + doubt)))
        found = level(found, surplus(e, found + true * doubt, found), 1e-6, i)
        ends.append(found)
    # outliers are cut, so it is a little low
    assert np.mean(ends[5000:]) == pytest.approx(true, rel=0.2)


def test_one_uncertain_window_makes_no_noise_zero():
    variance = 1.6e-4
    expected = 0.05  # of the innovation: the load is new
    after = level(variance, surplus(0.0, expected, variance), 1e-6, 300)
    assert after > 0.95 * variance


def test_a_shove_rings_and_dies_away():
    memory = [0.0] * at.MEMORY
    first = ring(memory, 10_000.0, 0.5)
    assert first == pytest.approx(0.25 * 1e8)
    assert ring(memory, 0.0, 0.5) == pytest.approx(first * RINGS)
    assert ring(memory, 0.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("swing_mpN", "found_mpN"), [(5e-6, 5e-6), (0.0, LEAST_SWING_MPN), (1.0, MOST_SWING_MPN)]
)
def test_how_much_a_driveline_swings_is_learned(swing_mpN, found_mpN):
    rng, memory = np.random.default_rng(5), [0.0] * at.MEMORY
    memory[at.SWING_VAR] = SWING_MPN**2
    ends = []
    for _ in range(20_000):
        rings = ring(memory, rng.normal(0.0, 5_000.0), 0.8)
        variance = memory[at.SWING_VAR] * rings
        e = rng.normal(0.0, swing_mpN * np.sqrt(rings))
        follow_swing(memory, surplus(e, variance, variance) / rings)
        ends.append(memory[at.SWING_VAR])
    assert np.sqrt(np.mean(ends[5000:])) == pytest.approx(found_mpN, rel=0.2)
