"""The filtered columns: the model's relation holds in them exactly, and damage never stays in them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vehicle_helpers import (
    DENSITY,
    DRAG_AREA_M2,
    EFFICIENCY,
    ENGINE_INERTIA,
    FINAL_DRIVE,
    MU,
    RADIUS_M,
    WHEEL_INERTIA,
    config,
    ticks,
)

from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S
from canest.pipeline.build import model_spec
from canest.vehicle.filtered_model import FilteredModel

RATIO = 2.0 * FINAL_DRIVE
ROLES = ("engine_torque", "vehicle_speed")
FIXED_GEAR = {"gear_ratios": {1: 2.0}}
WHEELS_KG = WHEEL_INERTIA / RADIUS_M**2
CRANK_KG = ENGINE_INERTIA * RATIO**2 / RADIUS_M**2


def torque_for(
    speed: np.ndarray, mass_kg: float, grade: float, crr_per_mps: float = 0.0, efficiency: float = EFFICIENCY
) -> np.ndarray:
    """Crank torque that moves a vehicle so: from the road through wheels and gearbox to the crank."""
    beta = math.atan(grade)
    accel = np.diff(speed, prepend=speed[0]) / STEP_S
    road = GRAVITY_MPS2 * (math.sin(beta) + (MU + crr_per_mps * speed) * math.cos(beta))
    aero = 0.5 * DENSITY * DRAG_AREA_M2 * speed * np.abs(speed)
    at_wheels = mass_kg * (accel + road) + WHEELS_KG * accel + aero
    at_gearbox = at_wheels * RADIUS_M / RATIO / np.where(at_wheels < 0, 1 / efficiency, efficiency)
    return at_gearbox + ENGINE_INERTIA * RATIO / RADIUS_M * accel


@settings(max_examples=120, deadline=None)
@given(
    power=st.sampled_from(("drive", "overrun", "both, without losses")),
    mass_kg=st.floats(8_000, 32_000),
    grade=st.floats(-0.12, 0.12),
    accel=st.lists(st.floats(-1.5, 1.5), min_size=60, max_size=120),
    order=st.integers(1, 6),
    cutoff_hz=st.floats(0.5, 20.0),
    cut=st.integers(1, 59),
    crr_per_mps=st.sampled_from((0.0, 2e-4)),
)
def test_the_relation_holds_exactly_for_constant_mass_and_grade(
    power: str,
    mass_kg: float,
    grade: float,
    accel: list[float],
    order: int,
    cutoff_hz: float,
    cut: int,
    crr_per_mps: float,
) -> None:
    # losses are no linear filter: while the power changes its direction the relation is an approximation
    if power == "both, without losses":
        efficiency = k = 1.0
    else:  # steep enough that no ringing of a filter changes the direction either
        efficiency, k, sign = (
            (EFFICIENCY, EFFICIENCY, 1) if power == "drive" else (EFFICIENCY, 1 / EFFICIENCY, -1)
        )
        accel, grade = [0.3 * sign * abs(a) for a in accel], sign * (0.07 + 0.5 * abs(grade))
    speed = 15 + np.cumsum(accel) * STEP_S
    torque = torque_for(speed, mass_kg, grade, crr_per_mps, efficiency)
    effects = [{"effect": "rolling_resistance_speed", "crr_per_mps": crr_per_mps}] if crr_per_mps else []
    regression = FilteredModel(
        model_spec(
            config(
                ROLES,
                effects,
                vehicle={**FIXED_GEAR, "driveline_efficiency": efficiency},
                filter={"order": order, "cutoff_hz": cutoff_hz},
            )
        )
    )
    n = len(speed)
    first = regression.process(ticks({"engine_torque": torque[:cut], "vehicle_speed": speed[:cut]}, cut))
    second = regression.process(
        ticks({"engine_torque": torque[cut:], "vehicle_speed": speed[cut:]}, n - cut, cut, continues=True)
    )
    beta = math.atan(grade)
    for block in (first, second):
        gravity = GRAVITY_MPS2 * (math.sin(beta) + block.mu * math.cos(beta))
        left = mass_kg * (block.accel_mps2 + gravity)
        scale = np.abs(block.raw_force_N).max() + mass_kg * GRAVITY_MPS2
        assert np.abs(left - block.force_N).max() < 1e-9 * scale
        # the drag is filtered as the force is: what is left of it is traction and what rotates
        rest = block.traction_N - block.aero_N - (WHEELS_KG + k * CRANK_KG) * block.accel_mps2
        assert np.abs(rest - block.force_N).max() < 1e-9 * scale


@pytest.mark.parametrize("noise_mps", [0.0, 0.01])
def test_losses_of_a_power_that_changes_its_direction(noise_mps: float) -> None:
    """What the filter's delay and noise of the speed leave of the losses is small beside the losses."""
    mass_kg, n = 12_000.0, 1000
    accel = 0.8 * np.sin(np.arange(n) * 2 * math.pi / 250)
    speed = 15 + np.cumsum(accel) * STEP_S
    torque = torque_for(speed, mass_kg, 0.0)
    noise = np.random.default_rng(4).normal(0.0, noise_mps, n)
    block = FilteredModel(model_spec(config(ROLES, vehicle=FIXED_GEAR))).process(
        ticks({"engine_torque": torque, "vehicle_speed": speed + noise}, n)
    )
    residual = block.force_N - mass_kg * (block.accel_mps2 + GRAVITY_MPS2 * MU)
    lost = (1 / EFFICIENCY - EFFICIENCY) * np.abs(block.traction_N).mean()
    assert abs(residual[250:].mean()) < 0.01 * lost


