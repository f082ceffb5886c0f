"""Rolling radius, drag and rolling resistance from drives of known mass (2005, section 3.3)."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.errors import CanestError
from canest.estimators.papers.vahidi2005.identify import model_acceleration, road_load, rolling_radius

from .synthetic import drive, with_columns


def test_radius_from_an_undriven_axle():
    rng = np.random.default_rng(0)
    w = rng.uniform(10.0, 50.0, 5000)
    v = 0.507 * w + 0.02 * rng.standard_normal(5000)
    slipping = rng.random(5000) < 0.05
    v[slipping] *= 0.9
    fit = rolling_radius(w, v, np.ones(5000, bool))
    assert fit.radius_m == pytest.approx(0.507, abs=1e-4)
    assert fit.std_m < 1e-3
    assert fit.samples < 5000 - 0.8 * slipping.sum()


def test_radius_needs_a_moving_vehicle():
    with pytest.raises(CanestError, match="rolling radius"):
        rolling_radius(np.zeros(500), np.zeros(500), np.ones(500, bool))


def rough_drive(factor=1.15, mu=0.0072, seconds=600.0, seed=0):
    """A drive over a range of speeds whose true drag and rolling resistance are not the declared ones."""
    rng = np.random.default_rng(seed)
    d = drive(seconds)
    n = len(d.block)
    v = 14.0 + 8.0 * np.sin(np.arange(n) / 3000.0)
    a = np.gradient(v, 0.02)
    slope = 0.02 * np.sin(np.arange(n) / 700.0)
    cosine = 1 / np.sqrt(1 + slope**2)
    aero = 3.8 * v * v
    force = 21_250.0 * (a + 9.80665 * cosine * (slope + mu)) + (factor - 1.0) * aero
    noise = np.convolve(rng.standard_normal(n + 49), np.ones(50) / 50, "valid") * 2000.0
    return with_columns(
        d.block, speed_mps=v, accel_mps2=a, slope=slope, aero_N=aero, force_N=force + noise
    ), slope


def test_drag_and_rolling_resistance_within_their_deviations():
    scores = []
    for seed in range(12):
        block, slope = rough_drive(seed=seed)
        fit = road_load(block, 21_250.0, slope)
        scores.append((fit.drag_factor - 1.15) / fit.drag_factor_std)
        assert fit.rolling_resistance == pytest.approx(0.0072, abs=5e-4)
        assert fit.correlation < 0.0
    assert np.sqrt(np.mean(np.square(scores))) < 2.0


def test_model_and_measurement_agree_where_the_model_is_right():
    d = drive(30.0, grade=0.02)
    a = model_acceleration(d.block, d.mass_kg, d.grade, 0.006)
    np.testing.assert_allclose(a, d.block.accel_mps2, atol=1e-12)


def test_a_drive_without_open_samples_is_refused():
    d = drive(30.0)
    closed = with_columns(d.block, gate=np.ones(len(d.block), np.uint8))
    with pytest.raises(CanestError, match="road load"):
        road_load(closed, d.mass_kg, d.grade)
