"""A driveline that swings, and a torque that is noisy: what acts like a force and is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import STEP_S, Status
from canest.estimators.bounds import gain_std
from canest.estimators.default import noise
from canest.estimators.default.constants import CONSTANTS, vehicle_of
from canest.estimators.default.estimator import GaussianSum
from canest.estimators.default.model import MODES, WINDUP, Ends
from canest.estimators.default.sensors import windup_var
from canest.estimators.default.windows import zigzag
from tests.estimators.momentum import FACTS, GEAR_1PM, ROTATING_KG, flat, hills, pulses, trip
from tests.estimators.test_canest_interrupted import NOTHING

U = 1.0 / 20_000.0


def speed_swings(rotating_kg, force_N, seconds=20.0, step_s=2e-4):
    """Two masses and a spring, without damping: std of the moving mass's speed about its mean gain."""
    k_Npm = 1.0 / (CONSTANTS.windup_std_s2 * U)
    moved = np.zeros(2)
    v = np.zeros(2)
    mean_mps2 = force_N / (rotating_kg + 1.0 / U)
    off = np.empty(round(seconds / step_s))
    for i in range(len(off)):
        spring = k_Npm * (moved[0] - moved[1])
        v += step_s * np.array([(force_N - spring) / rotating_kg, spring * U])
        moved += step_s * v
        off[i] = v[1] - mean_mps2 * (i + 1) * step_s
    return off.std()


@pytest.mark.parametrize("rotating_kg", [700.0, 6_000.0, 20_000.0])
def test_a_sudden_torque_swings_as_two_masses_on_a_spring_do(rotating_kg):
    sudden = CONSTANTS._replace(torque_rise_s=0.0)
    w = NOTHING._replace(rotating_kg=rotating_kg)
    var = noise.swing_var.interpreted(0.0, 40_000.0, w, 0.2, U, sudden)
    assert np.sqrt(var) == pytest.approx(speed_swings(rotating_kg, 40_000.0), rel=0.02)


def test_a_swing_dies_away_and_is_small_in_high_gears():
    low, high = (NOTHING._replace(rotating_kg=kg) for kg in (20_000.0, 200.0))
    begun = noise.swing_var.interpreted(0.0, 40_000.0, low, 0.2, U, CONSTANTS)
    later = noise.swing_var.interpreted(begun, 0.0, low, 1.0, U, CONSTANTS)
    assert 0.0 < later < 0.5 * begun
    assert noise.swing_var.interpreted(0.0, 40_000.0, high, 0.2, U, CONSTANTS) < 1e-3 * begun
    assert (
        noise.swing_var.interpreted(0.0, 40_000.0, NOTHING._replace(rotating_kg=0.0), 0.2, U, CONSTANTS)
        == 0.0
    )


def on_soft_shafts(block, windup_mpN, frequency_hz=1.5, damping=0.3):
    """The speed of the engine's side of a driveline that winds up and swings, in place of the vehicle's."""
    omega, twist, rate = 2.0 * np.pi * frequency_hz, block.traction_N[0], 0.0
    rates = np.empty(len(block))
    for i, traction in enumerate(block.traction_N):
        rate += STEP_S * (omega * omega * (traction - twist) - 2.0 * damping * omega * rate)
        twist += STEP_S * rate
        rates[i] = rate
    speed = block.speed_mps + windup_mpN * rates
    accel = np.diff(speed, prepend=speed[0]) / STEP_S
    force = block.traction_N - block.aero_N - ROTATING_KG * accel
    return replace(block, speed_mps=speed, raw_speed_mps=speed, accel_mps2=accel, force_N=force)


def test_a_driveline_that_swings_as_it_winds_up_makes_no_lighter_mass():
    """A lag of 0.2 s does not follow a swing: speeds while torque changes are the less to be believed."""
    drive = trip(300.0, mass_kg=21_000.0, noise=0.3, seed=2, delay_s=0.08)
    estimator = GaussianSum("canest", replace(FACTS, speed_step_mps=0.002))
    estimates = estimator.update(on_soft_shafts(drive.block, 3e-6))
    assert np.abs(drive.error(estimates)[6_000:]).mean() < 0.02


def test_a_stiff_driveline_has_no_course_of_a_windup():
    mix = GaussianSum("canest", FACTS)._mixture
    end = Ends(10.0, 20_000.0, 30_000.0)
    assert windup_var.interpreted(mix, MODES, end) == 0.0
    mix.x[:, WINDUP] = 3e-6
    assert windup_var.interpreted(mix, MODES, end) == pytest.approx((3e-6 * 30_000.0) ** 2 / 3.0)


