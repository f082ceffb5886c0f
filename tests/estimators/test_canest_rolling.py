"""Tyres that roll harder than stated: a grade that is too steep, and is known to be uncertain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.estimator import GaussianSum
from tests.estimators.momentum import FACTS, MU, trip

EXACT = replace(FACTS, rolling_resistance=MU, rolling_resistance_accuracy=0.05, drag_area_accuracy=0.05)
COLD_N = 0.5 * MU * 21_000.0 * GRAVITY_MPS2


def slow(t, v):
    """About 10 m/s, where a wind says little."""
    return float(np.clip(0.15 + 0.2 * np.sin(t / 2.2) + 0.1 * (9.0 - v), -0.03, 0.85))


@pytest.mark.parametrize("accelerometer", [False, True])
def test_cold_tyres_make_no_grade_surer_than_it_is(accelerometer):
    """They roll 50 % harder at first, and act like a slope of 0.3 %."""
    drive = trip(
        400.0, throttle=slow, start_mps=9.0, accelerometer=accelerometer, noise=0.3,
        unseen_N=lambda t: COLD_N * np.exp(-t / 1_200.0),
    )  # fmt: skip
    estimates = GaussianSum("canest", replace(EXACT, has_accelerometer=accelerometer)).update(drive.block)
    settled = slice(3_000, None)
    off = np.abs(estimates.grade - drive.grade)[settled]
    assert (off < 2.0 * estimates.grade_std[settled]).mean() > 0.95
    assert np.abs(drive.error(estimates)[settled]).max() < 0.01


def test_a_height_tells_tyres_from_a_slope():
    off = []
    for altitude in (False, True):
        drive = trip(
            900.0, throttle=slow, start_mps=9.0, altitude=altitude, noise=0.3, unseen_N=lambda t: COLD_N
        )
        estimates = GaussianSum("canest", EXACT).update(drive.block)
        off.append((estimates.grade - drive.grade)[30_000:].mean())
    assert 0.0 < off[1] < 0.6 * off[0]
