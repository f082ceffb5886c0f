"""The project's own estimators: the same bits however samples are cut, and no number out of bounds."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core import jit
from canest.core.gates import Gate
from canest.core.samples import EstimateBlock, ModelBlock
from canest.estimators.default.windows import COLUMNS, Windows
from canest.estimators.registry import create
from canest.estimators.windowing import SHIFT, TICKS

from .momentum import FACTS, trip

NAMES = [f.name for f in fields(EstimateBlock)]
STATED = replace(FACTS, initial_mass_kg=15_000.0, torque_accuracy=0.01, wheel_radius_accuracy=0.0025)
SENSED = replace(FACTS, has_accelerometer=True)
OWN = pytest.mark.parametrize("own", ["canest-0.1", "canest"])


@cache
def rough():
    """A minute with everything: stops, gates, accelerometer with holes, undriven axle, altitude, a gap."""
    drive = trip(
        60, accelerometer=True, altitude=True, slip_per_mps2=0.005, stops=[(30, 33)], delay_s=0.1, seed=4
    )
    block = drive.block
    gate, ax_ok, t_us = block.gate.copy(), block.ax_ok.copy(), block.t_us.copy()
    gate[400:460], gate[900:1000], gate[2600:2700] = Gate.SHIFT, Gate.RETARDER, Gate.RECOVERY
    ax_ok[700:730] = False
    t_us[2100:] += 37 * 20_000
    force = block.force_N.copy()
    force[[2400, 2401]] = np.nan
    return replace(block, gate=gate, ax_ok=ax_ok, t_us=t_us, force_N=force)


def columns(parts):
    return {name: np.concatenate([getattr(p, name) for p in parts]) for name in NAMES}


@cache
def whole(own):
    return columns([create(own, SENSED).update(rough())])


def assert_same(a, b):
    for name in NAMES:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@OWN
@settings(max_examples=20, deadline=None)
@given(edges=st.lists(st.integers(0, 3000), max_size=12))
def test_any_cut_gives_the_same_bits(own, edges):
    block, estimator = rough(), create(own, SENSED)
    bounds = [0, *sorted(edges), len(block)]
    parts = [estimator.update(block[a:b]) for a, b in pairwise(bounds)]
    assert_same(columns(parts), whole(own))


@OWN
def test_tick_by_tick_gives_the_same_bits(own):
    block, estimator = rough(), create(own, SENSED)
    parts = [estimator.update(block[i : i + 1]) for i in range(len(block))]
    assert_same(columns(parts), whole(own))


@OWN
def test_an_accelerometer_first_received_after_a_long_stop_gives_the_same_bits(own):
    block = trip(75, accelerometer=True, stops=[(15, 50)]).block
    block = replace(block, ax_ok=block.ax_ok & (np.arange(len(block)) >= 3000))
    estimator = create(own, SENSED)
    parts = [estimator.update(block[i : i + 10]) for i in range(0, len(block), 10)]
    assert_same(columns(parts), columns([create(own, SENSED).update(block)]))


@OWN
@pytest.mark.skipif(not jit.available(), reason="numba is not installed")
def test_compiled_gives_the_same_bits(own):
    jit.enable()
    try:
        compiled = columns([create(own, SENSED).update(rough())])
    finally:
        jit.enable(False)
    assert_same(compiled, whole(own))


def check(e):
    for column in (e.mass_kg, e.mass_std_kg, e.grade, e.grade_std):
        assert np.isfinite(column).all()
    assert ((e.mass_kg >= FACTS.mass_min_kg * 0.999999) & (e.mass_kg <= FACTS.mass_max_kg * 1.000001)).all()
    assert ((e.mass_std_kg > 0) & (e.mass_std_kg <= FACTS.mass_max_kg)).all()
    assert (np.abs(e.grade) < 0.36).all()
    assert ((e.grade_std > 0) & (e.grade_std <= 1.0)).all()


def estimated(own, block):
    """Run compiled where that saves minutes; both give the same bits."""
    jit.enable(own == "canest")
    try:
        return create(own, STATED).update(block)
    finally:
        jit.enable(False)


@OWN
@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    size=st.sampled_from([3.0, 100.0, 1e6, 1e300, np.inf, np.nan]),
    share=st.sampled_from([0.002, 0.3]),
)
def test_outliers_in_every_column_never_reach_the_estimate(own, seed, size, share):
    rng, block = np.random.default_rng(seed), rough()
    bad = {}
    for f in fields(ModelBlock):
        column = getattr(block, f.name)
        if column is not None and column.dtype == np.float64:
            hit = rng.random(len(column)) < share
            with np.errstate(invalid="ignore", over="ignore"):
                bad[f.name] = np.where(hit, column * size * rng.choice([-1, 1], len(column)), column)
    check(estimated(own, replace(block, **bad)))


@OWN
@settings(max_examples=20, deadline=None)
@given(
    force=st.sampled_from([0.0, -1e4, 1.0, 5e4, 9e5]),
    accel=st.sampled_from([0.0, 1e-9, -0.5, 3.0, 49.0]),
    speed=st.sampled_from([0.0, 1e-6, 20.0, 140.0]),
)
def test_constant_regressors_never_get_out(own, force, accel, speed):
    block = rough()
    n = len(block)
    flat = {"force_N": force, "traction_N": force, "accel_mps2": accel, "speed_mps": speed, "aero_N": 0.0}
    constant = {name: np.full(n, value) for name, value in flat.items()}
    check(estimated(own, replace(block, gate=np.zeros(n, np.uint8), **constant)))


def covariances(estimator):
    if estimator.name == "canest-0.1":
        return np.array(estimator._PP)
    return estimator._mixture.P[: int(estimator._carried.progress.alive)]


@OWN
@pytest.mark.parametrize("standing", [False, True])
def test_hours_without_excitation(own, standing):
    """Six hours at one speed, or parked: the covariance stays a covariance."""
    hour = 180_000
    block = rough()[np.resize(np.arange(1000, 1200), hour)]
    v = np.full(hour, 0.0 if standing else 22.0)
    jit.enable()
    try:
        estimator = create(own, STATED)
        for i in range(6):
            e = estimator.update(
                replace(
                    block,
                    t_us=(np.arange(hour) + i * hour) * 20_000,
                    gate=np.full(hour, Gate.LOW_SPEED if standing else Gate.OPEN, np.uint8),
                    speed_mps=v,
                    accel_mps2=0.0 * v,
                    force_N=0.0 * v + 1300.0,
                    traction_N=0.0 * v + 3100.0,
                    stopped=np.full(hour, standing),
                )
            )
            check(e)
    finally:
        jit.enable(False)
    for P in covariances(estimator):
        assert (np.diag(P) >= 0).all()
        scale = np.sqrt(np.maximum(np.diag(P), 1e-300))
        assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-6


@OWN
def test_no_noise_at_all(own):
    drive = trip(100, noise=0.0)
    estimator = create(own, STATED)
    e = estimator.update(drive.block)
    check(e)
    assert abs(drive.error(e)[-1]) < 0.02


def test_a_window_is_the_sum_of_its_samples():
    """Every column of one window against plain means and differences."""
    drive = trip(4, accelerometer=True, altitude=True, slip_per_mps2=0.003)
    b = drive.block
    windows, ends = Windows().push(b)
    w = dict(zip(COLUMNS, windows[:, 5], strict=True))
    end = int(ends[5])
    assert (b.t_us[end] // 20_000 + 1) % TICKS == 0
    now, back = slice(end - TICKS + 1, end + 1), slice(end - TICKS + 1 - SHIFT, end + 1 - SHIFT)
    rest = (b.force_N - b.traction_N)[back].mean()
    rotating = b.rotating_mass_kg[0] * b.accel_mps2[back].mean()
    assert w["force_N"] == pytest.approx(rest + b.traction_N[now].mean() + rotating)
    assert w["speed_mps"] == b.speed_mps[end - SHIFT]
    assert w["begin_N"] == b.traction_N[end - TICKS]
    assert w["traction_N"] == b.traction_N[end]
    assert w["distance_m"] == pytest.approx(b.speed_mps[back].mean() * 0.2)
    assert w["roll_mps2"] == pytest.approx(9.80665 * 0.006)
    assert w["drag_N_per_mps"] == pytest.approx(2 * b.aero_N[back].mean() / b.speed_mps[back].mean())
    assert w["sensed_mps2"] == pytest.approx(b.accelerometer_mps2[back].mean())
    assert (w["open"], w["retarding"], w["stopped"], w["gap_s"]) == (1.0, 0.0, 0.0, 0.0)
    assert w["coarse"] == 0.0
    levers = replace(b, force_per_torque_1pm=np.full(len(b), 9.0))
    less = dict(zip(COLUMNS, Windows(lacking_Nm=30.0).push(levers)[0][:, 5], strict=True))
    for column in ("force_N", "begin_N", "traction_N"):
        assert less[column] == pytest.approx(w[column] - 30.0 * 9.0)


@OWN
def test_a_gap_counts_as_time_and_never_as_momentum(own):
    drive = trip(60)
    late = np.where(np.arange(3000) >= 1500, 45_000_000, 0)
    e = create(own, STATED).update(replace(drive.block, t_us=drive.block.t_us + late))
    # nobody knows what was loaded in three quarters of a minute
    times = 5 if own == "canest-0.1" else 3
    assert e.mass_std_kg[1520] > times * e.mass_std_kg[1490]
    assert abs(drive.error(e)[-1]) < 0.05


@pytest.mark.parametrize("by_us", [-30_000_000, 700_000])
def test_a_clock_that_jumps_in_the_first_block_is_seen_however_it_is_cut(by_us):
    b = trip(20).block
    gate, t_us = b.gate.copy(), b.t_us.copy()
    gate[300:420] = Gate.RECOVERY  # windows of which are coarse, but for those that begin anew
    t_us[330:] += by_us
    b = replace(b, gate=gate, t_us=t_us)
    whole, _ = Windows().push(b)
    cut = Windows()
    parts = [cut.push(b[k : k + 7])[0] for k in range(0, len(b), 7)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)