@pytest.mark.parametrize("held", [1, 2, 5])
def test_the_density_of_white_noise_is_found_however_long_reports_are_held(held):
    rng = np.random.default_rng(3)
    torque = np.repeat(rng.normal(500.0, 20.0, 40_000 // held), held)
    assert zigzag(torque).mean() == pytest.approx(400.0 * held * STEP_S, rel=0.05)


def test_a_torque_that_rises_and_falls_has_no_noise():
    t = np.arange(20_000) * STEP_S
    assert zigzag(800.0 * np.sin(t)).mean() < 0.0
    assert zigzag(np.full(100, 300.0)).max() == 0.0
    unknown = np.where(np.arange(100) % 7 == 0, np.nan, np.arange(100) % 2)
    assert np.isfinite(zigzag(unknown)).all()


def noisy(block, torque_std_Nm, seed=1):
    off_Nm = np.random.default_rng(seed).normal(0.0, torque_std_Nm, len(block))
    traction = block.traction_N + GEAR_1PM * off_Nm
    return replace(
        block,
        traction_N=traction,
        force_N=traction - block.aero_N - ROTATING_KG * block.accel_mps2,
        raw_torque_Nm=traction / GEAR_1PM,
    )


def test_a_noisy_torque_makes_no_heavier_mass():
    """White, 5 % of the most there is, in all that the estimator sees; an accurate speed shows the noise."""
    drive = trip(300.0, road=hills, throttle=pulses, noise=0.1)
    estimator = GaussianSum("canest", replace(FACTS, speed_step_mps=0.002))
    estimates = estimator.update(noisy(drive.block, 80.0))
    error = np.abs(drive.error(estimates))
    assert not ((estimates.status == Status.VALID) & (error > 0.08)).any()
    assert error[-1] < 0.01
    assert estimator._carried.levels.torque_Nm2s == pytest.approx(80.0**2 * STEP_S, rel=0.25)


@pytest.mark.parametrize(("true_kg", "bound"), [(44_000.0, {}), (20_000.0, {"mass_min_kg": 23_000.0})])
def test_no_mass_is_valid_where_the_true_one_is_beyond_a_bound(true_kg, bound):
    facts = replace(FACTS, **bound)
    drive = trip(200.0, mass_kg=true_kg, seed=5)
    estimates = GaussianSum("canest", facts).update(drive.block)
    assert not (estimates.status[3_000:] == Status.VALID).any()
    off = np.abs(drive.error(estimates))[-1] * true_kg
    assert off < 2.0 * estimates.mass_std_kg[-1]


def test_time_without_a_known_speed_counts_as_standing():
    """Key off, while another sender stays awake: the load may be changed."""
    drive = trip(240.0, road=flat, stops=[(100.0, 180.0)], seed=6)
    asleep = (drive.block.t_us > 101e6) & (drive.block.t_us < 179e6)
    nothing = np.where(asleep, np.nan, drive.block.raw_speed_mps)
    block = replace(drive.block, raw_speed_mps=nothing, stopped=drive.block.stopped & ~asleep)
    status = GaussianSum("canest", FACTS).update(block).status
    assert (status[4_500:5_000] == Status.VALID).all()
    assert not (status[5_600:8_900] == Status.VALID).any()


def test_reports_that_are_as_fast_as_windows_are_not_slow():
    for period_s, windows in ((0.0, 0.0), (0.02, 0.0), (0.2, 0.0), (0.21, 2.0), (1.0, 5.0)):
        facts = replace(FACTS, report_period_s=period_s)
        assert vehicle_of(facts, 0.1, CONSTANTS).period_windows == windows


def test_what_innovations_do_not_explain_widens_mass_and_grade():
    """Low-passed innovations of variance 1.5: so are the posterior's variances, but that of the gain."""
    block = trip(60.2).block
    samples = np.arange(len(block))
    found = []
    for nis in (0.8, 1.0, 1.5):
        estimator = GaussianSum("canest", FACTS)
        estimator.update(block[samples < 3_000])
        levels = estimator._carried.levels._replace(low_nis=nis)
        estimator._carried = estimator._carried._replace(levels=levels)
        last = estimator.update(block[samples >= 3_000])
        gain_kg = gain_std(FACTS) * last.mass_kg[-1]
        found.append((last.mass_kg[-1], last.mass_std_kg[-1] ** 2 - gain_kg**2, last.grade_std[-1] ** 2))
    less, usual, more = np.array(found)
    np.testing.assert_allclose(less, usual, rtol=0.01)
    np.testing.assert_allclose(more / usual, [1.0, 1.5, 1.5], rtol=0.01)
