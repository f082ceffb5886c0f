"""RLS, vector-type forgetting and batch least squares against independent oracles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import padasip as pa
import pytest

from canest.core import jit
from canest.core.samples import Status
from canest.estimators.papers.two_parameter import Known, Limits
from canest.estimators.papers.vahidi2005.rls import Scale, matrix_rls
from canest.estimators.registry import create

from .synthetic import FACTS, drive, with_columns

FREE = Limits(-1e9, 1e9, -1e9, 1e9, np.inf, np.inf)


def rows(n=400, seed=3):
    rng = np.random.default_rng(seed)
    phi1 = rng.normal(0.5, 1.0, n)
    phi2 = rng.normal(-1.0, 0.3, n)
    return phi1, phi2, 2.0 * phi1 - 0.7 * phi2 + 0.1 * rng.standard_normal(n)


def run(scale, start=(0.3, -0.2), p=(4.0, 0.5, 9.0), n=400):
    phi1, phi2, y = rows(n)
    state = [*start, *p, 1.0]
    known = Known.empty(n)
    columns = (y.tolist(), phi1.tolist(), phi2.tolist())
    matrix_rls.interpreted(*columns, Scale(*scale), FREE, 0.002, state, known)
    return known.columns(), np.array(state)


def weighted_batch(k, forgetting, start=(0.3, -0.2), p=(4.0, 0.5, 9.0)):
    """lstsq on the first k rows with weights lambda^(k-i), the prior as two rows that fade alike."""
    phi1, phi2, y = rows()
    root = np.linalg.cholesky(np.linalg.inv(np.array([[p[0], p[1]], [p[1], p[2]]]))).T
    a = np.vstack((root, np.column_stack((phi1[:k], phi2[:k]))))
    b = np.concatenate((root @ np.array(start), y[:k]))
    w = np.sqrt(forgetting ** np.concatenate(([k, k], np.arange(k - 1, -1, -1))))
    return np.linalg.lstsq(a * w[:, None], b * w, rcond=None)[0]


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
def test_rls_equals_weighted_batch(forgetting):
    out, _ = run((1 / forgetting,) * 3, p=tuple(v / forgetting for v in (4.0, 0.5, 9.0)))
    for k in (1, 2, 17, 100, 400):
        # the state holds P already discounted once, so the prior's weight is lambda^k
        expected = weighted_batch(k, forgetting)
        np.testing.assert_allclose(out[:2, k - 1], expected, rtol=1e-9)


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
def test_rls_covariance_is_that_of_the_weighted_normal_matrix(forgetting):
    phi1, phi2, _ = rows()
    n = len(phi1)
    _, state = run((1 / forgetting,) * 3)
    a = np.column_stack((phi1, phi2))
    w = forgetting ** np.arange(n - 1, -1, -1)
    normal = (a * w[:, None]).T @ a + forgetting ** (n - 1) * np.linalg.inv([[4.0, 0.5], [0.5, 9.0]])
    p = np.linalg.inv(normal) / forgetting
    np.testing.assert_allclose(state[2:5], [p[0, 0], p[0, 1], p[1, 1]], rtol=1e-9)


def test_rls_equals_padasip():
    phi1, phi2, y = rows()
    peer = pa.filters.FilterRLS(n=2, mu=0.97, eps=0.25, w=np.zeros(2))
    peer.run(y, np.column_stack((phi1, phi2)))
    # padasip starts from R = I / eps and keeps P undiscounted until the next row
    out, _ = run((1 / 0.97,) * 3, start=(0.0, 0.0), p=(4.0 / 0.97, 0.0, 4.0 / 0.97))
    np.testing.assert_allclose(out[:2, -1], peer.w, rtol=1e-9)


def test_equal_vector_factors_are_one_factor_squared():
    vector, _ = run((1 / 0.99**2,) * 3)
    plain, _ = run((1 / 0.9801,) * 3)
    np.testing.assert_allclose(vector, plain, rtol=1e-9)


def test_vector_forgetting_is_equation_12_in_matrices():
    phi1, phi2, y = rows(50)
    one, two = 0.999, 0.9
    theta, p = np.array([0.3, -0.2]), np.array([[4.0, 0.5], [0.5, 9.0]])
    inverse = np.diag([1 / one, 1 / two])
    for a, b, c in zip(phi1, phi2, y, strict=True):
        phi = np.array([a, b])
        gain = p @ phi / (1 + phi @ p @ phi)
        theta = theta + gain * (c - phi @ theta)
        p = inverse @ (np.eye(2) - np.outer(gain, phi)) @ p @ inverse
    phi = rows(50)
    state = [0.3, -0.2, 4.0, 0.5, 9.0, 1.0]
    columns = [c.tolist() for c in (phi[2], phi[0], phi[1])]
    scale = Scale(1 / one**2, 1 / (one * two), 1 / two**2)
    matrix_rls.interpreted(*columns, scale, FREE, 0.002, state, Known.empty(50))
    np.testing.assert_allclose(state[:2], theta, rtol=1e-9)
    np.testing.assert_allclose(state[2:5], [p[0, 0], p[0, 1], p[1, 1]], rtol=1e-9)


def test_batch_equals_lstsq_after_every_row():
    d = drive(30.0, noise_mps2=0.002, grade=0.02, pulse_s=1.0)
    method = create("batch-ls", FACTS, {"start": "batch"})
    r = method.update(d.block)
    a = np.column_stack((d.block.force_N, np.full(len(d.block), -9.80665 * np.sqrt(1 + 0.006**2))))
    for k in (300, 700, 1500):
        theta = np.linalg.lstsq(a[:k], d.block.accel_mps2[:k], rcond=None)[0]
        assert r.mass_kg[k - 1] == pytest.approx(1 / theta[0], rel=2e-4)  # the bounds join as weak prior rows


@pytest.mark.parametrize("name", ["batch-ls", "tls", "gtls"])
@pytest.mark.parametrize("noise_mps2", [0.02, 0.005, 0.0])
def test_a_constant_force_leaves_the_variance_of_the_bounds_however_quiet_the_data(name, noise_mps2):
    d = drive(60.0)
    n = len(d.block)
    accel = noise_mps2 * np.random.default_rng(0).standard_normal(n)
    cruise = with_columns(d.block, force_N=np.full(n, 1250.0), accel_mps2=accel)
    r = create(name, FACTS).update(cruise)
    spread = np.array([1 / FACTS.mass_min_kg - 1 / FACTS.mass_max_kg, FACTS.mass_max_kg - FACTS.mass_min_kg])
    of_inverse, of_mass = spread / np.sqrt(12)
    mass, std = (column[~np.isnan(r.mass_kg)] for column in (r.mass_kg, r.mass_std_kg))
    assert (std > 0.9 * np.minimum(of_inverse * mass**2, of_mass)).all()
    assert not (r.status == Status.VALID).any()


def test_the_variance_of_batch_least_squares_is_that_of_repeated_drives():
    """Prior and data both scatter, each as it says; a drive of little excitation has some of both."""
    rng = np.random.default_rng(4)
    d = drive(20.0, pulse_s=2.0)
    force = 1250.0 + 0.02 * (d.block.force_N - d.block.force_N.mean())
    errors, stated = [], []
    for _ in range(60):
        mass = 21_250.0 + 1_000.0 * rng.standard_normal()
        accel = (force - 1250.0) / mass + 0.01 * rng.standard_normal(len(force))
        method = create("batch-ls", replace(FACTS, initial_mass_kg=21_250.0))
        method.restore(21_250.0, 1_000.0)
        r = method.update(with_columns(d.block, force_N=force, accel_mps2=accel))
        errors.append(r.mass_kg[-1] - mass)
        stated.append(r.mass_std_kg[-1])
    assert np.mean(stated) == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.3)


@pytest.mark.parametrize(("name", "within"), [("rls", 2e-3), ("rls-vector", 2e-2), ("batch-ls", 2e-3)])
def test_constant_grade_without_noise_gives_the_truth(name, within):
    d = drive(60.0, grade=-0.03, pulse_s=1.0)
    r = create(name, FACTS, {}).update(d.block)
    assert r.mass_kg[-1] == pytest.approx(d.mass_kg, rel=within)
    assert r.grade[-1] == pytest.approx(-0.03, abs=2e-4)


def test_wind_up_is_bounded_in_days_without_excitation():
    n = 200_000
    state = [4.7e-5, 0.0, 1e-6, 0.0, 10.0, 1e-3]
    limits = Limits(2.5e-5, 1.4e-4, -0.3, 0.3, 1e-3, 1e3)
    columns = ([0.0] * n, [0.0] * n, [-9.8] * n)
    matrix_rls.interpreted(*columns, Scale(*[1 / 0.9] * 3), limits, 0.002, state, Known.empty(n))
    assert np.isfinite(state).all()
    assert state[2] <= 1e-3
    assert not jit.enabled()
