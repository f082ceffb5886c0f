"""The pitch of the body: learned where the config states none, and taken as stated where it does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import GRAVITY_MPS2, Status
from canest.estimators.default.estimator import GaussianSum
from canest.estimators.default.model import PITCH
from tests.estimators.momentum import FACTS, flat, hills, trip

UNSTATED = replace(FACTS, pitch_rad_per_mps2=None, has_accelerometer=True)


def learned(estimator):
    """Mean and standard deviation of the pitch, rad per m/s2."""
    count = int(estimator._carried.progress.alive)
    weight, mixture = np.array(estimator._mixture.weight[:count]), estimator._mixture
    mean = weight @ mixture.x[:count, PITCH]
    return mean / GRAVITY_MPS2, np.sqrt(weight @ mixture.P[:count, PITCH, PITCH]) / GRAVITY_MPS2


@pytest.mark.parametrize("road", [flat, hills])
@pytest.mark.parametrize("pitch", [-0.003, 0.012, 0.02])
def test_a_pitch_that_nobody_states_is_learned(road, pitch):
    """And makes no mass: 0.01 rad per m/s2 would be 10 % of the force per acceleration."""
    drive = trip(
        300.0,
        mass_kg=18_000.0,
        road=road,
        accelerometer=True,
        pitch_rad_per_mps2=pitch,
        sensed_noise_mps2=0.1,
    )
    estimator = GaussianSum("canest", UNSTATED)
    estimates = estimator.update(drive.block)
    mean, std = learned(estimator)
    assert mean == pytest.approx(pitch, abs=0.0015)
    assert std < 0.0015
    assert abs(drive.error(estimates)[-1]) < 0.012
    valid = estimates.status == Status.VALID
    assert valid[3_000:].mean() > 0.95
    assert np.abs(drive.error(estimates)[valid]).max() < 0.04


def test_a_stated_pitch_stays_as_it_is():
    drive = trip(60.0, accelerometer=True, pitch_rad_per_mps2=0.012)
    estimator = GaussianSum("canest", replace(FACTS, has_accelerometer=True))
    estimator.update(drive.block)
    assert learned(estimator) == pytest.approx((0.01, 0.0), abs=1e-9)


def test_slow_signals_teach_no_pitch():
    """Between two reports the acceleration is a line behind a sensor's: the pitch would look smaller."""
    drive = trip(120.0, accelerometer=True, pitch_rad_per_mps2=0.012)
    estimator = GaussianSum("canest", replace(UNSTATED, report_period_s=0.5))
    estimator.update(drive.block)
    assert learned(estimator)[1] == pytest.approx(0.0, abs=1e-9)