def test_noise_of_the_speed_is_not_taken_for_a_power_that_loses() -> None:
    """In first gear 0.01 m/s between ticks are some kN of inertia; rectified they would be a steady loss."""
    n = 2000
    speed = 2.0 + np.random.default_rng(4).normal(0.0, 0.01, n)
    block = FilteredModel(model_spec(config(ROLES, vehicle={"gear_ratios": {1: 8.0}}))).process(
        ticks({"engine_torque": 0.0, "vehicle_speed": speed}, n)
    )
    assert (block.raw_force_N + block.aero_N)[50:].mean() < -500  # rectified
    assert abs((block.force_N + block.aero_N)[50:].mean()) < 50


def test_in_overrun_the_gear_is_the_same() -> None:
    """Though a torque makes more force there, by the losses twice: as much as in the next gear down."""
    gears = {5: 1.0, 6: 1.0 * EFFICIENCY**1.5}
    n = 400
    block = FilteredModel(model_spec(config((*ROLES, "gear"), vehicle={"gear_ratios": gears}))).process(
        ticks(
            {
                "engine_torque": np.where(np.arange(n) < 200, 500.0, -150.0),
                "vehicle_speed": 15.0,
                "gear": 6.0,
            },
            n,
        )
    )
    assert set(block.gear.tolist()) == {6.0}


def test_the_rotating_mass_and_so_the_momentum_does_not_jump_in_overrun() -> None:
    n = 400
    speed = 15 + np.cumsum(np.where(np.arange(n) < 200, 0.5, -0.5)) * STEP_S
    block = FilteredModel(model_spec(config(ROLES, vehicle=FIXED_GEAR))).process(
        ticks({"engine_torque": np.where(np.arange(n) < 200, 500.0, -150.0), "vehicle_speed": speed}, n)
    )
    assert block.rotating_mass_kg == pytest.approx(WHEELS_KG + EFFICIENCY * CRANK_KG)
    assert block.force_per_torque_1pm[[100, 300]] == pytest.approx(
        [EFFICIENCY * RATIO / RADIUS_M, RATIO / RADIUS_M / EFFICIENCY]
    )


