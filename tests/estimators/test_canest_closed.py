"""What the speeds say of the acceleration where no state holds the speed gained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.gates import Gate
from canest.core.samples import STEP_S
from canest.estimators.default import model as m
from canest.estimators.default import sensors
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.default.model import Window
from canest.estimators.registry import create
from canest.estimators.windowing import WINDOW_S

from .momentum import FACTS, flat, pulses, trip
from .test_canest_parts import mixture


def test_the_acceleration_gained_has_mean_and_variance_of_a_drawn_delay():
    """dv/dt - delta dT/dt / (1 + u J), of delays drawn from the mixture."""
    mix, space = mixture(3)
    rng, u, rotating_kg, drawn = np.random.default_rng(4), 1 / 20_000, 4_000.0, []
    shares = (0.2, 0.3, 0.5)
    for d in range(3):
        mix.weight[d], mix.x[d, m.DELAY] = shares[d], (0.05, -0.1, 0.15)[d] * u
        mix.P[d, m.DELAY, m.DELAY] = (0.02 * (d + 1) * u) ** 2
        n = round(200_000 * shares[d])
        drawn.append(rng.normal(mix.x[d, m.DELAY], np.sqrt(mix.P[d, m.DELAY, m.DELAY]), n))
    w = Window(**{**dict.fromkeys(Window._fields, 0.0), "accel_mps2": -0.4, "begin_N": 3_000.0,
                  "traction_N": -5_000.0, "rotating_kg": rotating_kg})  # fmt: skip
    mean, var = sensors.gained(mix, 3, w, 1e-4, u, CONSTANTS, space.scratch)
    delays = np.concatenate(drawn)
    off = delays * -8_000.0 / WINDOW_S / (1.0 + u * rotating_kg)
    assert mean == pytest.approx(-0.4 - off.mean(), abs=2e-3)
    noise = 2.0 * 1e-4 / WINDOW_S**2
    assert var == pytest.approx(noise + CONSTANTS.hidden_windows * off.var(), rel=0.01)


@pytest.mark.parametrize(("noise_mps", "most"), [(0.01, 0.0023), (0.04, 0.0062)])
def test_noise_of_a_speed_is_no_rough_road_while_gates_are_closed(noise_mps, most):
    """A flat road; a power take-off closes the gates, so only accelerometer and speed say how steep it is."""
    sensed = replace(FACTS, has_accelerometer=True, accelerometer_step_mps2=0.01)
    drive = trip(140, road=flat, throttle=pulses, accelerometer=True, noise=noise_mps / 0.002, seed=3)
    gate = drive.block.gate.copy()
    gate[5_000:7_000] = Gate.PTO
    estimates = create("canest", sensed).update(replace(drive.block, gate=gate))
    off = (estimates.grade - drive.grade)[5_100:7_000]
    assert np.sqrt(np.mean(off**2)) < most


@pytest.mark.parametrize("seed", [4, 6, 7, 8])
def test_an_accelerometer_finer_than_its_noise_fixes_no_bias_at_first(seed):
    """Noise of 25 steps. Where the level began at a step, grades were up to 1.8 degrees off, by six std."""
    sensed = replace(FACTS, has_accelerometer=True, accelerometer_step_mps2=0.01)
    drive = trip(100, road=flat, throttle=pulses, accelerometer=True, noise=20.0, seed=seed)
    estimates = create("canest", sensed).update(drive.block)
    off = np.abs(estimates.grade - drive.grade)[2_500:]
    assert (off < 3.0 * estimates.grade_std[2_500:]).mean() > 0.99


def test_before_a_gate_has_opened_the_mass_is_the_one_that_was_configured():
    """A closed window with an accelerometer made 12 t of 30, of an unknown load's mixture."""
    sensed = replace(FACTS, has_accelerometer=True, accelerometer_step_mps2=0.01, initial_mass_kg=30_000.0)
    drive = trip(20, road=flat, throttle=pulses, accelerometer=True, seed=1)
    closed = np.full(len(drive.block), Gate.PTO, np.uint8)
    estimates = create("canest", sensed).update(replace(drive.block, gate=closed))
    assert (estimates.mass_kg == 30_000.0).all()


