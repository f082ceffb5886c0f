"""Roads that bend more than country roads: the variance of the curvature follows them."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.default import model as m
from canest.estimators.default import predict
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.registry import create

from .momentum import trip
from .test_canest_loads_and_roads import STATED
from .test_canest_parts import mixture

USUAL = CONSTANTS.curvature_std_1pm**2


def wanted(t, v):
    """A driver who wants another speed every 15 s, and holds it hill or not."""
    mps = 15.0 + np.random.default_rng(int(t / 15.0)).normal(0.0, 2.5)
    return float(np.clip(0.3 + 0.5 * (mps - v), -0.03, 0.85))


@pytest.mark.parametrize(("length_m", "sine", "phase"), [(200.0, 0.03, 3.0), (250.0, 0.04, 2.0)])
def test_short_waves_of_the_road_are_no_mass(length_m, sine, phase):
    """With the curvature of country roads all and 60 % of the valid samples were 8 to 13 % wrong here."""
    drive = trip(
        900,
        mass_kg=14_000.0,
        road=lambda s: sine * np.sin(2.0 * np.pi * s / length_m + phase),
        throttle=wanted,
        altitude=True,
        seed=int(phase),
    )
    estimates = create("canest", STATED).update(drive.block)
    late = slice(60 * 50, None)
    valid = estimates.status[late] == Status.VALID
    error = np.abs(drive.error(estimates)[late][valid])
    assert valid.mean() > 0.1
    assert error.max() < 0.08
    assert (error * 14_000.0 < 3.0 * estimates.mass_std_kg[late][valid]).all()


def curved(bend_1pm, std_1pm, road=m.CURVED):
    """Densities with a curvature of this mean and std."""
    mix, _ = mixture(2, modes=[road, road])
    mix.x[:2, m.CURVATURE], mix.P[:2, m.CURVATURE, m.CURVATURE] = bend_1pm, std_1pm**2
    return mix


def test_what_nobody_has_learned_leaves_the_variance_alone():
    mix = curved(0.0, np.sqrt(2.0 * USUAL))
    assert predict.follow_bends(mix, 2, 2.0 * USUAL, 25.0, CONSTANTS) == pytest.approx(2.0 * USUAL)


def test_sharp_bends_raise_it_and_it_returns():
    sharp = predict.follow_bends(curved(5e-4, 1e-4), 2, USUAL, 25.0, CONSTANTS)
    part = 25.0 / CONSTANTS.straight_length_m
    assert sharp == pytest.approx(USUAL + part * (26e-8 - USUAL))
    assert predict.follow_bends(curved(1e-5, 1e-5), 2, sharp, 1e6, CONSTANTS) == pytest.approx(USUAL)
    sharpest = predict.follow_bends(curved(1e-2, 1e-4), 2, USUAL, 1e6, CONSTANTS)
    assert sharpest == pytest.approx(CONSTANTS.sharp_curvature_1pm**2)


def test_a_straight_says_nothing_of_bends():
    mix = curved(5e-4, 1e-4, road=m.STRAIGHT)
    assert predict.follow_bends(mix, 2, 3.0 * USUAL, 25.0, CONSTANTS) == 3.0 * USUAL
