"""Slopes of one drive, given what it found further on: of a gap, both ends count."""

from __future__ import annotations

import numpy as np
import pytest

from canest.road.tracks import ROUGHNESS_1PM, smoothed


def filtered(slope: np.ndarray, noise: np.ndarray, step_m: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what a causal filter makes of measured slopes (n,), and its variance; noise inf: nothing."""
    rng = np.random.default_rng(seed)
    x, p, xs, ps = 0.0, 1.0, [], []
    for true, std in zip(slope, noise, strict=True):
        p += ROUGHNESS_1PM * step_m
        if np.isfinite(std):
            gain = p / (p + std * std)
            x += gain * (true + rng.normal(0.0, std) - x)
            p *= 1.0 - gain
        xs.append(x)
        ps.append(p)
    return np.array(xs), np.array(ps)


def random_walk(n: int, step_m: float, seed: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0.0, np.sqrt(ROUGHNESS_1PM * step_m), n))


def test_a_gap_is_filled_from_both_ends_and_the_std_is_honest():
    step_m, n = 10.0, 400
    noise = np.full(n, 0.01)
    for begin in range(50, n - 30, 60):
        noise[begin : begin + 30] = np.inf  # 300 m
    before, after, normed = [], [], []
    for seed in range(20):
        slope = random_walk(n, step_m, seed)
        x, p = filtered(slope, noise, step_m, 1000 + seed)
        s, std = smoothed(step_m * np.arange(n), x, np.sqrt(p))
        before.append(x - slope)
        after.append(s - slope)
        normed.append((s - slope) / std)
    gap = ~np.isfinite(noise)
    rms = [np.sqrt(np.mean(np.square(np.array(e)[:, gap]))) for e in (before, after)]
    assert rms[1] < 0.65 * rms[0]
    assert 0.9 < np.sqrt(np.mean(np.square(normed))) < 1.1


def test_what_is_known_well_hardly_changes():
    slope = np.array([0.0, 0.03, -0.02, 0.04])
    s, std = smoothed(np.array([0.0, 25.0, 50.0, 75.0]), slope, np.full(4, 3e-4))
    assert s == pytest.approx(slope, abs=3e-4)
    assert std == pytest.approx(3e-4, rel=0.1)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_samples_are_no_special_case(n):
    s, std = smoothed(np.arange(n) * 10.0, np.full(n, 0.01), np.full(n, 0.001))
    assert (len(s), len(std)) == (n, n)
    assert np.all(s == 0.01)
    assert np.all(std <= 0.001)
