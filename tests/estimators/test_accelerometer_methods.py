"""PMG, the kinematic grade, the four-parameter model and the grade observer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.gates import Gate
from canest.core.samples import Status
from canest.estimators.registry import create

from .synthetic import FACTS, drive, with_columns


def test_pmg_finds_mass_whatever_its_start():
    d = drive(120.0, grade=lambda t: 0.03 * np.sin(t / 20), noise_mps2=0.02)
    for start in (8_000.0, 21_250.0, 39_000.0):
        r = create("pmg", replace(FACTS, initial_mass_kg=start), {}).update(d.block)
        assert r.mass_kg[-1] == pytest.approx(d.mass_kg, rel=0.02)


def test_pmg_grade_goes_on_while_the_driveline_gates_are_closed():
    d = drive(60.0, grade=lambda t: np.where(t < 30, 0.0, 0.04))
    gate = np.where(np.arange(len(d.block)) > 1000, Gate.SHIFT, Gate.OPEN).astype(np.uint8)
    r = create("pmg", FACTS, {}).update(with_columns(d.block, gate=gate))
    assert r.grade[-1] == pytest.approx(0.04, abs=1e-3)
    assert r.mass_kg[-1] == r.mass_kg[1001]


def test_pmg_innovation_uses_the_mass_before_the_update():
    """2014, eq. 17 prints m_k on its own right-hand side: one step by hand with m_{k-1}."""
    from canest.estimators.papers.kidambi2014.pmg import MassFilter, learn_mass

    state = [10_000.0, 4.0, 0.0, 0.0, 0.01, 4e4, 10.0, 1.0]
    mass, variance = [0.0], [0.0]
    settings = MassFilter(forgetting=0.99, beta=0.0, low=1.0, high=1e6, top=1e9)
    learn_mass.interpreted([0.5], [9_000.0], settings, state, mass, variance)
    rho = 10.0 / np.sqrt(0.01 * 4e4)
    gain = 4.0 * 0.5 / (0.99 + 0.25 * 4.0)
    assert mass[0] == pytest.approx(10_000.0 + gain * rho * (9_000.0 - 5_000.0), rel=1e-12)


def test_pmg_ignores_rows_where_force_and_acceleration_do_not_go_together():
    d = drive(60.0)
    rng = np.random.default_rng(0)
    noise = with_columns(d.block, force_N=rng.normal(0.0, 5e3, len(d.block)))
    start = replace(FACTS, initial_mass_kg=20_000.0)
    moved = abs(create("pmg", start, {}).update(noise).mass_kg[-1] - 20_000.0)
    assert moved < 12_000.0


def test_bounce_is_weighted_down():
    d = drive(60.0, grade=0.02)
    shake = np.where((np.arange(len(d.block)) // 50) % 5 != 0, 0.0, 1.0)
    bias = shake * (0.5 + np.sin(np.arange(len(d.block)) * 1.0))
    shaken = with_columns(d.block, accelerometer_mps2=d.block.accelerometer_mps2 + bias)
    error = {}
    for calm in (0.005, 1.0):  # with 1.0 every sample weighs the same: the plain moving average
        r = create("pmg", FACTS, {"memory_s": 10.0, "calm": calm}).update(shaken)
        error[calm] = np.mean(np.abs(r.grade[-500:] - 0.02))
    assert error[0.005] < 0.6 * error[1.0]


def test_pitch_correction_removes_what_the_body_adds():
    d = drive(60.0)
    squat = 9.80665 * 0.01 * d.block.accel_mps2
    block = with_columns(d.block, accelerometer_mps2=d.block.accelerometer_mps2 + squat)
    corrected = create("pmg", replace(FACTS, pitch_rad_per_mps2=0.01), {}).update(block)
    neglected = create("pmg", FACTS, {}).update(block)
    assert np.abs(corrected.grade[500:]).max() < 1e-6
    assert np.abs(neglected.grade[500:]).max() > 1e-3
    assert corrected.mass_kg[-1] == pytest.approx(d.mass_kg, rel=2e-3)


def test_methods_without_their_signal_name_it():
    facts = replace(FACTS, has_accelerometer=False)
    d = drive(5.0)
    blind = with_columns(
        d.block, accelerometer_mps2=np.full(len(d.block), np.nan), slope=np.full(len(d.block), np.nan)
    )
    for name in ("pmg", "resistance4"):
        method = create(name, facts, {})
        r = method.update(blind)
        assert "accelerometer" in method.missing()
        assert (r.status == Status.UNESTIMATED).all()


@pytest.mark.parametrize("source", ["slope", "accelerometer"])
def test_four_parameters_from_either_grade_signal(source):
    d = drive(400.0, grade=lambda t: 0.04 * np.sin(t / 15), pulse_s=3.0)
    columns = {"slope": np.full(len(d.block), np.nan)} if source == "accelerometer" else {}
    method = create("resistance4", FACTS, {})
    r = method.update(with_columns(d.block, **columns))
    assert r.mass_kg[-1] == pytest.approx(d.mass_kg, rel=0.05)
    assert method.parameters is not None
    assert r.grade[-1] == pytest.approx(d.grade[-1], abs=0.02)


def test_four_parameters_are_recovered_one_by_one():
    rng = np.random.default_rng(4)
    d = drive(600.0, pulse_s=2.0)
    n = len(d.block)
    slope = 0.04 * np.sin(np.arange(n) / 300.0)
    v = 15.0 + 10.0 * np.sin(np.arange(n) / 900.0)
    a = 0.5 * np.sin(np.arange(n) / 40.0) + 0.2 * rng.standard_normal(n).cumsum() / np.sqrt(
        np.arange(1, n + 1)
    )
    cosine = 1 / np.sqrt(1 + slope**2)
    aero = 4.0 * v * v
    m, fr0, fr1, ratio = 20_000.0, 0.007, 5e-5, 1.2
    force = m * (9.80665 * cosine * (fr0 + fr1 * v) + a + 9.80665 * slope * cosine) + (ratio - 1.0) * aero
    block = with_columns(d.block, speed_mps=v, accel_mps2=a, slope=slope, aero_N=aero, force_N=force)
    method = create("resistance4", FACTS, {})
    method.update(block)
    x, std = method.parameters
    assert x[1] == pytest.approx(m, rel=0.01)
    assert x[0] + x[2] * 15.0 == pytest.approx(m * (fr0 + fr1 * 15.0), rel=0.15)
    assert x[3] == pytest.approx(ratio, rel=0.1)
    assert np.isfinite(std).all()


def test_observer_follows_a_grade_with_the_right_mass():
    facts = replace(FACTS, initial_mass_kg=21_250.0)
    d = drive(60.0, grade=lambda t: np.clip((t - 20) * 0.005, 0.0, 0.05))
    r = create("dgo", facts, {}).update(d.block)
    np.testing.assert_allclose(r.grade[2500:], 0.05, atol=2e-3)


def test_observer_error_decays_with_the_corrected_signs():
    """Eq. 13 as printed adds k2 sgn(e), which feeds an error; from a wrong grade it must vanish."""
    facts = replace(FACTS, initial_mass_kg=21_250.0, initial_grade=-0.1)
    r = create("dgo", facts, {"k2": 0.2}).update(drive(20.0).block)
    assert abs(r.grade[-1]) < 1e-3


def test_observer_keeps_its_mass_and_never_converges():
    method = create("dgo", replace(FACTS, initial_mass_kg=30_000.0), {})
    r = method.update(drive(20.0).block)
    assert not method.estimates_mass
    assert (r.mass_kg == 30_000.0).all()
    # a mass that is far off shows in the grade, within what the standard deviation admits
    wide = create("dgo", FACTS, {}).update(drive(60.0, mass_kg=15_000.0, pulse_s=2.0).block)
    assert np.mean(np.abs(wide.grade[500:])) < 3 * np.mean(wide.grade_std[500:])
