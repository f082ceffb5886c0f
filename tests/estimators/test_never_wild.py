"""No estimator ever returns NaN after its first number, infinity or a value outside its bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core import jit
from canest.core.samples import Status
from canest.estimators.registry import BUILT_IN, create

from .synthetic import FACTS, drive, with_columns

PAPERS = [name for name in BUILT_IN if not name.startswith("canest")]
VARIANTS = [(name, {}) for name in PAPERS] + [
    ("rlsmf", {"regression": "integrated"}),
    ("rlsmf", {"preset": "2005-experiment"}),
    ("rls", {"preset": "2005-figure-3"}),
    ("rls-vector", {"preset": "2005-experiment"}),
    ("rgtls", {"preset": "2013"}),
    ("ekf", {"preset": "2014"}),
    ("ekf-select", {"preset": "2014"}),
    ("pmg", {"forgetting": 0.99}),
]


def check(r, limit=0.25):
    for column in (r.mass_kg, r.mass_std_kg, r.grade, r.grade_std):
        known = np.flatnonzero(~np.isnan(column))
        if len(known):
            assert not np.isnan(column[known[0] :]).any()
        assert not np.isinf(column).any()
    mass = r.mass_kg[~np.isnan(r.mass_kg)]
    assert np.all((mass >= FACTS.mass_min_kg) & (mass <= FACTS.mass_max_kg))
    assert np.all(np.abs(r.grade[~np.isnan(r.grade)]) <= limit)
    for std in (r.mass_std_kg, r.grade_std):
        assert np.all(std[~np.isnan(std)] >= 0.0)
    assert np.all(r.mass_std_kg[~np.isnan(r.mass_kg)] <= FACTS.mass_max_kg)
    assert set(np.unique(r.status)) <= {int(s) for s in Status}


def constant(n, force, accel):
    d = drive(n / 50)
    ones = np.ones(len(d.block))
    return with_columns(
        d.block,
        force_N=force * ones,
        accel_mps2=accel * ones,
        speed_mps=np.clip(20.0 + accel * 0.02 * np.arange(len(ones)), -140, 140),
        accelerometer_mps2=accel * ones,
        aero_N=0.0 * ones,
    )


@pytest.mark.parametrize(("name", "options"), VARIANTS)
@settings(max_examples=8, deadline=None)
@given(
    force=st.sampled_from([0.0, -1e4, 1.0, 5e4, 9.9e5]),
    accel=st.sampled_from([0.0, 1e-9, -0.5, 3.0, 49.0]),
)
def test_constant_regressors(name, options, force, accel):
    check(create(name, FACTS, options).update(constant(1500, force, accel)))


@pytest.mark.parametrize(("name", "options"), VARIANTS)
@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    size=st.sampled_from([1.0, 30.0, 1e6, 1e300, np.inf, np.nan]),
    share=st.sampled_from([0.01, 0.3]),
)
def test_huge_outliers(name, options, seed, size, share):
    rng = np.random.default_rng(seed)
    d = drive(30.0, seed=seed, noise_mps2=0.05)
    columns = {}
    for column in ("force_N", "accel_mps2", "speed_mps", "accelerometer_mps2", "aero_N", "slope", "mu"):
        values = getattr(d.block, column).copy()
        hit = rng.random(len(values)) < share
        with np.errstate(over="ignore", invalid="ignore"):
            values[hit] = values[hit] + size * rng.standard_normal(hit.sum())
        columns[column] = values
    check(create(name, FACTS, options).update(with_columns(d.block, **columns)))


@pytest.mark.parametrize(("name", "options"), VARIANTS)
@settings(max_examples=4, deadline=None)
@given(mass=st.sampled_from([100.0, 7_000.0, 40_000.0, 1e6]), pulse=st.sampled_from([0.04, 1.0, 100.0]))
def test_zero_noise_and_masses_outside_the_bounds(name, options, mass, pulse):
    check(create(name, FACTS, options).update(drive(20.0, mass_kg=mass, pulse_s=pulse).block))


@pytest.mark.skipif(not jit.available(), reason="numba is an extra")
@pytest.mark.parametrize(("name", "options"), VARIANTS)
def test_hours_without_excitation(name, options):
    start = drive(30.0, noise_mps2=0.02).block
    still = constant(2000, 8_000.0, 0.0)
    jit.enable(True)
    try:
        method = create(name, FACTS, options)
        check(method.update(start))
        for _ in range(180):  # two hours
            r = method.update(still)
        check(r)
        check(method.update(drive(30.0, seed=2).block))
    finally:
        jit.enable(False)