def test_a_coasting_lies_behind_the_vehicle_however_long_slow_signals_are_waited_for():
    """Waiting delays raw and filtered columns alike: only the grade that is reported is carried further."""
    drive = trip(120.0, throttle=pulses, shifts=[(30.0, 31.0), (60.0, 61.0), (90.0, 91.0)], seed=3)
    waited = replace(FACTS, filter_delay_s=FACTS.filter_delay_s + 1.2, waits_s=1.2)
    at_once, later = (create("canest", facts).update(drive.block) for facts in (FACTS, waited))
    assert np.isfinite(drive.block.coasting_N).any()
    np.testing.assert_allclose(later.mass_kg, at_once.mass_kg, rtol=1e-9)
    assert (later.grade != at_once.grade).any()


def braking_hill(acts_N):
    """A flat road; a retarder takes a force for half a minute, and reports that it acts."""
    drive = trip(120, road=flat, unreported=(60.2, 89.0, acts_N), seed=5)
    gate = drive.block.gate.copy()
    gate[3_000:4_500] = Gate.RETARDER
    return replace(drive.block, gate=gate)


def test_a_retarder_of_unknown_force_says_nothing_of_the_road():
    """Its config states no reference torque: the force has nothing of what it takes."""
    block = braking_hill(6_000.0)
    unknown = create("canest", replace(FACTS, knows_retarder=False)).update(block)
    braked = create("canest", FACTS).update(
        replace(block, gate=np.where(block.gate == Gate.RETARDER, Gate.BRAKE, block.gate))
    )
    np.testing.assert_array_equal(unknown.grade, braked.grade)
    np.testing.assert_array_equal(unknown.mass_kg, braked.mass_kg)
    assert (np.abs(unknown.grade) < 3.0 * unknown.grade_std)[3_000:].all()


def test_a_retarder_of_known_force_says_what_the_road_is():
    """The same, and the force has what it takes: the grade is known while it acts."""
    block = braking_hill(6_000.0)
    seconds = np.arange(len(block)) * STEP_S
    taken = np.where((seconds >= 60.2) & (seconds < 89.0), 6_000.0, 0.0)
    known = replace(
        block, **{name: getattr(block, name) - taken for name in ("force_N", "raw_force_N", "traction_N")}
    )
    estimates = create("canest", FACTS).update(known)
    assert np.abs(estimates.grade[3_200:4_500]).max() < 0.01
    assert estimates.grade_std[3_200:4_500].max() < 0.01


@pytest.mark.parametrize("phase", range(10))
def test_a_retarder_after_a_bend_that_nobody_measures_leaves_numbers(phase):
    """A bend is looked for further back than a retarder: what it brakes is not known, so no window counts."""
    drive = trip(60, road=flat, throttle=pulses)
    gate = drive.block.gate.copy()
    bend = 2_000 + phase
    gate[bend - 100 : bend], gate[bend : bend + 100] = Gate.TURNING, Gate.RETARDER
    given = {
        yaw: create("canest", FACTS).update(
            replace(drive.block, gate=gate, yaw_rate_radps=np.full(len(gate), yaw))
        )
        for yaw in (np.nan, 0.0)
    }
    assert np.isfinite(given[np.nan].mass_kg[-1])
    assert given[np.nan].mass_kg[-1] == pytest.approx(given[0.0].mass_kg[-1], rel=2e-3)
    assert given[np.nan].grade[-1] == pytest.approx(given[0.0].grade[-1], abs=2e-4)


def test_altitudes_in_reverse_are_those_of_the_way_back():
    """Up a slope of 5 % and 120 m back down it, gate closed: the grade of the vehicle stays as it was."""
    drive = trip(100, road=lambda s: 0.05 + 0.0 * s, throttle=lambda t, v: 0.7 + 0.25 * np.sin(t / 2.2))
    back = slice(3_000, 5_000)
    gate, gear, speed = drive.block.gate.copy(), np.ones(5_000), drive.block.speed_mps.copy()
    gate[back], gear[back], speed[back] = Gate.REVERSE, -1.0, 3.0
    accel = np.where(gear > 0.0, drive.block.accel_mps2, 0.0)
    height = 200.0 + 0.05 * np.cumsum(speed * gear) * STEP_S
    block = replace(
        drive.block, gate=gate, gear=gear, speed_mps=speed, raw_speed_mps=speed, accel_mps2=accel,
        altitude_m=np.repeat(height[::50], 50),
    )  # fmt: skip
    grade = create("canest", FACTS).update(block).grade
    assert grade[2_990] == pytest.approx(0.05, abs=2e-3)
    assert grade[-1] == pytest.approx(grade[2_990], abs=1e-3)
