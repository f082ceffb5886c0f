"""Roads that bend more than country roads: variances follow what there was."""

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
from .test_canest_parts import TRUCK, mixture

USUAL = CONSTANTS.curvature_std_1pm**2
VEHICLE = TRUCK._replace(offset_Nm=10.0)
U = 5e-5


def wanted(t, v):
    """A driver who wants another speed every 15 s, and holds it hill or not."""
    mps = 15.0 + np.random.default_rng(int(t / 15.0)).normal(0.0, 2.5)
    return float(np.clip(0.3 + 0.5 * (mps - v), -0.03, 0.85))


@pytest.mark.parametrize(("length_m", "sine", "phase"), [(200.0, 0.03, 3.0), (250.0, 0.04, 2.0)])
def test_short_waves_of_the_road_are_no_mass(length_m, sine, phase):
    """With the curvature of country roads all and 60 % of the valid samples were 8 to 13 % wrong here."""
    drive = trip(
        400,
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


def spreads(mix, before, metres=25.0, seconds=1.0):
    return predict.follow_spreads(mix, 2, before, metres, seconds, U, CONSTANTS, VEHICLE)


def with_spreads(mix, bend_1pm, offset_Nm):
    """Give every density a curvature and an offset of a mean, known well."""
    for i, mean in ((m.CURVATURE, bend_1pm), (m.OFFSET, offset_Nm * U)):
        mix.x[:2, i], mix.P[:2, i, i] = mean, (0.1 * mean) ** 2
    return mix


def test_what_nobody_has_learned_leaves_the_variances_alone():
    mix, _ = mixture(2, modes=[m.CURVED, m.CURVED])
    for i, var in ((m.CURVATURE, 2.0 * USUAL), (m.OFFSET, (30.0 * U) ** 2)):
        mix.x[:2, i], mix.P[:2, i, i] = 0.0, var
    before = predict.Spreads(2.0 * USUAL, 900.0)
    assert spreads(mix, before) == pytest.approx(tuple(before))


def test_sharp_bends_and_large_offsets_raise_them_and_they_return():
    mix, _ = mixture(2, modes=[m.CURVED, m.CURVED])
    first = predict.Spreads(USUAL, 100.0)
    one = spreads(with_spreads(mix, 5e-4, 60.0), first)
    part = 25.0 / CONSTANTS.straight_length_m
    assert one.bend_var == pytest.approx(USUAL + part * (1.01 * 25e-8 - USUAL))
    assert one.offset_var == pytest.approx(100.0 + (1.01 * 3600.0 - 100.0) / CONSTANTS.offset_duration_s)
    assert spreads(with_spreads(mix, 1e-5, 1.0), one, 1e6, 1e6) == pytest.approx(tuple(first))
    sharpest = spreads(with_spreads(mix, 1e-2, 60.0), first, 1e6, 1e6).bend_var
    assert sharpest == pytest.approx(CONSTANTS.sharp_curvature_1pm**2)


def test_a_straight_says_nothing_of_bends():
    mix, _ = mixture(2, modes=[m.STRAIGHT, m.STRAIGHT])
    before = predict.Spreads(3.0 * USUAL, 100.0)
    assert spreads(with_spreads(mix, 5e-4, 10.0), before).bend_var == pytest.approx(3.0 * USUAL)
