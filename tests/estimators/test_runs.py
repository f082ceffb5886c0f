"""Standard deviations that know how many rows are news."""

from __future__ import annotations

import numpy as np
import pytest

from canest.estimators.autocorrelation import AutocorrelationInflation
from canest.estimators.registry import create

from .synthetic import FACTS, drive, with_columns


def smooth(noise, length):
    kernel = np.ones(length) / np.sqrt(length)
    return np.convolve(noise, kernel, "full")[: len(noise)]


def test_white_noise_is_all_news():
    factor = AutocorrelationInflation()(np.random.default_rng(0).standard_normal(20_000))
    assert factor[-1] == pytest.approx(1.0, abs=0.05)


def test_smooth_noise_is_worth_its_runs():
    factor = AutocorrelationInflation()(smooth(np.random.default_rng(0).standard_normal(50_000), 25))
    assert 4.0 < factor[-1] < 25.0


def test_carried_over_blocks():
    x = smooth(np.random.default_rng(1).standard_normal(500), 5)
    whole, part = AutocorrelationInflation(), AutocorrelationInflation()
    expected = whole(x)
    np.testing.assert_array_equal(np.concatenate([part(c) for c in np.split(x, [1, 7, 300])]), expected)


def test_one_outlier_changes_nothing_but_its_own_sign():
    x = smooth(np.random.default_rng(2).standard_normal(5000), 10)
    wild = x.copy()
    wild[2500] = 1e12
    assert AutocorrelationInflation()(wild)[-1] == pytest.approx(AutocorrelationInflation()(x)[-1], rel=0.01)


def test_mass_errors_of_filtered_noise_are_within_a_few_deviations():
    """With noise of 50 rows' memory the plain covariance claims several times too much."""
    ratios = []
    for seed in range(12):
        d = drive(120.0, pulse_s=2.0, seed=seed)
        noise = 0.02 * smooth(np.random.default_rng(seed).standard_normal(len(d.block)), 50)
        block = with_columns(d.block, accel_mps2=d.block.accel_mps2 + noise)
        r = create("batch-ls", FACTS, {}).update(block)
        ratios.append((r.mass_kg[-1] - d.mass_kg) / r.mass_std_kg[-1])
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 3.0
