import numpy as np
import pytest

from canest.diagnosis.data.least_squares import FOLDS, chunk_sums, held_out, solve

CHUNKS, LONG = 24, 15
CHUNK = np.repeat(np.arange(CHUNKS), LONG)


def regressors(rng, k=2):
    slow = rng.normal(size=(CHUNKS, k))
    return 3.0 + slow[CHUNK] + 0.5 * rng.normal(size=(len(CHUNK), k))


def test_coefficients_equal_numpys_least_squares():
    rng = np.random.default_rng(1)
    X = regressors(rng) * [1.0, 1e5]
    residual = rng.normal(size=len(CHUNK))
    fit = solve(residual, X, CHUNK)
    expected = np.linalg.lstsq(X, -residual, rcond=None)[0]
    assert fit.values == pytest.approx(expected, rel=1e-8)
    assert fit.left == pytest.approx(residual + X @ expected, abs=1e-9)


def test_standard_errors_are_those_of_repeated_experiments_with_noise_that_lasts():
    rng = np.random.default_rng(2)
    X, true = regressors(rng), np.array([1.0, -0.4])
    values, stds = [], []
    for _ in range(600):
        noise = rng.normal(size=CHUNKS)[CHUNK] + 0.5 * rng.normal(size=len(CHUNK))
        fit = solve(-X @ true + noise, X, CHUNK)
        values.append(fit.values)
        stds.append(np.sqrt(np.diag(fit.covariance)))
    scatter = np.std(values, axis=0)
    assert np.mean(values, axis=0) == pytest.approx(true, abs=4 * scatter.max() / np.sqrt(600))
    assert np.mean(stds, axis=0) == pytest.approx(scatter, rel=0.12)
    # what independent errors would claim is far too little: the test separates the two
    naive = np.sqrt(np.diag(np.linalg.inv(X.T @ X)) * 1.25)
    assert (naive < 0.6 * scatter).all()


def test_held_out_rows_are_judged_by_a_fit_of_the_other_folds():
    rng = np.random.default_rng(3)
    X = regressors(rng)
    residual = X @ [2.0, 1.0] + rng.normal(size=len(CHUNK))
    left = held_out(residual, X, CHUNK)
    for fold in range(FOLDS):
        test = fold == CHUNK % FOLDS
        p = np.linalg.lstsq(X[~test], -residual[~test], rcond=None)[0]
        assert left[test] == pytest.approx(residual[test] + X[test] @ p)


def test_useless_regressors_help_in_sample_but_not_out_of_it():
    rng = np.random.default_rng(4)
    inside, outside = [], []
    for _ in range(40):
        X, residual = regressors(rng, 3), rng.normal(size=CHUNKS)[CHUNK]
        inside.append((solve(residual, X, CHUNK).left ** 2).sum() / (residual**2).sum())
        outside.append((held_out(residual, X, CHUNK) ** 2).sum() / (residual**2).sum())
    assert np.mean(inside) < 1.0 < np.mean(outside)


def test_without_regressors_everything_is_left():
    residual = np.arange(float(len(CHUNK)))
    assert (held_out(residual, np.zeros((len(CHUNK), 0)), CHUNK) == residual).all()


def test_chunk_sums_add_up():
    x = np.arange(6.0)
    assert chunk_sums(x, np.array([0, 0, 1, 1, 1, 3])).tolist() == [1.0, 9.0, 0.0, 5.0]
