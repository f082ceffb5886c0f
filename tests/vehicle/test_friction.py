"""Friction between its steps: nearer to the truth where steps follow engine speed, else as it is reported."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from vehicle_helpers import ticks

from canest.config.load import load_config
from canest.pipeline.build import model_spec
from canest.vehicle.friction import EngineFriction
from canest.vehicle.model import LongitudinalModel

RPM = np.pi / 30.0
STEP = 1.0


def sweeps(seconds: float, cycle: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reported friction, engine speed (rad/s) and the true friction; sweeps of some 100 rpm/s."""
    t = np.arange(round(seconds * 50)) * 0.02
    rpm = 1400.0 + 380.0 * np.sin(t / 3.1)
    true = 6.5 + 1.8e-3 * rpm
    sent = np.round(true)[(np.arange(len(t)) // cycle) * cycle]
    return sent, rpm * RPM, true


def test_a_staircase_becomes_the_slope_that_it_is():
    reported, speed, true = sweeps(120)
    found = EngineFriction(STEP).between_steps(reported, speed, False)
    late = slice(60 * 50, None)
    assert np.abs(reported - true)[late].max() > 0.45
    assert np.sqrt(np.mean((reported - true)[late] ** 2)) > 0.25
    assert np.abs(found - true)[late].max() < 0.15


def test_until_there_are_steps_enough_it_is_as_reported():
    reported, speed, _ = sweeps(120)
    steps = np.flatnonzero(np.diff(reported)) + 1
    found = EngineFriction(STEP).between_steps(reported, speed, False)
    np.testing.assert_array_equal(found[: steps[5]], reported[: steps[5]])
    assert (found != reported)[steps[5] :].any()


def test_steps_at_any_speed_are_no_line():
    """As a diesel truck's, that moves by 1 % many times a second whatever its speed does."""
    rng = np.random.default_rng(3)
    _, speed, true = sweeps(120)
    reported = np.round(true + rng.normal(0.0, 0.7, len(true)))
    found = EngineFriction(STEP).between_steps(reported, speed, False)
    np.testing.assert_array_equal(found, reported)


def test_friction_that_falls_with_speed_is_as_reported():
    reported, speed, _ = sweeps(120)
    found = EngineFriction(STEP).between_steps(20.0 - reported, speed, False)
    np.testing.assert_array_equal(found, 20.0 - reported)


@given(st.lists(st.integers(0, 2000), max_size=12))
def test_any_cut_gives_the_same_bits(edges):
    reported, speed, _ = sweeps(40)
    reported[700:720] = np.nan
    whole = EngineFriction(STEP).between_steps(reported, speed, False)
    parts, friction = [], EngineFriction(STEP)
    marks = sorted({0, len(reported), *edges})
    for a, b in pairwise(marks):
        parts.append(friction.between_steps(reported[a:b], speed[a:b], a > 0))
    np.testing.assert_array_equal(np.concatenate(parts), whole)


@settings(max_examples=60)
@given(st.integers(0, 1 << 31), st.sampled_from([0.125, 0.5, 1.0]))
def test_never_beyond_what_the_report_allows(seed, step):
    rng = np.random.default_rng(seed)
    n = 2000
    speed = np.cumsum(rng.normal(0.0, 3.0, n)) + 150.0
    reported = np.round((speed / 20.0 + rng.normal(0.0, rng.uniform(0.0, 1.0), n)) / step) * step
    lost = rng.random(n) < 0.01
    reported[lost], speed[rng.random(n) < 0.01] = np.nan, np.nan
    found = EngineFriction(step).between_steps(reported, speed, False)
    np.testing.assert_array_equal(np.isnan(found), lost)
    assert (np.abs(found - reported)[~lost] <= 0.5 * step + 1e-12).all()


def test_a_gap_is_no_step():
    reported, speed, _ = sweeps(60)
    steps = np.flatnonzero(np.diff(reported)) + 1
    friction = EngineFriction(STEP)
    for begin, end in zip([0, *steps], [*steps, len(reported)], strict=True):  # each step falls into a gap
        found = friction.between_steps(reported[begin:end], speed[begin:end], False)
        np.testing.assert_array_equal(found, reported[begin:end])  # no line has been learned


def test_the_models_torque_is_less_this_friction():
    config = load_config("class8")
    reported, speed, true = sweeps(120)
    n = len(reported)
    values = {
        "engine_torque_pct": np.full(n, 40.0),
        "engine_friction_pct": reported,
        "engine_speed": speed / RPM,
        "output_shaft_speed": speed / RPM,
        "gear_ratio": np.ones(n),
        "gear": np.full(n, 9.0),
    }
    values = dict.fromkeys(config.signals, np.full(n, np.nan)) | values
    found = LongitudinalModel(model_spec(config)).process(ticks(values, n)).columns.torque_Nm
    friction = 40.0 - found / 21.0
    late = slice(60 * 50, None)
    assert np.abs(friction - true)[late].max() < 0.15
