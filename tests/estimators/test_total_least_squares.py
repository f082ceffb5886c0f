"""TLS, GTLS and their recursive forms against numpy's SVD and against Monte Carlo covariances."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from canest.core.errors import ConfigError
from canest.estimators.base import create
from canest.estimators.papers.rhode2013.rsvd import Rsvd
from canest.estimators.papers.rhode2013.tls_math import (
    NoiseScale,
    covariance,
    solve,
)

from .synthetic import FACTS, drive

PAPERS = Path(__file__).parents[2] / "benchmarks" / "papers"
correction = runpy.run_path(str(PAPERS / "closed_forms.py"))["correction"]

TRUTH = np.array([3.0, 12.0, 8.0])
#: the printed noise covariance of the 2013 paper, eq. 8
W = np.array(
    [
        [6.4210, 0.0286, -0.2366, 0.0718],
        [0.0286, 2.5874, -0.0367, -0.0124],
        [-0.2366, -0.0367, 16.1123, -0.1608],
        [0.0718, -0.0124, -0.1608, 10.6422],
    ]
)


def solve_generalized(a: np.ndarray, b: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """GTLS (2013, Alg. 2; W diagonal: WTLS): return X (n,) and cov(X) (n, n), both in original units."""
    scale = NoiseScale.of(noise)
    z = scale.rows(np.column_stack((a, b)))
    x, cov = solve(z[:, :-1], z[:, -1])
    return scale.back(x), scale.covariance_back(cov)


def data(m=400, noise=None, seed=1):
    rng = np.random.default_rng(seed)
    a = rng.uniform(-20, 20, (m, 3))
    z = np.column_stack((a, a @ TRUTH))
    if noise is not None:
        z = z + rng.multivariate_normal(np.zeros(4), noise, m)
    return z


def weighted_svd(z, forgetting):
    w = np.sqrt(forgetting ** np.arange(len(z) - 1, -1, -1))
    v = np.linalg.svd(z * w[:, None], full_matrices=False)[2][-1]
    return -v[:-1] / v[-1]


@pytest.mark.parametrize("forgetting", [1.0, 0.98, 0.997**2])
def test_rtls_equals_weighted_svd(forgetting):
    z = data(noise=np.eye(4))
    x, smallest, gram, weight = Rsvd(3, forgetting).add(z)
    for k in (10, 57, 400):
        np.testing.assert_allclose(x[k - 1], weighted_svd(z[:k], forgetting), rtol=1e-9)
    w = forgetting ** np.arange(399, -1, -1)
    np.testing.assert_allclose(weight[-1], w.sum(), rtol=1e-12)
    np.testing.assert_allclose(gram[-1], (z[:, :3] * w[:, None]).T @ z[:, :3], rtol=1e-12)
    s = np.linalg.svd(z * np.sqrt(w)[:, None], compute_uv=False)
    np.testing.assert_allclose(smallest[-1], s[-1], rtol=1e-9)


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
def test_rgtls_equals_weighted_svd_of_scaled_data(forgetting):
    z = data(noise=W)
    scale = NoiseScale.of(W)
    x = scale.back(Rsvd(3, forgetting).add(scale.rows(z))[0])
    expected_rows = z @ np.linalg.inv(np.linalg.cholesky(W).T)
    for k in (10, 400):
        transformed = weighted_svd(expected_rows[:k], forgetting)
        c = np.linalg.inv(np.linalg.cholesky(W).T)
        expected = (c[:3, :3] @ transformed - c[:3, 3]) / c[3, 3]
        np.testing.assert_allclose(x[k - 1], expected, rtol=1e-9)


def test_after_hours_the_factorization_still_equals_the_batch():
    z = np.tile(data(500, noise=np.eye(4)), (40, 1))
    x = Rsvd(3, 0.999).add(z)[0]
    np.testing.assert_allclose(x[-1], weighted_svd(z, 0.999), rtol=1e-9)


def test_noise_free_data_gives_the_truth():
    z = data(50)
    np.testing.assert_allclose(solve(z[:, :3], z[:, 3])[0], TRUTH, rtol=1e-12)
    np.testing.assert_allclose(Rsvd(3, 1.0).add(z)[0][-1], TRUTH, rtol=1e-9)


def test_true_noise_covariance_removes_the_bias_of_least_squares():
    z = data(60_000, noise=W)
    ls = np.linalg.lstsq(z[:, :3], z[:, 3], rcond=None)[0]
    gtls, _ = solve_generalized(z[:, :3], z[:, 3], W)
    assert abs(ls[2] - 8.0) > 0.5
    np.testing.assert_allclose(gtls, TRUTH, atol=0.1)


def test_output_noise_only_makes_gtls_least_squares():
    z = data(500, noise=W)
    tiny = np.diag([1e-5, 1e-5, 1e-5, 1e5])
    x, _ = solve_generalized(z[:, :3], z[:, 3], tiny)
    np.testing.assert_allclose(x, np.linalg.lstsq(z[:, :3], z[:, 3], rcond=None)[0], rtol=1e-6)


def test_covariance_with_the_square_of_the_singular_value_matches_monte_carlo():
    """2013, Alg. 1 line 6 prints sigma^2 ~ S/m; the scatter of repeated fits says S^2/m."""
    noise = 4.0 * np.eye(4)
    fits, stated, printed = [], [], []
    for seed in range(200):
        z = data(300, noise, seed)
        x, cov = solve(z[:, :3], z[:, 3])
        s = np.linalg.svd(z, compute_uv=False)[-1]
        fits.append(x)
        stated.append(np.diag(cov))
        printed.append(np.diag(cov) * (s / 300) / (s**2 / 300))
    scatter = np.var(fits, axis=0)
    assert np.all(np.abs(np.mean(stated, axis=0) / scatter - 1.0) < 0.35)
    assert np.all(np.mean(printed, axis=0) / scatter < 0.2)


def test_generalized_covariance_is_carried_back_to_the_original_space():
    """2013, Alg. 2 returns the covariance of X'; the scatter is that of X."""
    fits, stated = [], []
    noise = W * np.array([1, 1, 0.1, 1])[:, None] * np.array([1, 1, 0.1, 1])
    for seed in range(200):
        z = data(300, noise, seed)
        x, cov = solve_generalized(z[:, :3], z[:, 3], noise)
        fits.append(x)
        stated.append(np.diag(cov))
    ratio = np.mean(stated, axis=0) / np.var(fits, axis=0)
    assert np.all(np.abs(ratio - 1.0) < 0.35)


