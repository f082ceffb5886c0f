"""The grade filter against generalised least squares with the whole covariance matrix."""

from types import SimpleNamespace

import numpy as np
import pytest

from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.drive import Run
from canest.diagnosis.data.whitening import WINDOW_NOISE_MPS2, GradeFilter

MASS_KG, SPEED_MPS, SLOPE_STD, LENGTH_M = 20_000.0, 18.0, 0.01, 250.0


def part(t_s, slope_std=SLOPE_STD):
    n = len(t_s)
    return SimpleNamespace(
        windows=SimpleNamespace(t_s=t_s, count=n),
        mass_w=np.full(n, MASS_KG),
        speed_mps=np.full(n, SPEED_MPS),
        reference=SimpleNamespace(sin_beta_std=slope_std, correlation_m=LENGTH_M),
    )


def covariance(t_s):
    """White noise, and an unknown grade whose error decays over distance."""
    apart = np.abs(t_s[:, None] - t_s[None, :]) * SPEED_MPS / LENGTH_M
    grade = (SLOPE_STD * GRAVITY_MPS2 * MASS_KG) ** 2 * np.exp(-apart)
    return grade + np.eye(len(t_s)) * (WINDOW_NOISE_MPS2 * MASS_KG) ** 2


def innovations(column, part):
    return GradeFilter(part).innovations(column)


@pytest.fixture
def t_s():
    # a pause in the middle: the grade is forgotten there
    return np.r_[np.arange(40.0), 90.0 + np.arange(30.0)]


def test_innovations_are_the_cholesky_factors(t_s):
    x = np.random.default_rng(1).normal(size=len(t_s)) * 500 + 300
    expected = np.linalg.solve(np.linalg.cholesky(covariance(t_s)), x)
    assert innovations(x, part(t_s)) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_a_fit_of_whitened_columns_is_generalised_least_squares(t_s):
    rng = np.random.default_rng(2)
    X, y = rng.normal(size=(len(t_s), 2)) * 400, rng.normal(size=len(t_s)) * 400
    V = np.linalg.inv(covariance(t_s))
    expected = np.linalg.solve(X.T @ V @ X, X.T @ V @ y)
    white = np.column_stack([innovations(c, part(t_s)) for c in X.T])
    found = np.linalg.lstsq(white, innovations(y, part(t_s)), rcond=None)[0]
    assert found == pytest.approx(expected, rel=1e-9)


def test_a_clock_set_back_by_a_day_forgets_no_more_of_the_grade_than_the_moment_it_took():
    t_us = 20_000 * np.arange(120 * 50)
    t_us[70 * 50 :] -= 86_400_000_000
    t_s = Run(SimpleNamespace(t_us=t_us), *4 * [None]).t_s[::50]
    x = np.random.default_rng(3).normal(size=120) * 500
    assert innovations(x, part(t_s)) == pytest.approx(innovations(x, part(np.arange(120.0))), rel=2e-2)


def test_with_a_known_grade_nothing_is_filtered(t_s):
    x = np.arange(float(len(t_s)))
    assert innovations(x, part(t_s, 0.0)) == pytest.approx(x / (WINDOW_NOISE_MPS2 * MASS_KG))


def test_a_steady_force_hides_in_an_unknown_grade_and_a_changing_one_does_not(t_s):
    steady, changing = np.full(len(t_s), 1000.0), np.where(np.arange(len(t_s)) % 2, 1000.0, -1000.0)
    seen = [(innovations(x, part(t_s)) ** 2).sum() for x in (steady, changing)]
    assert seen[0] < 0.1 * seen[1]
