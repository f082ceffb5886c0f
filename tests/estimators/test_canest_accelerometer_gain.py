"""An accelerometer of another gain than stated is left out; a sound one never is, whatever the road does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.default.estimator import GaussianSum

from .momentum import FACTS, Trip, trip

STATED = replace(FACTS, has_accelerometer=True)
PITCH = STATED.pitch_rad_per_mps2
SECOND = 50

pytestmark = pytest.mark.usefixtures("compiled")


def on_and_off(t, v):
    return 0.85 if t % 12.0 < 6.0 else 0.0


def drive(seconds: float = 300.0, **more) -> Trip:
    kept = {"accelerometer": True, "pitch_rad_per_mps2": PITCH, "throttle": on_and_off, "mass_kg": 12_000.0}
    return trip(seconds, **kept | more)


def faults(found: Trip, gain: float, facts=STATED):
    """Return the estimator, its estimates, and whether the sensor was left out in each second."""
    block = replace(found.block, accelerometer_mps2=gain * found.block.accelerometer_mps2)
    estimator, parts, faulty = GaussianSum("canest", facts), [], []
    for i in range(0, len(block), SECOND):
        parts.append(estimator.update(block[i : i + SECOND]))
        faulty.append(estimator._carried.comparison.faulty)
    mass = np.concatenate([part.mass_kg for part in parts])
    status = np.concatenate([part.status for part in parts])
    return estimator, mass / found.mass_kg - 1.0, status, np.array(faulty)


@pytest.mark.parametrize("gain", [0.5, 0.7, 0.8, 1.25, 1.4])
def test_another_gain_is_found_and_no_wrong_mass_stays_valid(gain):
    estimator, error, status, faulty = faults(drive(), gain)
    first = int(np.flatnonzero(faulty)[0])
    assert first < 90
    assert faulty[first:].all()  # for good
    late = np.arange(len(error)) > (first + 30) * SECOND
    assert np.abs(error[late & (status == Status.VALID)]).max() < 0.04
    assert (status[late] == Status.VALID).mean() > 0.8
    assert "accelerometer" in estimator.contradiction()


@pytest.mark.parametrize("gain", [0.95, 1.0, 1.05])
@pytest.mark.parametrize("road", [0.0, 0.03])
def test_a_sound_one_is_used_on_any_road(gain, road):
    """Waves of 3 % every 63 m change the speed as much as the engine does."""
    found = drive(road=lambda s: road * np.sin(s / 10.0))
    _, _, _, faulty = faults(found, gain)
    assert not faulty.any()


def test_where_the_pitch_is_not_stated_a_wider_range_is_sound():
    found = drive()
    for gain, expected in ((0.8, False), (1.2, False), (0.5, True), (1.6, True)):
        assert faults(found, gain, replace(STATED, pitch_rad_per_mps2=None))[3].any() == expected


def test_one_that_fits_again_is_used_again():
    found = drive(600.0)
    sensed = found.block.accelerometer_mps2
    first = np.arange(len(sensed)) < 200 * SECOND
    mended = replace(found, block=replace(found.block, accelerometer_mps2=np.where(first, 0.6, 1.0) * sensed))
    _, error, status, faulty = faults(mended, 1.0)
    assert faulty[150]
    assert not faulty[-1]
    assert status[-1] == Status.VALID
    assert abs(error[-1]) < 0.03
