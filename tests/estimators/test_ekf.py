"""The extended Kalman filter against a Kalman filter written as matrices, and the mass selection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import STEP_S, Status
from canest.estimators.registry import create

from .synthetic import FACTS, cut, drive, join, with_columns

G = 9.80665 * np.sqrt(1 + 0.006**2)


def kalman(block, theta, variance, q, r):
    """Textbook linear Kalman filter, Joseph form, x = [v, 1/m, s]."""
    x = np.array([block.speed_mps[0], *theta])
    p = np.diag([r, *variance])
    h = np.array([[1.0, 0.0, 0.0]])
    for k in range(1, len(block)):
        f = np.array([[1.0, STEP_S * block.force_N[k], -STEP_S * G], [0, 1, 0], [0, 0, 1]])
        x = f @ x
        p = f @ p @ f.T + np.diag(q)
        s = h @ p @ h.T + r
        gain = p @ h.T / s
        x = x + (gain * (block.speed_mps[k] - x[0])).ravel()
        joseph = np.eye(3) - gain @ h
        p = joseph @ p @ joseph.T + r * gain @ gain.T
    return x, p


def test_without_drag_the_filter_is_a_kalman_filter():
    d = drive(20.0, grade=0.02)
    block = with_columns(d.block, aero_N=np.zeros(len(d.block)))
    q, r, variance = (1e-5, 1e-14, 2e-7), 1e-3, (1e-11, 1e-2)
    facts = replace(FACTS, initial_mass_kg=18_000.0)
    method = create("ekf", facts, {"q": q, "r": r, "p0": variance})
    method.update(block)
    theta = (1 / 18_000.0, 0.006 / np.sqrt(1 + 0.006**2))
    x, p = kalman(block, theta, variance, q, r)
    np.testing.assert_allclose(method.state, x, rtol=1e-9)
    np.testing.assert_allclose(method.covariance[1:, 1:], p[1:, 1:], rtol=1e-8)


def test_drag_enters_the_jacobian_at_the_filters_own_speed():
    d = drive(20.0, grade=0.0)
    v = d.block.speed_mps
    block = with_columns(d.block, aero_N=4.0 * v * v)
    facts = replace(FACTS, initial_mass_kg=d.mass_kg, initial_grade=0.0)
    r = create("ekf", facts, {}).update(block)
    assert r.mass_kg[-1] == pytest.approx(d.mass_kg, rel=1e-3)


def test_uphill_is_positive():
    """2014, eq. 5b prints phi_2 without its minus sign: a climb would read as a descent."""
    r = create("ekf", FACTS, {}).update(drive(60.0, grade=0.04, pulse_s=2.0).block)
    assert r.grade[-1] == pytest.approx(0.04, abs=2e-3)


def test_noise_given_at_30_hz_keeps_its_density():
    block = drive(20.0, grade=0.02).block
    paper = create("ekf", FACTS, {"q": (0.1, 1e-5, 25.0), "r": 100.0, "rate_hz": 30.0}).update(block)
    same = create("ekf", FACTS, {"q": (0.06, 6e-6, 15.0), "r": 100.0 / 0.6, "rate_hz": 50.0}).update(block)
    np.testing.assert_allclose(paper.mass_kg, same.mass_kg, rtol=1e-9)
    np.testing.assert_allclose(paper.grade_std, same.grade_std, rtol=1e-9)


def test_a_gate_restarts_the_filter_at_the_measured_speed():
    d = drive(60.0, gaps=True, pulse_s=2.0)
    jump = np.where(np.arange(len(d.block)) > 640, 5.0, 0.0)
    block = with_columns(d.block, speed_mps=d.block.speed_mps + jump)
    with_jump = create("ekf", FACTS, {}).update(block)
    assert with_jump.mass_kg[-1] == pytest.approx(d.mass_kg, rel=0.02)


def test_selection_agrees_on_the_truth_after_excitation():
    d = drive(180.0, grade=0.01, noise_mps2=0.0, pulse_s=3.0)
    facts = replace(FACTS, initial_mass_kg=12_000.0)
    method = create("ekf-select", facts, {})
    r = method.update(d.block)
    assert r.mass_kg[-1] == pytest.approx(d.mass_kg, rel=0.04)
    assert r.status[-1] == Status.VALID


@pytest.mark.parametrize("edges", [[], [1000]])
def test_filters_go_on_starting_every_five_seconds_after_the_clock_was_set_back(edges):
    block = drive(60.0, noise_mps2=0.01).block
    back = block.t_us - 3_600_000_000 * (np.arange(len(block)) >= 1000)
    expected = create("ekf-select", FACTS, {}).update(block)
    method = create("ekf-select", FACTS, {})
    found = join([method.update(part) for part in cut(with_columns(block, t_us=back), edges)])
    # the step back itself takes no time, so that filters start a tick later
    assert found["mass_kg"] == pytest.approx(expected.mass_kg, rel=1e-2)
    assert method.running == method.options.filters


def test_selection_is_not_valid_on_copies_of_one_estimate():
    """Filters that have seen a constant force only agree because they started from each other."""
    d = drive(60.0, pulse_s=1000.0)
    facts = replace(FACTS, initial_mass_kg=12_000.0)
    method = create("ekf-select", facts, {})
    r = method.update(d.block)
    assert not (r.status == Status.VALID).any()
