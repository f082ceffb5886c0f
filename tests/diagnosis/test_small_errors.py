"""A standard deviation holds for values that small errors have moved, and only for those."""

import numpy as np
import pytest

from canest.config import load_config
from canest.diagnosis.data.least_squares import solve
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.small_errors import usual_spread, variance_beside

N, PER_CHUNK = 240, 8
CHUNK = np.arange(N) // PER_CHUNK


def fits(likeness, spread, drives=300):
    """Fit one effect while a small error of about its own shape is there; return error over reported std."""
    rng = np.random.default_rng(3)
    z, plain = [], []
    for _ in range(drives):
        effect = 1.0 + rng.standard_normal(N)
        error = likeness * effect + rng.standard_normal(N)
        noise = rng.standard_normal(N)
        residual = -2.0 * effect - spread * rng.standard_normal() * error + noise
        fit = solve(residual, effect[:, None], CHUNK)
        beside = variance_beside(residual, effect[:, None], CHUNK, {"error": error}, {"error": spread})[0]
        off = fit.values[0] - 2.0
        z.append(off / np.sqrt(fit.covariance[0, 0] + beside))
        plain.append(off / np.sqrt(fit.covariance[0, 0]))
    return np.array(z), np.array(plain)


def test_it_covers_what_a_small_error_like_the_effect_does():
    z, plain = fits(likeness=1.0, spread=0.5)
    assert np.mean(np.abs(z) < 2) > 0.93
    assert np.mean(np.abs(plain) < 2) < 0.5


def test_it_adds_nothing_where_the_small_error_is_unlike_the_effect():
    z, plain = fits(likeness=0.0, spread=0.02)
    assert z == pytest.approx(plain, rel=0.2)


def test_an_effect_that_is_the_small_error_itself_cannot_be_known_more_finely_than_that():
    rng = np.random.default_rng(1)
    effect = rng.standard_normal(N)
    beside = variance_beside(rng.standard_normal(N), effect[:, None], CHUNK, {"same": effect}, {"same": 0.3})
    assert beside == pytest.approx([0.09], rel=1e-6)


def test_no_effect_and_no_small_error_are_no_trouble():
    nothing = np.zeros((N, 0))
    assert variance_beside(np.ones(N), nothing, CHUNK, {"e": np.ones(N)}, {"e": 1.0}).shape == (0,)
    assert variance_beside(np.ones(N), np.ones((N, 1)), CHUNK, {}, {}).tolist() == [0.0]


def test_a_factor_on_all_traction_is_no_small_error_where_the_mass_is_free():
    """Together they scaled every force of an electric car's trips to nothing, and with it the residual."""
    vehicle = load_config("bmw-i3").vehicle
    gain, wind = (
        Candidate(name, name, parameter, confounded=confounded)
        for name, parameter, confounded in (("torque_gain", "gain", True), ("headwind", "wind_mps", False))
    )
    assert set(usual_spread(vehicle, [gain, wind])) == {"headwind"}
    assert set(usual_spread(vehicle, [Candidate("torque_gain", "torque_gain", "gain"), wind])) == {
        "torque_gain",
        "headwind",
    }