@pytest.mark.parametrize("cuts", [(), (7, 100, 101, 250)])
def test_an_engine_that_keeps_its_speed_takes_no_torque_for_itself(cuts: tuple[int, ...]) -> None:
    """No steps: 200 rad/s while the vehicle gains 1 m/s2, and from the middle on one ratio."""
    n, radps = 400, 200.0
    speed = 10.0 + np.arange(n) * STEP_S
    ratio = radps * RADIUS_M / speed / FINAL_DRIVE
    ratio[200:] = ratio[200]
    engine = np.where(np.arange(n) < 200, radps, ratio * FINAL_DRIVE * speed / RADIUS_M)
    rpm = engine * 30.0 / math.pi
    values = {"engine_torque": 500.0, "vehicle_speed": speed, "gear_ratio": ratio, "engine_speed": rpm}
    model = FilteredModel(model_spec(config(tuple(values), vehicle={"gear_ratios": {}})))
    edges, blocks = (0, *cuts, n), []
    for k, (a, b) in enumerate(pairwise(edges)):
        part = {role: x if isinstance(x, float) else x[a:b] for role, x in values.items()}
        blocks.append(model.process(ticks(part, b - a, a, k > 0)))
    force = np.concatenate([block.raw_force_N + block.aero_N for block in blocks])
    lever = ratio * FINAL_DRIVE / RADIUS_M
    gains = np.where(np.arange(n) > 200, ENGINE_INERTIA * lever, 0.0)  # rad/s2 by rad/s2 of the crank, 1 m/s2
    expected = EFFICIENCY * lever * (500.0 - gains) - WHEELS_KG
    np.testing.assert_allclose(force[2:], expected[2:], rtol=5e-3)  # the wheels slip


def test_the_filtered_acceleration_is_the_difference_of_the_filtered_speed() -> None:
    speed = 15 + np.cumsum(np.random.default_rng(3).standard_normal(100)) * 0.01
    block = FilteredModel(model_spec(config(ROLES, vehicle=FIXED_GEAR))).process(
        ticks({"engine_torque": 500.0, "vehicle_speed": speed}, 100)
    )
    assert block.accel_mps2[0] == 0.0
    assert np.array_equal(block.accel_mps2[1:], np.diff(block.speed_mps) / STEP_S)
    assert np.array_equal(block.raw_speed_mps, speed)


@pytest.mark.parametrize("damage", [math.nan, math.inf, -math.inf, 1e300, -1e308, 1e200])
@pytest.mark.parametrize("role", ["engine_torque", "vehicle_speed", "longitudinal_accel", "undriven_speed"])
def test_damage_leaves_no_trace_in_the_filters(role: str, damage: float) -> None:
    roles = (*ROLES, "longitudinal_accel", "undriven_speed")
    values = dict(zip(roles, (500.0, 15.0, 0.2, 15.0), strict=True))
    column = np.full(300, values[role])
    column[50:60] = damage
    block = FilteredModel(model_spec(config(roles, vehicle=FIXED_GEAR))).process(
        ticks(values | {role: column}, 300)
    )
    assert np.isfinite(block.speed_mps).all()
    assert np.isfinite(block.force_N).all()
    assert np.isfinite(block.traction_N).all()
    assert block.force_N[-1] == pytest.approx(block.force_N[49], rel=1e-9)
    assert block.speed_mps[-1] == pytest.approx(15.0, rel=1e-9)
    assert block.accelerometer_mps2[-1] == pytest.approx(0.2, rel=1e-9)
    assert block.undriven_mps[-1] == pytest.approx(15.0, rel=1e-9)
    assert np.isnan(block.accelerometer_mps2[50:60]).all() == (role == "longitudinal_accel")
    if role in ROLES and not math.isnan(damage):  # without a speed of its own it takes the undriven one
        assert (block.gate[50:60] != 0).all()


def test_a_lost_torque_stops_neither_speed_nor_acceleration() -> None:
    """An accelerometer less an acceleration that has stopped with the torque would be read as a hill."""
    speed = 15 + 0.5 * np.arange(400) * STEP_S
    torque = np.full(400, 500.0)
    torque[100:300] = math.nan
    roles = (*ROLES, "longitudinal_accel")
    values = {"engine_torque": torque, "vehicle_speed": speed, "longitudinal_accel": 0.5}
    whole = FilteredModel(model_spec(config(roles, vehicle=FIXED_GEAR))).process(
        ticks(values | {"engine_torque": 500.0}, 400)
    )
    lost = FilteredModel(model_spec(config(roles, vehicle=FIXED_GEAR))).process(ticks(values, 400))
    np.testing.assert_array_equal(lost.speed_mps, whole.speed_mps)
    np.testing.assert_array_equal(lost.accel_mps2, whole.accel_mps2)
    assert lost.ax_ok.all()
    assert (lost.gate[100:300] == Gate.INVALID).all()


