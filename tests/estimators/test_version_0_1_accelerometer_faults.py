"""A faulty accelerometer is detected and not used; a sound one always is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.hearing import hears
from canest.estimators.registry import create

from .momentum import FACTS, trip


def judged(sensed, accel, moving=None, rounding_mps=0.0):
    """Return the verdict after every window."""
    memory = [0.0] * at.MEMORY
    memory[at.ACCEL_BEFORE] = np.nan
    moving = np.ones(len(accel), bool) if moving is None else moving
    windows = zip(sensed, accel, moving, strict=True)
    return np.array([hears(memory, float(s), float(a), bool(m), rounding_mps) for s, a, m in windows])


def driven(seed=3, seconds=300):
    """Accelerations of windows of 0.2 s that change within seconds."""
    rng = np.random.default_rng(seed)
    return np.interp(np.arange(seconds * 5) / 5.0, np.arange(seconds + 1), rng.normal(0.0, 0.4, seconds + 1))


@pytest.mark.parametrize(
    ("gain", "sound"),
    [(0.8, True), (1.0, True), (1.3, True), (0.0, False), (-1.0, False), (0.1, False), (9.8, False)],
)
def test_the_gain_decides_whatever_bias_road_and_noise(gain, sound):
    accel = driven()
    rng = np.random.default_rng(1)
    road = 0.3 * np.sin(np.arange(len(accel)) / 60.0)
    sensed = gain * accel + road + 0.7 + rng.normal(0.0, 0.05, len(accel))
    told = judged(sensed, accel + rng.normal(0.0, 0.02, len(accel)))
    assert told[:5].all()  # nothing speaks against it yet
    assert told[300:].all() == sound
    assert told[300:].any() == sound


def test_a_coarse_speed_is_no_evidence():
    """A J1587 road speed has steps of half a mile per hour: most of what it tells of changes is rounding."""
    accel, step = 0.5 * driven(), 0.2235
    speed = 15.0 + np.cumsum(accel) * 0.2
    told = np.diff(np.round(speed / step) * step, prepend=15.0) / 0.2
    assert not judged(0.9 * accel, told).all()
    assert judged(0.9 * accel, told, rounding_mps=step / np.sqrt(12.0)).all()


def test_one_that_gets_stuck_is_noticed_and_one_that_recovers_too():
    accel = driven(seconds=900)
    sensed = accel.copy()
    sensed[1500:3000] = 0.4
    told = judged(sensed, accel)
    assert told[:1500].all()
    assert not told[2400:3000].any()
    assert told[4000:].all()


def test_a_steady_drive_and_a_standing_vehicle_detect_nothing():
    calm = np.zeros(3000)
    assert judged(calm + 3.0, calm).all()
    accel = driven()
    assert judged(0.0 * accel, accel, moving=np.zeros(len(accel), bool)).all()


def test_without_one_there_is_nothing_to_use():
    accel = driven()
    assert not judged(np.full(len(accel), np.nan), accel).any()


@pytest.mark.parametrize("fault", ["inverted", "stuck", "in g"])
def test_with_a_faulty_one_no_number_is_called_valid_and_a_contradiction_is_reported(fault):
    drive = trip(300, accelerometer=True)
    sensed = drive.block.accelerometer_mps2
    changed = {
        "inverted": -sensed,
        "stuck": np.where(np.arange(len(sensed)) < 5000, sensed, 0.3),
        "in g": sensed / 9.81,
    }
    estimator = create("canest-0.1", FACTS)
    e = estimator.update(replace(drive.block, accelerometer_mps2=changed[fault]))
    t = np.arange(len(e)) * 0.02
    assert (e.status[t > 240] == Status.CONVERGING).all()
    assert (np.abs(drive.error(e)) * drive.mass_kg < 2.0 * e.mass_std_kg)[t > 240].all()
    assert (np.abs(e.grade - drive.grade) < 3.0 * e.grade_std)[t > 240].mean() > 0.9
    assert "accelerometer" in estimator.contradiction()


def test_a_sound_one_is_no_contradiction():
    estimator = create("canest-0.1", FACTS)
    e = estimator.update(trip(300, accelerometer=True).block)
    assert (e.status[12_000:] == Status.VALID).all()
    assert estimator.contradiction() == ""
