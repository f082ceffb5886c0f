"""The road smoother against one dense least-squares problem for the whole drive."""

from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config
from canest.diagnose.drive import Drive
from canest.diagnose.reference import (
    ACCELEROMETER_STD_MPS2,
    BIAS_STD_MPS2,
    PITCH_STD,
    _smooth,
    reference_for,
)
from canest.vehicle.samples import GRAVITY_MPS2

ALTITUDE_STD_M, WALK = 1.0, 0.0004


def road(n):
    rng = np.random.default_rng(1)
    speed = 18.0 + 4.0 * np.sin(np.arange(n) / 9.0)
    accel = np.gradient(speed)
    sin_beta = np.cumsum(rng.normal(size=n) * WALK * np.sqrt(speed))
    altitude = 300.0 + np.cumsum(speed * sin_beta) + rng.normal(size=n) * ALTITUDE_STD_M
    extra = GRAVITY_MPS2 * sin_beta + 0.2 + GRAVITY_MPS2 * 0.012 * accel
    extra += rng.normal(size=n) * ACCELEROMETER_STD_MPS2
    altitude[::3] = np.nan  # a receiver that sometimes sees nothing
    return speed, accel, extra, altitude, WALK**2 * speed


def batch(speed, accel, extra, altitude, walk):
    """Unknowns: first state (4), then each second's disturbance of altitude and of sin(beta)."""
    n = len(speed)
    unknowns = 4 + 2 * n
    state = np.zeros((4, unknowns))
    state[:, :4] = np.eye(4)
    first = [altitude[np.isfinite(altitude)][0], 0.0, 0.0, 0.01]
    rows, values = [], []

    def row(coefficients, value, std):
        rows.append(coefficients / std)
        values.append(value / std)

    for i, std in enumerate((100.0, 0.05, BIAS_STD_MPS2, PITCH_STD)):
        row(np.eye(unknowns)[i], first[i], std)
    slopes = np.empty((n, unknowns))
    for k in range(n):
        state[0] += speed[k] * state[1]
        for i, variance in ((0, 0.01), (1, walk[k])):
            which = np.eye(unknowns)[4 + 2 * k + i]
            state[i] += which
            row(which, 0.0, np.sqrt(variance))
        if np.isfinite(altitude[k]):
            row(state[0].copy(), altitude[k], ALTITUDE_STD_M)
        h = GRAVITY_MPS2 * state[1] + state[2] + GRAVITY_MPS2 * accel[k] * state[3]
        row(h, extra[k], np.hypot(ACCELEROMETER_STD_MPS2, 0.05 * accel[k]))
        slopes[k] = state[1]
    A = np.array(rows)
    p = np.linalg.lstsq(A, np.array(values), rcond=None)[0]
    return slopes @ p, np.sqrt(np.diag(slopes @ np.linalg.inv(A.T @ A) @ slopes.T))


def test_a_mass_that_is_given_wins_over_the_table_and_the_table_need_not_tell_more(tmp_path):
    config = load_config("kenworth")
    log = Path(__file__).parents[1] / "data/kenworth/normal.log.xz"
    drive = Drive.load(log, config)
    run = drive.run([])
    truth = tmp_path / "truth.csv"
    truth.write_text("t_s,mass_kg\n0,7000\n10,7500\n")
    told = reference_for(drive, run, truth=truth, mass_kg=8000.0)
    assert set(told.mass_kg.tolist()) == {8000.0}
    told = reference_for(drive, run, truth=truth)
    assert np.nanmin(told.mass_kg) >= 7000 and np.isnan(told.mass_kg[-1]) and told.grade is None


def test_smoothed_grade_and_its_doubt_are_those_of_the_batch():
    speed, accel, extra, altitude, walk = road(60)
    _, sin_beta, std = _smooth(speed, accel, extra, altitude, ALTITUDE_STD_M, walk, None)[:3]
    expected, expected_std = batch(*road(60))
    assert sin_beta == pytest.approx(expected, abs=1e-7)
    assert np.median(std) == pytest.approx(np.median(expected_std), rel=1e-4)


def test_the_right_roughness_of_the_road_is_the_likeliest():
    speed, accel, extra, altitude, walk = road(600)
    likelihood = [
        _smooth(speed, accel, extra, altitude, ALTITUDE_STD_M, walk * f**2, None)[0] for f in (0.2, 1.0, 5.0)
    ]
    assert likelihood[1] == max(likelihood)
