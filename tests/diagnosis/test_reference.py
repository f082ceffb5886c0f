"""The road smoother against one dense least-squares problem for the whole drive."""

from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.drive import Drive
from canest.diagnosis.data.reference import reference_for
from canest.diagnosis.data.road_smoother import (
    ACCELEROMETER_STD_MPS2,
    BIAS_STD_MPS2,
    PITCH_STD,
    on_ticks,
    smooth,
    whole_seconds,
)
from canest.simulation import simulate

ALTITUDE_STD_M, WALK = 1.0, 0.0004


def road(n, gap=None):
    """A smooth road; from step ``gap`` on another one, 80 m higher."""
    rng = np.random.default_rng(1)
    speed = 18.0 + 4.0 * np.sin(np.arange(n) / 9.0)
    accel = np.gradient(speed)
    sin_beta = np.cumsum(rng.normal(size=n) * WALK * np.sqrt(speed))
    fresh = np.arange(n) == gap
    if gap is not None:
        sin_beta[gap:] -= 0.04
    altitude = (
        300.0 + 80.0 * np.cumsum(fresh) + np.cumsum(speed * sin_beta) + rng.normal(size=n) * ALTITUDE_STD_M
    )
    extra = GRAVITY_MPS2 * sin_beta + 0.2 + GRAVITY_MPS2 * 0.012 * accel
    extra += rng.normal(size=n) * ACCELEROMETER_STD_MPS2
    altitude[::3] = np.nan  # a receiver that sometimes sees nothing
    return fresh, speed, accel, extra, altitude, ALTITUDE_STD_M, WALK**2 * speed


def batch(fresh, speed, accel, extra, altitude, altitude_std, walk):
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
        state[0] += 0.0 if fresh[k] else speed[k] * state[1]
        lost = (100.0**2, 0.05**2) if fresh[k] else (0.0, 0.0)
        for i, variance in ((0, 0.01 + lost[0]), (1, walk[k] + lost[1])):
            which = np.eye(unknowns)[4 + 2 * k + i]
            state[i] += which
            row(which, 0.0, np.sqrt(variance))
        if np.isfinite(altitude[k]):
            row(state[0].copy(), altitude[k], altitude_std)
        h = GRAVITY_MPS2 * state[1] + state[2] + GRAVITY_MPS2 * accel[k] * state[3]
        row(h, extra[k], np.hypot(ACCELEROMETER_STD_MPS2, 0.05 * accel[k]))
        slopes[k] = state[1]
    A = np.array(rows)
    p = np.linalg.lstsq(A, np.array(values), rcond=None)[0]
    return slopes @ p, np.sqrt(np.diag(slopes @ np.linalg.inv(A.T @ A) @ slopes.T))


def test_a_mass_that_is_given_wins_over_the_table_which_needs_no_other_column(tmp_path):
    config = load_config("kenworth")
    log = Path(__file__).parents[1] / "data/kenworth/normal.log.xz"
    drive = Drive.load(log, config)
    run = drive.run([])
    truth = tmp_path / "truth.csv"
    truth.write_text("t_s,mass_kg\n0,7000\n10,7500\n")
    document = reference_for(drive, run, truth=truth, mass_kg=8000.0)
    assert set(document.mass_kg.tolist()) == {8000.0}
    document = reference_for(drive, run, truth=truth)
    assert np.nanmin(document.mass_kg) >= 7000 and np.isnan(document.mass_kg[-1]) and document.grade is None
    assert document.notes == ()
    truth.write_text("t_s,mass_kg\n0,7000\n10,7500\n20,75OO\n")
    assert "first in row 4: '75OO'" in reference_for(drive, run, truth=truth).notes[0]


@pytest.mark.parametrize("gap", [None, 31])
def test_smoothed_grade_and_its_variance_are_those_of_the_batch(gap):
    found = smooth(*road(60, gap), None)
    expected, expected_std = batch(*road(60, gap))
    assert found.sin_beta == pytest.approx(expected, abs=1e-7)
    assert found.std == pytest.approx(np.median(expected_std), rel=1e-4)


def test_the_right_roughness_of_the_road_is_the_likeliest():
    *seen, walk = road(600)
    likelihood = [smooth(*seen, walk * f**2, None).log_likelihood for f in (0.2, 1.0, 5.0)]
    assert likelihood[1] == max(likelihood)


def test_no_second_and_no_line_is_drawn_through_a_gap():
    tick = np.concatenate((np.arange(120), np.arange(500, 530), np.arange(700, 800)))
    begins = np.diff(tick, prepend=-1) != 1
    begins[0] = True
    first, fresh = whole_seconds(begins)
    assert first.tolist() == [0, 50, 150, 200] and fresh.tolist() == [False, False, True, False]
    column = on_ticks(np.array([1.0, 2.0, 5.0, 7.0]), first, fresh, len(tick))
    assert column[:150].min() == 1.0 and column[:150].max() == 2.0
    assert column[150:].min() == 5.0 and column[-1] == 7.0
    # a scrap before the first gap has no second of its own
    first, fresh = whole_seconds(np.concatenate(([True], begins[101:])))
    assert first.tolist() == [50, 100] and not fresh.any()
    assert on_ticks(np.array([5.0, 7.0]), first, fresh, 150)[0] == 5.0


def test_a_gap_costs_the_road_beside_it_nothing(tmp_path):
    simulate("mixed-9t").write(tmp_path)
    config = load_config("class8")
    whole, cut = tmp_path / "mixed-9t.log", tmp_path / "cut.log"
    lines = whole.read_text().splitlines(keepends=True)
    begin_s = float(lines[0][1:].split(")")[0])
    cut.write_text("".join(x for x in lines if not 150 < float(x[1:].split(")")[0]) - begin_s < 240))
    found = {}
    for log in (whole, cut):
        drive = Drive.load(log, config)
        run = drive.run([])
        reference = reference_for(drive, run, mass_kg=9000.0)
        assert reference.kind == "altitude+accelerometer"
        found[log] = dict(zip(run.samples.t_us.tolist(), reference.sin_beta.tolist(), strict=True))
    apart = [found[cut][t] - found[whole][t] for t in found[cut]]
    assert np.max(np.abs(apart)) < 0.01
