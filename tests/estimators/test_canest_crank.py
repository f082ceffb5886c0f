"""Torque at the crank that no message reports: accessories, cold oil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import STEP_S, Status
from canest.estimators.default import model as m
from canest.estimators.default import predict
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.registry import create

from .momentum import hills, trip
from .test_canest_loads_and_roads import STATED
from .test_canest_parts import mixture

STOPS = [(40.0 + 50.0 * k, 46.0 + 50.0 * k) for k in range(6)]
SENSED = replace(STATED, has_accelerometer=True)


def lever_1pm(t):
    """Force per torque at the crank: a low gear after every stop."""
    return 45.0 if any(end <= t < end + 12.0 for _, end in STOPS) else 9.0


def test_accessories_that_nobody_reports_make_no_wrong_mass():
    """60 Nm are 2.7 kN of a launch. Without the state 5 % of the valid samples are wrong."""
    drive = trip(
        340,
        mass_kg=14_000.0,
        road=hills,
        accelerometer=True,
        stops=STOPS,
        unseen_N=lambda t: 60.0 * lever_1pm(t),
        start_mps=12.0,
    )
    levers = np.array([lever_1pm(t) for t in np.arange(len(drive.block)) * 0.02])
    estimates = create("canest", SENSED).update(replace(drive.block, force_per_torque_1pm=levers))
    late = slice(60 * 50, None)
    valid = estimates.status[late] == Status.VALID
    error = np.abs(drive.error(estimates)[late][valid])
    assert valid.mean() > 0.55
    assert error.max() < 0.08 and np.median(error) < 0.006


@pytest.mark.parametrize("mass_kg", [12_000.0, 16_000.0])
def test_an_air_conditioning_that_switches_is_no_load(mass_kg):
    """80 Nm for 20 s, none for 20 s. Without the hypothesis 6 % of the valid samples are wrong."""
    drive = trip(
        340,
        mass_kg=mass_kg,
        road=lambda s: 0.4 * hills(s),
        accelerometer=True,
        stops=STOPS,
        unseen_N=lambda t: 80.0 * ((t // 20.0) % 2.0) * lever_1pm(t),
        start_mps=12.0,
    )
    levers = np.array([lever_1pm(t) for t in np.arange(len(drive.block)) * 0.02])
    estimates = create("canest", SENSED).update(replace(drive.block, force_per_torque_1pm=levers))
    late = slice(60 * 50, None)
    valid = estimates.status[late] == Status.VALID
    assert valid.mean() > 0.5
    assert (np.abs(drive.error(estimates)[late][valid]) > 0.08).mean() < 0.005


GEARS_1PM = (30.0, 22.0, 15.0, 10.0)
ROUND_S, GEAR_S, SHIFT_S = 60.0, 7.0, 0.8
SHIFTS = [
    (begin + gear * GEAR_S, begin + gear * GEAR_S + SHIFT_S)
    for begin in np.arange(0.0, 600.0, ROUND_S)
    for gear in range(1, len(GEARS_1PM))
]


def in_gear_1pm(t):
    """Upshifts through four gears after a stop, the last one kept."""
    return GEARS_1PM[min(int(t % ROUND_S / GEAR_S), len(GEARS_1PM) - 1)]


@pytest.mark.parametrize("accelerometer", [False, True])
def test_accessories_that_nobody_reports_are_learned_from_shifts(accelerometer):
    """40 Nm are a slope of 0.6 % in the lowest gear and of 0.2 % in the highest."""
    parted = np.zeros(round(600.0 / STEP_S), np.bool_)
    for begin, end in SHIFTS:
        parted[round(begin / STEP_S) : round(end / STEP_S)] = True
    drive = trip(
        600.0,
        throttle=lambda t, v: float(np.clip(0.3 + 0.3 * np.sin(t / 2.2) + 0.05 * (9.0 - v), -0.03, 0.85)),
        stops=[(begin - 6.0, begin) for begin in np.arange(ROUND_S, 600.0, ROUND_S)],
        shifts=SHIFTS,
        unseen_N=lambda t: 0.0 if parted[round(t / STEP_S)] else 40.0 * in_gear_1pm(t),
        accelerometer=accelerometer,
        start_mps=1.0,
    )
    levers = np.array([in_gear_1pm(t) for t in np.arange(len(drive.block)) * STEP_S])
    facts = replace(SENSED, has_accelerometer=accelerometer, unreported_torque_Nm=20.0)
    block = replace(drive.block, force_per_torque_1pm=levers, coasting_N=np.full(len(levers), np.nan))
    estimates = create("canest", facts).update(block)
    late = (drive.block.gate == 0) & (np.arange(len(levers)) > 6_000)
    off = (estimates.grade - drive.grade)[late]
    assert abs(off.mean()) < 4e-4
    assert np.abs(drive.error(estimates)[late]).max() < 0.015


@pytest.mark.parametrize(("lacks_Nm", "most_Nm"), [(0.0, 60.0), (30.0, 60.0), (60.0, 60.0)])
def test_half_of_what_accessories_may_take_is_taken_off(lacks_Nm, most_Nm):
    """In one gear, of a known mass: nothing tells what accessories take from a slope."""
    drive = trip(60.0, throttle=lambda t, v: 0.4, unseen_N=lambda t: lacks_Nm * 9.0, start_mps=15.0)
    facts = replace(SENSED, has_accelerometer=False, unreported_torque_Nm=0.5 * most_Nm)
    estimator = create("canest", facts)
    estimator.restore(drive.mass_kg[0], 0.002 * drive.mass_kg[0])
    e = estimator.update(replace(drive.block, force_per_torque_1pm=np.full(len(drive.block), 9.0)))
    off = (e.grade - drive.grade)[1_500:]
    slope = (0.5 * most_Nm - lacks_Nm) * 9.0 / (drive.mass_kg[0] * 9.80665)
    assert np.median(off) == pytest.approx(-slope, abs=7e-4)
    assert (np.abs(off) < 2.0 * e.grade_std[1_500:]).all()


def test_it_fades_in_time_to_its_prior():
    mix, space = mixture(3)
    for _ in range(300):
        predict.fade(mix, 3, 0.0, 60.0, (0.0, 0.0, 10.0 / 20_000.0), CONSTANTS, space.scratch)
    assert mix.P[:3, m.OFFSET, m.OFFSET] == pytest.approx([(10.0 / 20_000.0) ** 2] * 3, rel=1e-4)
