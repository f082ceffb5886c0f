"""A driveline that winds up and tyres that slip: the driven wheels' speed is not that of the vehicle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock, Status, VehicleFacts
from canest.estimators.default import model as m
from canest.estimators.default import sensors
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.registry import create

from .momentum import MU, trip
from .test_canest_loads_and_roads import STATED
from .test_canest_parts import mixture

KG, ROTATING_KG, INNER = 24_000.0, 6_000.0, 20
#: stiffness and damping of half-shafts of 100 kN m/rad on wheels of half a metre, N/m and N s/m
STIFF_NPM, DAMPING_NSPM = 4e5, 12e3
FACTS = VehicleFacts(
    mass_min_kg=7_000.0, mass_max_kg=44_000.0, has_accelerometer=True, accelerometer_step_mps2=0.1
)


def drive(seconds=400.0, *, slip_per_mps2=0.01, seed=1, undriven=True):
    """Integrate body and driveline, two masses on a spring; the shaft turns with the driveline.

    The gearbox shifts every eleven seconds: the torque is zero for a second, and the driveline swings.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    v = shaft = 14.0
    twist_m = 0.0
    body, engine, pull = np.zeros((3, n))
    dt = STEP_S / INNER
    for i in range(n):
        t_s = i * STEP_S
        level = 0.35 + 0.45 * np.sign(np.sin(t_s / 2.9)) * (v < 22.0) if v < 25.0 else -0.2
        wanted = 0.0 if t_s % 11.0 < 1.0 else max(level, -0.2) * 24_000.0
        pull[i] = (pull[i - 1] if i else 0.0) + (wanted - (pull[i - 1] if i else 0.0)) * STEP_S / 0.3
        for _ in range(INNER):
            between = STIFF_NPM * twist_m + DAMPING_NSPM * (shaft - v)
            shaft += (pull[i] - between) / ROTATING_KG * dt
            v += (between - 3.8 * v * v - KG * GRAVITY_MPS2 * MU) / KG * dt
            twist_m += (shaft - v * (1.0 + slip_per_mps2 * between / KG)) * dt
        body[i], engine[i] = v, shaft
    measured = engine + rng.normal(0, 0.002, n)
    axle = body + rng.normal(0, 0.003, n)
    acceleration = np.gradient(body, STEP_S)
    sensed = acceleration * (1.0 + GRAVITY_MPS2 * 0.005) + 0.05 + rng.normal(0, 0.05, n)
    late = round(0.06 / STEP_S)
    reported = np.concatenate((np.full(late, pull[0]), pull[: n - late]))
    return block_of(measured, axle if undriven else np.full(n, np.nan), sensed, reported)


def block_of(speed, undriven, sensed, pull):
    """Return the samples, gated for the shift and 0.6 s more."""
    n, nan = len(speed), np.full(len(speed), np.nan)
    accel, aero = np.gradient(speed, STEP_S), 3.8 * speed * speed
    gate = np.where(np.arange(n) * STEP_S % 11.0 < 1.6, Gate.SHIFT, Gate.OPEN).astype(np.uint8)
    inertia_N = ROTATING_KG * accel
    return ModelBlock(
        t_us=np.arange(n) * STEP_US, speed_mps=speed, accel_mps2=accel, force_N=pull - aero - inertia_N,
        mu=np.full(n, MU), traction_N=pull, aero_N=aero, force_per_torque_1pm=np.full(n, 30.0),
        rotating_mass_kg=np.full(n, ROTATING_KG), coasting_N=nan, undriven_mps=undriven,
        accelerometer_mps2=sensed, slope=nan, altitude_m=nan, yaw_rate_radps=nan, raw_speed_mps=speed,
        raw_force_N=pull - aero - inertia_N, raw_torque_Nm=pull / 30.0, gear=np.zeros(n), gate=gate,
        restart=np.concatenate(([True], (gate[1:] == 0) & (gate[:-1] != 0))), stopped=np.zeros(n, np.bool_),
        ax_ok=np.ones(n, np.bool_),
    )  # fmt: skip


def errors(block, facts=FACTS, from_s=120.0):
    estimates = create("canest", facts).update(block)
    late = np.arange(len(block)) * STEP_S >= from_s
    return estimates.mass_kg[late] / KG - 1.0, estimates.status[late] == Status.VALID, estimates


@pytest.mark.parametrize("slip_per_mps2", [0.0, 0.01])
@pytest.mark.parametrize("accelerometer", [True, False])
def test_an_undriven_axle_tells_the_mass(accelerometer, slip_per_mps2):
    """By the driven wheels alone masses are 2 to 23 % off here."""
    facts = replace(FACTS, has_accelerometer=accelerometer)
    error, valid, _ = errors(drive(slip_per_mps2=slip_per_mps2), facts)
    assert np.sqrt(np.mean(error**2)) < 0.015
    assert valid.mean() > 0.95


def test_no_wrong_mass_is_valid_without_one():
    error, valid, _ = errors(drive(undriven=False))
    assert (valid & (np.abs(error) > 0.08)).mean() < 0.01


@pytest.mark.parametrize("missing", [(150.0, 152.0), (150.0, 150.3), None])
def test_an_undriven_axle_that_is_lost_is_no_surprise(missing):
    """It goes by tyres that are 3 % smaller: each balance has one speed from end to end. None: it flaps."""
    shifts = [(20.0 * k, 20.0 * k + 1.0) for k in range(1, 20)]
    whole = trip(400, mass_kg=21_000.0, shifts=shifts)
    t_s = np.arange(len(whole.block)) * STEP_S
    is_lost = t_s % 1.0 < 0.5 if missing is None else (t_s >= missing[0]) & (t_s < missing[1])
    axle = np.where(is_lost, np.nan, 1.03 * whole.block.speed_mps)
    estimates = create("canest", STATED).update(replace(whole.block, undriven_mps=axle))
    late = t_s >= 120.0
    assert np.abs(whole.error(estimates)[late]).max() < 0.05
    assert (estimates.status[late] == Status.VALID).mean() > 0.95


def test_the_speed_of_all_that_moves_is_that_of_its_momentum():
    window = m.Window(*[0.0] * len(m.Window._fields))._replace(speed_mps=11.0, undriven_mps=10.0)
    ratio = 6_000.0 / 24_000.0
    both = sensors.momentum_speed.interpreted(window, ratio, True)
    assert (24_000.0 + 6_000.0) * both == pytest.approx(24_000.0 * 10.0 + 6_000.0 * 11.0)
    assert sensors.momentum_speed.interpreted(window, ratio, False) == 11.0


def test_closed_gates_teach_no_pitch():
    mix, space = mixture(2)
    before = mix.x[:2, m.PITCH].copy(), mix.P[:2, m.PITCH, m.PITCH].copy(), mix.x[:2, m.GRADE].copy()
    sensors.accelerometer(
        mix, 2, False, (0.7, 1.3, 0.0, 0.0, 0.0, 0.0), 0.2, (0.08, 0.02), CONSTANTS, space.scratch
    )
    np.testing.assert_array_equal(mix.x[:2, m.PITCH], before[0])
    np.testing.assert_array_equal(mix.P[:2, m.PITCH, m.PITCH], before[1])
    assert (mix.x[:2, m.GRADE] != before[2]).all()
