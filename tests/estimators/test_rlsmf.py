"""RLSMF of both papers, to the letter: the kernels against the printed equations as matrices."""

from __future__ import annotations

import numpy as np
import pytest

from canest.estimators.papers.rhode2013.multiple_forgetting import MultipleForgetting
from canest.estimators.papers.two_parameter import Known, Limits
from canest.estimators.papers.vahidi2005.rlsmf import Forgetting, forget_each
from canest.estimators.registry import create

from .synthetic import FACTS, drive

FREE = Limits(-1e9, 1e9, -1e9, 1e9, np.inf, np.inf)
ONE, TWO = 0.95, 0.4


def rows(n=200):
    rng = np.random.default_rng(5)
    return rng.normal(0.5, 1.0, n), rng.normal(-1.0, 0.1, n), rng.standard_normal(n)


def by_equations_19_to_21(phi1, phi2, y, theta, p1, p2):
    """Solve the two coupled updates (19), (20) with the matrix of (21); covariances by their own gains."""
    for a, b, c in zip(phi1, phi2, y, strict=True):
        l1 = p1 * a / (ONE + a * p1 * a)
        l2 = p2 * b / (TWO + b * p2 * b)
        matrix = np.array([[1.0, l1 * b], [l2 * a, 1.0]])
        right = [theta[0] + l1 * (c - a * theta[0]), theta[1] + l2 * (c - b * theta[1])]
        theta = np.linalg.solve(matrix, right)
        p1, p2 = (1 - l1 * a) * p1 / ONE, (1 - l2 * b) * p2 / TWO
    return theta, p1, p2


def by_algorithm_7(a, b, x, p, factors):
    """2013, Alg. 7, with a matrix P; n parameters."""
    p = np.diag(p)
    for row, out in zip(a, b, strict=True):
        gain = (p @ row) / factors / (1 + np.sum(p @ row**2 / factors))
        x = x + gain * (out - row @ x)
        p = np.diag(np.diag((np.eye(len(x)) - np.outer(gain, row)) @ p) / factors)
    return x, np.diag(p)


def run(phi1, phi2, y, p=(4.0, 9.0), joint=False):
    state = [0.3, -0.2, p[0] / ONE, p[1] / TWO, 1.0]
    columns = [c.tolist() for c in (y, phi1, phi2)]
    forgetting = Forgetting(joint, 1 / ONE, 1 / TWO)
    forget_each.interpreted(*columns, forgetting, FREE, 0.002, state, Known.empty(len(y)))
    return np.array(state)


def test_2005_kernel_solves_equations_19_to_21():
    phi1, phi2, y = rows()
    theta, p1, p2 = by_equations_19_to_21(phi1, phi2, y, np.array([0.3, -0.2]), 4.0, 9.0)
    state = run(phi1, phi2, y)
    np.testing.assert_allclose(state[:2], theta, rtol=1e-9)
    np.testing.assert_allclose(state[2:4], [p1 / ONE, p2 / TWO], rtol=1e-9)


def test_2013_kernels_are_algorithm_7():
    phi1, phi2, y = rows()
    a, factors = np.column_stack((phi1, phi2)), np.array([ONE, TWO])
    x, p = by_algorithm_7(a, y, np.array([0.3, -0.2]), np.array([4.0, 9.0]), factors)
    state = run(phi1, phi2, y, joint=True)
    np.testing.assert_allclose(state[:2], x, rtol=1e-9)
    np.testing.assert_allclose(state[2:4], p / factors, rtol=1e-9)
    wide = np.full(2, 1e9)
    learner = MultipleForgetting(
        np.array([0.3, -0.2]), np.array([4.0, 9.0]), factors, -wide, wide, np.full(2, np.inf), 1.0
    )
    out, _ = learner.add(a, y)
    np.testing.assert_allclose(out[-1], x, rtol=1e-9)


def test_four_parameters_are_algorithm_7():
    rng = np.random.default_rng(2)
    a = rng.normal(0.0, 1.0, (300, 4))
    b = a @ np.array([1.0, -2.0, 0.5, 3.0]) + 0.1 * rng.standard_normal(300)
    factors = np.array([0.99, 1.0, 0.95, 0.9])
    x, _ = by_algorithm_7(a, b, np.zeros(4), np.full(4, 10.0), factors)
    wide = np.full(4, 1e9)
    learner = MultipleForgetting(np.zeros(4), np.full(4, 10.0), factors, -wide, wide, np.full(4, np.inf), 1.0)
    out, _ = learner.add(a, b)
    np.testing.assert_allclose(out[-1], x, rtol=1e-9)


def test_the_two_papers_differ():
    phi1, phi2, y = rows()
    own, joint = run(phi1, phi2, y), run(phi1, phi2, y, joint=True)
    assert not np.allclose(own[2:4], joint[2:4], rtol=0.05)


