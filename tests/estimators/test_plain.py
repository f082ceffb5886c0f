"""The plain estimators against numpy, scipy, padasip and the kernels of the full estimators."""

from __future__ import annotations

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import padasip as pa
import pytest
import scipy.linalg

import canest.estimators
from canest.core import jit
from canest.core.errors import UsageError
from canest.estimators import EKF, GTLS, RGTLS, RLS, RLSMF, RTLS, TLS, BatchLS, VectorRLS
from canest.estimators.papers.two_parameter import Known, Limits
from canest.estimators.papers.vahidi2005.rls import Scale, matrix_rls
from canest.estimators.papers.vahidi2005.rlsmf import Forgetting, forget_each

TRUE = np.array([2.0, -0.7, 0.3])
FREE = Limits(-1e9, 1e9, -1e9, 1e9, np.inf, np.inf)
W = np.array([[0.04, 0.0, 0.0, 0.01], [0.0, 0.09, 0.0, 0.0], [0.0, 0.0, 0.01, 0.0], [0.01, 0.0, 0.0, 0.02]])
FACTORIES = [
    BatchLS,
    lambda: RLS(0.98),
    lambda: VectorRLS(0.99),
    lambda: RLSMF(0.98),
    lambda: RLSMF(0.98, gain="joint"),
    TLS,
    lambda: GTLS(W),
    lambda: RTLS(0.99),
    lambda: RGTLS(W, 0.99),
    lambda: EKF(Q=1e-6, R=0.01),
]
NAMES = ["BatchLS", "RLS", "VectorRLS", "RLSMF", "RLSMF-joint", "TLS", "GTLS", "RTLS", "RGTLS", "EKF"]
each = pytest.mark.parametrize("make", FACTORIES, ids=NAMES)


def rows(n=300, k=3, noise=0.05, seed=5):
    rng = np.random.default_rng(seed)
    phi = rng.normal(0.5, 1.0, (n, k))
    return phi @ TRUE[:k] + noise * rng.standard_normal(n), phi


@each
def test_theta_nears_the_truth_and_takes_its_size_from_phi(make):
    y, phi = rows()
    method = make()
    assert method.theta.shape == (0,)
    assert method.P.shape == (0, 0)
    found = method.update(y, phi)
    assert found.shape == phi.shape
    np.testing.assert_array_equal(found[-1], method.theta)
    np.testing.assert_allclose(method.theta, TRUE, atol=0.05)
    np.testing.assert_allclose(method.P, method.P.T, rtol=1e-9)
    assert (np.diag(method.P) > 0.0).all()


@each
def test_one_row_at_a_time_is_a_block(make):
    y, phi = rows(60)
    one, block = make(), make()
    whole = block.update(y, phi)
    single = [one.update(float(a), b) for a, b in zip(y, phi, strict=True)]
    np.testing.assert_array_equal(np.array(single), whole)
    np.testing.assert_array_equal(one.P, block.P)
    parts = make()
    np.testing.assert_array_equal(
        np.concatenate([parts.update(y[a:b], phi[a:b]) for a, b in ((0, 7), (7, 8), (8, 60))]), whole
    )


@each
@pytest.mark.skipif(not jit.available(), reason="numba is an extra")
def test_compiled_gives_the_same_bits(make):
    y, phi = rows(50)
    expected = make().update(y, phi)
    jit.enable(True)
    try:
        found = make().update(y, phi)
    finally:
        jit.enable(False)
    np.testing.assert_array_equal(found, expected)


@each
def test_an_empty_block_teaches_nothing(make):
    y, phi = rows(20)
    method = make()
    method.update(y, phi)
    before = method.theta
    assert method.update(y[:0], phi[:0]).shape == (0, 3)
    np.testing.assert_array_equal(method.theta, before)


@each
def test_the_reported_estimate_is_a_copy_of_the_state(make):
    y, phi = rows(20)
    method = make()
    method.update(y, phi)
    before, p = method.theta, method.P
    method.theta[:] = 9.0
    method.P[:] = 9.0
    np.testing.assert_array_equal(method.theta, before)
    np.testing.assert_array_equal(method.P, p)


def test_one_parameter_may_be_a_column_of_numbers():
    phi = np.arange(1.0, 6.0)
    assert RLS().update(3.0 * phi, phi).shape == (5, 1)
    assert RLS().update(3.0, 1.0).shape == (1,)


@pytest.mark.parametrize("forgetting", [1.0, 0.97])
def test_rls_is_weighted_least_squares_with_the_start_as_rows(forgetting):
    y, phi = rows(120)
    rls = RLS(forgetting, theta0=[1.0, 1.0, 1.0], P0=25.0)
    rls.update(y, phi)
    n = len(y)
    w = forgetting ** np.concatenate(([n] * 3, np.arange(n - 1, -1, -1)))
    a, b = np.vstack((np.eye(3) / 5.0, phi)), np.concatenate((np.ones(3) / 5.0, y))
    root = np.sqrt(w)
    np.testing.assert_allclose(
        rls.theta, np.linalg.lstsq(a * root[:, None], b * root, rcond=None)[0], rtol=1e-9
    )
    np.testing.assert_allclose(rls.P, np.linalg.inv((a * w[:, None]).T @ a), rtol=1e-8)


