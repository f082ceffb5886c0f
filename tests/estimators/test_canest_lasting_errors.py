"""Errors that last longer than a window: innovations that are not white widen the standard deviations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from canest.estimators.default.constants import CONSTANTS, vehicle_of
from canest.estimators.default.model import Window
from canest.estimators.default.noise import Levels, first_levels, follow, unexplained
from canest.estimators.registry import create
from canest.report.verdicts import of_low_nis

from .momentum import flat, trip
from .test_canest_lag import steps
from .test_canest_loads_and_roads import STATED

KG = 21_000.0
LEFT = 0.7


def coloured(n: int, kept: float, rng: np.random.Generator) -> np.ndarray:
    """Return numbers of variance 1, of each of which a part is kept by the next (n,)."""
    numbers = rng.standard_normal(n)
    for k in range(1, n):
        numbers[k] = kept * numbers[k - 1] + math.sqrt(1.0 - kept * kept) * numbers[k]
    return numbers


def after(innovations: np.ndarray) -> Levels:
    """Return the levels after open windows with these innovations over their standard deviations."""
    vehicle = vehicle_of(STATED, 0.1, CONSTANTS)
    still = Window(*[0.0] * len(Window._fields))
    levels = first_levels.interpreted(vehicle)
    for e in innovations:
        levels = follow.interpreted(levels, still, (e * e, float(e)), 0.0, 0.0, False, CONSTANTS, vehicle)
    return levels


@pytest.mark.parametrize("kept", [-0.5, 0.0, 0.5, 0.9])
@pytest.mark.parametrize("std", [0.5, 1.0, 1.5])
def test_variances_grow_with_what_lasts_of_the_innovations(kept, std):
    """The variance of a low-passed first-order process is (1 + a b) / (1 - a b) times its own."""
    rng = np.random.default_rng(5)
    found = [after(std * coloured(2500, kept, rng)) for _ in range(12)]
    expected = std * std * (1.0 + LEFT * kept) / (1.0 - LEFT * kept)
    low_nis = np.mean([levels.low_nis for levels in found])
    assert low_nis == pytest.approx(expected, rel=0.3)
    for levels in found:
        assert unexplained.interpreted(levels) == max(levels.low_nis, 1.0)
        assert levels.nis == pytest.approx(std * std, rel=0.5)


def test_one_gross_innovation_widens_little():
    quiet = np.zeros(600)
    quiet[300] = 1e6
    assert after(quiet).low_nis < 0.1
    assert after(quiet[:301]).low_nis < 1.0


def gusts(seed: int, std_N: float = 800.0, lasts_s: float = 1.5):
    """Return a force that nobody declares, by time: of this std, and correlated for so long."""
    forces_N = std_N * coloured(1500, math.exp(-0.2 / lasts_s), np.random.default_rng(seed))
    times_s = 0.2 * np.arange(len(forces_N))
    return lambda t: float(np.interp(t, times_s, forces_N))


def test_masses_stay_within_their_standard_deviations_where_errors_last():
    """Without it three quarters of them were within two standard deviations."""
    inside, computed, lasting = [], [], []
    for seed in range(10):
        drive = trip(240, mass_kg=KG, road=flat, throttle=steps, unseen_N=gusts(seed), seed=seed)
        estimator = create("canest", STATED)
        estimates = estimator.update(drive.block)
        late = slice(60 * 50, None)
        error, std = np.abs(drive.error(estimates))[late], (estimates.mass_std_kg / estimates.mass_kg)[late]
        low_nis = estimator.snapshot()["low_nis"]
        inside.append(np.mean(error < 2.0 * std))
        computed.append(np.mean(error < 2.0 * std / math.sqrt(max(low_nis, 1.0))))
        lasting.append(low_nis)
    assert np.mean(inside) > 0.95
    assert np.mean(computed) < 0.9
    assert np.mean(lasting) > 1.2


def test_the_report_tells_errors_that_last():
    assert "2.0 times as wide" in of_low_nis(4.0).text
    assert of_low_nis(4.0).tone == "warn"
    assert of_low_nis(1.1).tone == "good"