def test_equation_15_needs_its_regressor():
    """The minimum of the loss (13) over theta_1 is the corrected eq. 15, not the printed one."""
    phi1, phi2, y = rows(60)
    weights = ONE ** np.arange(59, -1, -1)
    theta2 = -0.4
    corrected = np.sum(weights * phi1 * (y - phi2 * theta2)) / np.sum(weights * phi1**2)
    printed = np.sum(weights * (y - phi2 * theta2)) / np.sum(weights * phi1**2)
    best = np.linalg.lstsq(
        (np.sqrt(weights) * phi1)[:, None], np.sqrt(weights) * (y - phi2 * theta2), rcond=None
    )[0][0]
    assert corrected == pytest.approx(best, rel=1e-12)
    assert abs(printed - best) > 0.01


def test_batch_start_is_least_squares_on_the_first_four_seconds():
    d = drive(10.0, noise_mps2=0.01, grade=0.01, pulse_s=1.0)
    r = create("rlsmf", FACTS, {"start": "batch"}).update(d.block)
    a = np.column_stack((d.block.force_N, np.full(len(d.block), -9.80665 * np.sqrt(1 + 0.006**2))))
    theta = np.linalg.lstsq(a[:200], d.block.accel_mps2[:200], rcond=None)[0]
    assert np.isnan(r.mass_kg[:199]).all()
    assert r.mass_kg[199] == pytest.approx(1 / theta[0], rel=1e-3)


def test_a_batch_without_excitation_starts_wide_and_inside_the_bounds():
    d = drive(10.0, pulse_s=60.0)
    r = create("rlsmf", FACTS, {"start": "batch"}).update(d.block)
    assert 7_000 <= r.mass_kg[199] <= 40_000
    assert r.mass_std_kg[199] > 0.0


def test_a_given_mass_starts_at_once():
    from dataclasses import replace

    r = create("rlsmf", replace(FACTS, initial_mass_kg=21_250.0), {}).update(drive(1.0).block)
    assert np.isfinite(r.mass_kg).all()
    assert r.mass_kg[0] == pytest.approx(21_250.0, rel=0.05)


def test_truth_is_a_fixed_point_from_a_right_start():
    from dataclasses import replace

    d = drive(60.0, grade=0.02)
    facts = replace(FACTS, initial_mass_kg=d.mass_kg, initial_grade=0.02)
    for preset in ("2005-simulation", "2005-experiment", "2014"):
        r = create("rlsmf", facts, {"preset": preset}).update(d.block)
        np.testing.assert_allclose(r.mass_kg, d.mass_kg, rtol=1e-9)
        np.testing.assert_allclose(r.grade, 0.02, atol=1e-9)


def test_grade_steps_do_not_throw_the_mass_off_as_with_one_factor():
    d = drive(120.0, grade=lambda t: np.where((t // 20) % 2 == 0, 0.0, 0.03))
    multiple = create("rlsmf", FACTS, {"preset": "2005-simulation"}).update(d.block)
    single = create("rls", FACTS, {"preset": "2005-figure-3"}).update(d.block)
    after = slice(1000, None)
    rms = [np.sqrt(np.mean((r.mass_kg[after] / d.mass_kg - 1) ** 2)) for r in (multiple, single)]
    assert rms[0] < rms[1]


def test_projection_keeps_the_estimate_at_the_bound():
    d = drive(40.0, mass_kg=60_000.0, noise_mps2=0.01, pulse_s=2.0)
    r = create("rlsmf", FACTS, {"preset": "2014"}).update(d.block)
    assert np.nanmax(r.mass_kg) == FACTS.mass_max_kg
    assert r.mass_kg[-1] > 0.98 * FACTS.mass_max_kg


def test_integrated_regression_gives_the_mean_grade_of_its_window():
    d = drive(60.0, grade=0.025, gaps=True)
    r = create("rlsmf", FACTS, {"regression": "integrated", "start": "batch"}).update(d.block)
    assert r.grade[-1] == pytest.approx(0.025, abs=1e-3)


def test_integrated_window_restarts_after_every_gate():
    from canest.estimators.regression import Integrator

    d = drive(60.0, gaps=True)
    rows = Integrator(1.0)(d.block)
    gated = d.block.gate != 0
    assert not gated[rows.at].any()
    # the first row after a gate spans one tick only, and the speed gained while gated is in no row
    first = rows.at[np.flatnonzero(np.diff(rows.at) > 1) + 1]
    position = np.searchsorted(rows.at, first)
    np.testing.assert_allclose(rows.y[position] * 1.0, np.diff(d.block.speed_mps)[first - 1], rtol=1e-9)