def test_rls_is_padasips():
    y, phi = rows(120)
    peer = pa.filters.FilterRLS(n=3, mu=0.97, eps=1e-4, w=np.zeros(3))
    peer.run(y, phi)
    rls = RLS(0.97)  # 1e4 times the identity, as eps says
    rls.update(y, phi)
    np.testing.assert_allclose(rls.theta, peer.w, rtol=1e-9)


@pytest.mark.parametrize("kind", ["rls", "vector", "own", "joint"])
def test_two_parameters_are_the_full_estimators_kernels(kind):
    y, phi = rows(200, 2)
    columns = [y.tolist(), phi[:, 0].tolist(), phi[:, 1].tolist()]
    known = Known.empty(len(y))
    if kind in ("rls", "vector"):
        one, two = 0.99, 0.95 if kind == "vector" else 0.99
        plain = VectorRLS([one, two], P0=4.0) if kind == "vector" else RLS(0.99, P0=4.0)
        scale = Scale(1 / one**2, 1 / (one * two), 1 / two**2) if kind == "vector" else Scale(*[1 / 0.99] * 3)
        first = 4.0 if kind == "vector" else 4.0 / 0.99
        matrix_rls.interpreted(*columns, scale, FREE, 0.002, [0.0, 0.0, first, 0.0, first, 1.0], known)
    else:
        plain = RLSMF([0.99, 0.95], gain=kind, P0=4.0)
        state = [0.0, 0.0, 4.0 / 0.99, 4.0 / 0.95, 1.0]
        forgetting = Forgetting(kind == "joint", 1 / 0.99, 1 / 0.95)
        forget_each.interpreted(*columns, forgetting, FREE, 0.002, state, known)
    np.testing.assert_allclose(plain.update(y, phi).T, known.columns()[:2], rtol=1e-8, atol=1e-12)


def test_rlsmf_stays_inside_its_bounds():
    y, phi = rows()
    found = RLSMF(0.98, low=[0.0, -0.5, 0.0], high=1.5).update(y, phi)
    assert (found >= [0.0, -0.5, 0.0]).all()
    assert (found <= 1.5).all()
    assert found[-1, 0] == 1.5


def test_batch_ls_is_lstsq_after_every_row():
    y, phi = rows(40)
    batch = BatchLS()
    found = batch.update(y, phi)
    assert np.isnan(found[:2]).all()
    for k in (3, 10, 40):
        expected = np.linalg.lstsq(phi[:k], y[:k], rcond=None)[0]
        np.testing.assert_allclose(found[k - 1], expected, rtol=1e-9)
    np.testing.assert_allclose(batch.P, np.linalg.inv(phi.T @ phi), rtol=1e-9)


def test_batch_ls_of_collinear_rows_is_no_number():
    batch = BatchLS()
    batch.update(np.arange(1.0, 9.0), np.outer(np.arange(1.0, 9.0), [1.0, 2.0]))
    assert np.isnan(batch.theta).all()
    assert np.isinf(np.diag(batch.P)).all()


def test_tls_is_the_last_right_singular_vector():
    y, phi = rows(80)
    found = TLS().update(y, phi)
    for k in (4, 20, 80):
        v = np.linalg.svd(np.column_stack((phi, y))[:k])[2][-1]
        np.testing.assert_allclose(found[k - 1], -v[:3] / v[3], rtol=1e-8)
    assert np.isnan(found[:2]).all()


@pytest.mark.parametrize("forgetting", [None, 0.97])
def test_generalized_is_the_smallest_generalized_eigenvector(forgetting):
    y, phi = rows(80)
    method = GTLS(W) if forgetting is None else RGTLS(W, forgetting, P0=1e8)
    method.update(y, phi)
    w = np.ones(80) if forgetting is None else forgetting ** np.arange(79, -1, -1.0)
    z = np.column_stack((phi, y)) * np.sqrt(w)[:, None]
    v = scipy.linalg.eigh(z.T @ z, W)[1][:, 0]
    np.testing.assert_allclose(method.theta, -v[:3] / v[3], rtol=1e-6)


def test_rtls_covariance_covers_repeated_experiments():
    errors, stated = [], []
    for seed in range(60):
        y, phi = rows(200, 2, 0.1, seed)
        noisy = phi + 0.1 * np.random.default_rng(1000 + seed).standard_normal(phi.shape)
        method = RTLS()
        method.update(y, noisy)
        errors.append(method.theta - TRUE[:2])
        stated.append(np.sqrt(np.diag(method.P)))
    np.testing.assert_allclose(np.mean(stated, axis=0), np.std(errors, axis=0), rtol=0.3)