def test_with_forgetting_the_sum_of_weights_stands_for_m():
    """2013, Alg. 4 line 7 divides by t; sigma^2 of a stationary signal must not shrink as t grows."""
    z = data(4000, noise=np.eye(4))
    _, smallest, _, weight = Rsvd(3, 0.99).add(z)
    variance = smallest**2 / weight
    assert variance[-1] == pytest.approx(1.0, rel=0.35)
    assert smallest[-1] ** 2 / 4000 < 0.1


def test_forgetting_of_rtls_is_that_of_rls():
    """The paper's lambda scales rows, RLS' lambda squares: the same number means the same memory here."""
    z = data(300, noise=np.diag([1e-12, 1e-12, 1e-12, 1.0]))
    scale = NoiseScale.of(np.diag([1e-10, 1e-10, 1e-10, 1.0]))
    x = scale.back(Rsvd(3, 0.97).add(scale.rows(z))[0])[-1]
    w = np.sqrt(0.97 ** np.arange(299, -1, -1))[:, None]
    np.testing.assert_allclose(x, np.linalg.lstsq(z[:, :3] * w, z[:, 3] * w[:, 0], rcond=None)[0], rtol=1e-6)


def test_correction_without_u_is_the_exact_one():
    """2013: eq. 6 equals eq. 5."""
    z = data(40, noise=np.eye(4))
    u, s, vt = np.linalg.svd(z)
    exact = s[3] * np.outer(u[:, 3], vt[3])
    np.testing.assert_allclose(correction(z[:, :3], z[:, 3]), exact, atol=1e-12)


def test_indefinite_covariance_is_infinite_not_negative():
    x = np.array([1.0, 2.0])
    cov = covariance(x, np.eye(2), np.array(100.0), np.array(10.0))
    assert np.isinf(cov).all()


@pytest.mark.parametrize("noise", [np.zeros((3, 3)), np.ones((3, 3)), np.array([[1.0, 2.0], [0.0, 1.0]])])
def test_an_impossible_noise_covariance_is_refused(noise):
    with pytest.raises(ConfigError, match="positive definite"):
        NoiseScale.of(noise)


@pytest.mark.parametrize("name", ["tls", "gtls", "rtls", "rgtls"])
def test_constant_grade_gives_the_truth(name):
    d = drive(60.0, grade=-0.03, noise_mps2=1e-4, pulse_s=1.0)
    r = create(name, FACTS, {}).update(d.block)
    assert r.mass_kg[-1] == pytest.approx(d.mass_kg, rel=5e-3)
    assert r.grade[-1] == pytest.approx(-0.03, abs=3e-4)


def test_batch_tls_equals_svd_of_all_rows():
    from dataclasses import replace

    d = drive(20.0, grade=0.01, noise_mps2=0.01, pulse_s=1.0)
    facts = replace(FACTS, initial_mass_kg=20_000.0)
    r = create("gtls", facts, {"p0": (1.0, 1e6)}).update(d.block)
    from canest.estimators.papers.rhode2013.tls import GeneralizedOptions, noise_covariance

    phi2 = np.full(len(d.block), -9.80665 * np.sqrt(1 + 0.006**2))
    x, _ = solve_generalized(
        np.column_stack((d.block.force_N, phi2)),
        d.block.accel_mps2,
        noise_covariance("gtls", GeneralizedOptions()),
    )
    assert r.mass_kg[-1] == pytest.approx(1 / x[0], rel=1e-6)