def test_standing_and_what_is_not_measured() -> None:
    block = FilteredModel(model_spec(config(ROLES, vehicle=FIXED_GEAR))).process(
        ticks({"engine_torque": 0.0, "vehicle_speed": [0.0, 0.1, 0.3, math.nan]}, 4)
    )
    assert block.stopped.tolist() == [True, True, False, False]
    for name in ("undriven_mps", "accelerometer_mps2", "slope", "altitude_m", "yaw_rate_radps"):
        assert np.isnan(getattr(block, name)).all()
    assert not block.ax_ok.any()


def test_backwards_an_accelerometer_is_not_used() -> None:
    roles = (*ROLES, "gear", "longitudinal_accel")
    signals = {
        "engine_torque": 500.0,
        "vehicle_speed": 3.0,
        "gear": [1.0, 1.0, -1.0],
        "longitudinal_accel": 0.2,
    }
    block = FilteredModel(model_spec(config(roles))).process(ticks(signals, 3))
    assert block.ax_ok.tolist() == [True, True, False]


@pytest.mark.parametrize("cut", [[], [40], [61, 62, 90]])
@pytest.mark.parametrize(("speed", "counts"), [("engine_speed", False), ("vehicle_speed", True)])
def test_an_engines_speed_is_not_the_vehicles_in_a_shift_or_until_it_has_settled(speed, counts, cut) -> None:
    roles = (
        "engine_torque", speed, "gear_ratio", "driveline_engaged", "shift_in_process", "longitudinal_accel"
    )  # fmt: skip
    shift = np.zeros(200)
    shift[50:70] = 1.0
    turning = 15.0 if speed == "vehicle_speed" else 15.0 / RADIUS_M * RATIO * 30.0 / np.pi
    n, marks = 200, [0, *cut, 200]
    values = {
        "engine_torque": np.full(n, 500.0),
        speed: np.full(n, turning),
        "gear_ratio": np.full(n, 2.0),
        "driveline_engaged": np.ones(n),
        "shift_in_process": shift,
        "longitudinal_accel": np.full(n, 0.2),
    }
    regression = FilteredModel(model_spec(config(roles, gates={"shift": {"recovery_s": 1.0}})))
    used = []
    for a, b in pairwise(marks):
        part = ticks({k: v[a:b] for k, v in values.items()}, b - a, a, continues=a > 0)
        used.extend(regression.process(part).ax_ok.tolist())
    parted = [i for i, ok in enumerate(used) if not ok]
    assert parted == ([] if counts else list(range(50, 120)))


def test_a_slope_sensor_gives_the_tangent() -> None:
    block = FilteredModel(model_spec(config((*ROLES, "pitch"), vehicle=FIXED_GEAR))).process(
        ticks({"engine_torque": 0.0, "vehicle_speed": 5.0, "pitch": [0.05, -0.1]})
    )
    assert block.slope == pytest.approx([math.tan(0.05), math.tan(-0.1)])


@pytest.mark.parametrize("signals", [{"engine_speed": 1500.0}, {"lockup_engaged": 0.0}])
def test_torque_at_the_wheels_is_gated_by_no_driveline(signals: dict[str, float]) -> None:
    """It has passed clutch and converter: no ratio is needed, and no slip counts."""
    n = 400
    roles = ("wheel_torque", "vehicle_speed", *signals)
    block = FilteredModel(model_spec(config(roles, vehicle={"gear_ratios": {}}))).process(
        ticks({"wheel_torque": 3000.0, "vehicle_speed": 15.0, **signals}, n)
    )
    assert set(block.gate[100:].tolist()) == {0}
    assert block.raw_speed_mps[-1] == 15.0


def test_a_smaller_wheel_is_no_contradiction() -> None:
    n = 400
    effects = ({"effect": "wheel_radius", "factor": 0.8},)
    block = FilteredModel(model_spec(config(ROLES, effects, vehicle=FIXED_GEAR))).process(
        ticks({"engine_torque": 500.0, "vehicle_speed": 25.0}, n)
    )
    assert set(block.gate[100:].tolist()) == {0}