def test_ekf_without_a_model_is_recursive_least_squares():
    y, phi = rows(100)
    ekf, rls = EKF(R=1.0), RLS()
    np.testing.assert_allclose(ekf.update(y, phi), rls.update(y, phi), rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(ekf.P, rls.P, rtol=1e-6)


def test_ekf_of_a_linear_model_nears_the_steady_gain_of_the_riccati_equation():
    F, H, Q, R = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.diag([1e-4, 1e-3]), 0.05
    ekf = EKF(F=F, H=H, Q=Q, R=R, x0=[0.0, 0.0])
    rng = np.random.default_rng(0)
    ekf.update(rng.standard_normal(500))
    predicted = scipy.linalg.solve_discrete_are(F.T, H.T, Q, [[R]])
    np.testing.assert_allclose(F @ ekf.P @ F.T + Q, predicted, rtol=1e-6)
    assert ekf.innovation.shape == (1,)
    np.testing.assert_allclose(ekf.S, H @ predicted @ H.T + R, rtol=1e-6)


def test_ekf_of_a_pendulum_follows_it():
    step, pull = 0.01, 9.81

    def move(x, u):
        return [x[0] + step * x[1], x[1] + step * (u[0] - pull * np.sin(x[0]))]

    def slope(x, u):
        return [[1.0, step], [-step * pull * np.cos(x[0]), 1.0]]

    rng = np.random.default_rng(2)
    x, states, u = np.array([0.5, 0.0]), [], np.sin(np.arange(2000) * step)
    for value in u:
        x = np.array(move(x, [value]))
        states.append(x)
    truth = np.array(states)
    y = np.column_stack((np.sin(truth[:, 0]), truth[:, 1])) + 0.05 * rng.standard_normal(truth.shape)
    ekf = EKF(
        move, lambda x, u: [np.sin(x[0]), x[1]], F=slope, H=lambda x, u: [[np.cos(x[0]), 0.0], [0.0, 1.0]],
        Q=1e-8, R=0.0025, x0=[0.0, 0.0], P0=1.0,
    )  # fmt: skip
    y[700:720] = np.nan  # a sensor that is away for a moment
    found = ekf.update(y, u)
    assert np.sqrt(np.mean((found[500:] - truth[500:]) ** 2)) < 0.01


@pytest.mark.parametrize(
    ("make", "y", "phi", "says"),
    [
        (RLS, [1.0, 2.0], [[1.0], [2.0], [3.0]], "shapes do not fit"),
        (RLS, np.nan, [1.0], "not finite"),
        (lambda: RLS(1.5), 1.0, [1.0], "wrong forgetting"),
        (lambda: RLS(theta0=[1.0]), 1.0, [1.0, 2.0], "wrong theta0"),
        (lambda: RLS(P0=-1.0), 1.0, [1.0, 2.0], "wrong P0"),
        (lambda: RLSMF([0.9, 0.9]), 1.0, [1.0, 2.0, 3.0], "wrong size of forgetting"),
        (lambda: RLSMF(P0=[[1.0, 0.5], [0.5, 1.0]]), 1.0, [1.0, 2.0], "wrong P0"),
        (lambda: GTLS(np.eye(2)), 1.0, [1.0, 2.0], "wrong noise"),
        (lambda: GTLS(-np.eye(3)), 1.0, [1.0, 2.0], "wrong noise"),
        (lambda: EKF(H=[[1.0, 0.0]]), 1.0, None, "no start"),
        (lambda: EKF(H=[[1.0]], x0=[0.0, 0.0]), 1.0, None, "wrong size of H"),
        (lambda: EKF(Q=[1.0, 1.0], x0=[0.0]), 1.0, [1.0], "wrong Q"),
        (lambda: EKF(lambda x, u: x), 1.0, [1.0], "no Jacobian of f"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(make, y, phi, says):
    with pytest.raises(UsageError, match=says):
        make().update(y, phi)


def test_a_refused_row_leaves_everything_as_it_was():
    y, phi = rows(10)
    rls = RLS()
    rls.update(y, phi)
    before = rls.theta
    with pytest.raises(UsageError, match="another number of parameters"):
        rls.update(1.0, [1.0, 2.0])
    np.testing.assert_array_equal(rls.theta, before)
    fresh = RLS(theta0=[1.0, 2.0])
    with pytest.raises(UsageError):
        fresh.update(1.0, [1.0])
    assert fresh.update(1.0, [1.0, 1.0]).shape == (2,)


def test_the_package_names_them_and_imports_none_of_them():
    assert set(canest.estimators.__all__) <= set(dir(canest.estimators))
    with pytest.raises(AttributeError, match="LMS"):
        _ = canest.estimators.LMS
    code = "import sys, canest.estimators; print('numpy' in sys.modules, 'pydantic' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.parametrize("module", ["kalman", "least_squares"])
def test_examples_in_docstrings_are_right(module):
    found = doctest.testmod(importlib.import_module(f"canest.estimators.plain.{module}"))
    assert found.attempted
    assert not found.failed


def test_the_pages_example_runs(capsys):
    page = (Path(__file__).parents[2] / "docs" / "estimators.md").read_text(encoding="utf-8")
    code = page.split("```python\n")[1].split("```")[0]
    exec(compile(code, "docs/estimators.md", "exec"), {})
    first = capsys.readouterr().out.splitlines()[0]
    np.testing.assert_allclose(np.fromstring(first.strip("[]"), sep=" "), [2.0, -0.7], atol=0.01)
