"""Wind or accessories that are others at once: a hypothesis, so that a load is not the only one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.default import hypotheses, load
from canest.estimators.default import model as m
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.default.estimator import GaussianSum
from tests.estimators.momentum import hills, trip
from tests.estimators.test_canest_loads_and_roads import STATED
from tests.estimators.test_canest_parts import TRUCK, mixture

SENSED = replace(STATED, has_accelerometer=True)
U = 1.0 / 20_000.0
VEHICLE = TRUCK._replace(offset_Nm=10.0)


def test_copies_have_another_disturbance_and_a_share():
    """1 - exp(-1 / 250) = 0.4 % goes to copies that differ in the variances of wind and offset alone."""
    mix, _ = mixture(3)
    mix.load[:3], mix.weight[:3] = [1, 0, 1], [0.5, 0.45, 0.05]
    P = mix.P[:3].copy()
    changed = 1.0 - np.exp(-1.0 / CONSTANTS.jump_every_s)
    assert changed * 0.05 < CONSTANTS.least_weight  # it would not live
    assert load.open_disturbance(mix, 3, changed, U, CONSTANTS, VEHICLE) == 5
    shares = [0.5 * (1.0 - changed), 0.45 * (1.0 - changed), 0.05, 0.5 * changed, 0.45 * changed]
    np.testing.assert_allclose(mix.weight[:5], shares, rtol=1e-12)
    assert list(mix.load[:5]) == [1, 0, 1, 1 + m.OTHER_DISTURBANCE, m.OTHER_DISTURBANCE]
    for made, of in ((3, 0), (4, 1)):
        added = np.zeros_like(P[of])
        added[m.WIND, m.WIND] = (3.0 * CONSTANTS.wind_std_mps * U) ** 2
        added[m.OFFSET, m.OFFSET] = (3.0 * 10.0 * U) ** 2
        np.testing.assert_array_equal(mix.x[made], mix.x[of])
        np.testing.assert_allclose(mix.P[made] - P[of], added, atol=1e-22)
        assert mix.mode[made] == mix.mode[of]


def test_there_are_never_more_than_there_is_room_for():
    mix, _ = mixture(m.MOST - 1)
    mix.weight[: m.MOST - 1] = [1.0 / (m.MOST - 1)] * (m.MOST - 1)
    assert load.open_disturbance(mix, m.MOST - 1, 1.0, U, CONSTANTS, VEHICLE) == m.MOST


def test_they_come_back_to_the_load_that_they_have():
    """Where modes exchange probability: those of one load meet, whatever the disturbance was."""
    mix, space = mixture(4, loads=[0, 2 + m.OTHER_DISTURBANCE, 2, m.OTHER_DISTURBANCE])
    chains = hypotheses.transitions(0.0, 0.0, CONSTANTS)
    assert hypotheses.exchange(mix, 4, chains, CONSTANTS.least_weight, space) == 2
    assert list(mix.load[:2]) == [0, 2]
    np.testing.assert_allclose(mix.weight[:2], [0.5, 0.5])


@pytest.mark.parametrize("accelerometer", [True, False])
def test_only_with_an_accelerometer_may_it_be_another(accelerometer):
    """Without, no variance of the offset is beyond the prior's: it fades, and is measured."""
    drive = trip(60.0, mass_kg=16_000.0, road=hills, throttle=held, accelerometer=accelerometer)
    estimator = GaussianSum("canest", replace(STATED, has_accelerometer=accelerometer))
    estimator.update(drive.block)
    progress = estimator._carried.progress
    offset_var = estimator._mixture.P[: int(progress.alive), m.OFFSET, m.OFFSET]
    prior_var = (estimator._vehicle.offset_Nm * progress.u) ** 2
    assert bool(offset_var.max() > 1.1 * prior_var) is accelerometer


def test_an_accelerometer_that_is_silent_is_none():
    """It is configured, and no value comes: estimates are those of a vehicle without one."""
    drive = trip(200.0, mass_kg=16_000.0, road=hills, throttle=held, unseen_N=gusts)
    silent = replace(drive.block, accelerometer_mps2=np.full(len(drive.block), np.nan))
    sensed = GaussianSum("canest", SENSED).update(silent)
    without = GaussianSum("canest", replace(SENSED, has_accelerometer=False)).update(drive.block)
    np.testing.assert_allclose(sensed.mass_kg, without.mass_kg, rtol=1e-6)
    np.testing.assert_allclose(sensed.grade, without.grade, atol=1e-8)


def gusts(t):
    """A headwind of 7 m/s comes and goes at 20 m/s: 2 * 3.8 * 20 * 7 = 1.1 kN, 30 s each."""
    return 1_100.0 if t > 100.0 and (t // 30.0) % 2.0 else 0.0


def held(t, v):
    """Hold 22 m/s with the pedal, never quite steadily."""
    return float(np.clip(0.27 + 0.3 * np.sin(t / 4.0) + 0.1 * (22.0 - v), -0.03, 0.85))


@pytest.mark.parametrize("mass_kg", [10_000.0, 16_000.0])
def test_a_wind_in_steps_is_no_load(mass_kg):
    """Over five drives; without the hypothesis `valid` in 40 and 48 % of the time, wrong in 0 and 3 %."""
    wrong, share = [], []
    for seed in range(1, 6):
        drive = trip(
            400.0, mass_kg=mass_kg, road=hills, throttle=held, accelerometer=True, seed=seed, unseen_N=gusts
        )
        e = GaussianSum("canest", SENSED).update(drive.block)
        valid = e.status == Status.VALID
        wrong.append((valid & (np.abs(drive.error(e)) > 0.08)).mean())
        share.append(valid[5000:].mean())
    assert np.mean(wrong) < 0.01
    assert np.mean(share) > 0.6
