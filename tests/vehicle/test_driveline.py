"""The engine's speed is the vehicle's only while they turn together."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from vehicle_helpers import FINAL_DRIVE, RADIUS_M, config, ticks

from canest.config.database_files import read_databases
from canest.config.schema import Config
from canest.core.errors import ConfigError
from canest.core.gates import Gate
from canest.pipeline.build import model_spec
from canest.pipeline.signal_map import resolution_of
from canest.vehicle.filtered_model import FilteredModel
from canest.vehicle.model import LongitudinalModel
from canest.vehicle.role_sources import motion_roles, speed_roles
from canest.vehicle.stuck_sensor import StuckSensor

RATIO = 4.0 * FINAL_DRIVE
N = 100


def facts(of):
    return of.signals, of.vehicle


def rpm(speed_mps: float) -> float:
    return speed_mps / RADIUS_M * RATIO * 30 / math.pi


TRUCK: dict[str, Any] = {
    "engine_torque": 500.0,
    "engine_speed": rpm(8.0),
    "gear_ratio": 4.0,
    "driveline_engaged": 1.0,
}


def speed(**changes: Any) -> np.ndarray:
    signals = TRUCK | changes
    return LongitudinalModel(model_spec(config(list(signals)))).process(ticks(signals)).speed_mps


def test_in_gear_it_is() -> None:
    assert speed() == pytest.approx([8.0] * 2)
    assert speed(vehicle_speed=8.4) == pytest.approx([8.0] * 2)
    assert speed(vehicle_speed=math.nan) == pytest.approx([8.0] * 2)
    sent_once = np.array([1.0, math.nan])
    assert speed(driveline_engaged=sent_once) == pytest.approx([8.0] * 2)  # nothing reports that it is not


def test_a_clutch_that_was_never_reported_open_is_closed() -> None:
    """As in a config without a clutch's roles: what is mapped and never sent counts for no more than that."""
    assert np.isnan(speed(driveline_engaged=math.nan)).all()
    assert speed(driveline_engaged=math.nan, vehicle_speed=8.4) == pytest.approx([8.4] * 2)
    one_gear = config(list(TRUCK), vehicle={"gear_ratios": {1: 4.0}})
    raw = LongitudinalModel(model_spec(one_gear)).process(ticks(TRUCK | {"driveline_engaged": math.nan}))
    assert raw.speed_mps == pytest.approx([8.0] * 2)


@pytest.mark.parametrize(
    "parted",
    [
        {"driveline_engaged": 0.0},
        {"lockup_engaged": 0.0},
        {"clutch_switch": 1.0},
        {"clutch_slip": 20.0},
        {"shift_in_process": 1.0},
        {"gear_ratio": 0.0},
        {"gear_ratio": math.nan},
    ],
)
def test_parted_from_the_wheels_it_is_not(parted: dict[str, float]) -> None:
    assert np.isnan(speed(**parted)).all()
    assert speed(**parted, vehicle_speed=5.0) == pytest.approx([5.0] * 2)


@pytest.mark.parametrize("road_mps", [0.0, 5.0, 12.0])
def test_where_the_road_denies_it_the_road_is_right(road_mps: float) -> None:
    assert speed(vehicle_speed=road_mps) == pytest.approx([road_mps] * 2)


def test_an_engine_that_idles_in_gear_with_its_clutch_open_stands() -> None:
    idles = {"engine_speed": 600.0, "gear_ratio": 8.0}  # would be 1 m/s
    assert (speed(**idles, vehicle_speed=0.0) == 0.0).all()


def test_the_only_speed_needs_a_clutch_signal() -> None:
    roles = ["engine_torque", "engine_speed", "gear_ratio"]
    with pytest.raises(ConfigError, match=r"engine_speed is the only speed.*or one of driveline_engaged"):
        speed_roles(*facts(config(roles)))
    assert speed_roles(*facts(config([*roles, "clutch_switch"]))) == ("engine_speed",)
    assert speed_roles(*facts(config(roles, vehicle={"gear_ratios": {1: 9.7}}))) == ("engine_speed",)
    assert speed_roles(*facts(config([*roles, "vehicle_speed"]))) == ("vehicle_speed",)


@pytest.mark.parametrize(
    ("engine_mps", "accel_mps2", "parted"), [(8.0, 0.0, False), (8.8, 0.0, True), (8.3, 1.0, False)]
)
def test_without_a_clutch_signal_a_different_engine_speed_opens_the_driveline(
    engine_mps, accel_mps2, parted
) -> None:
    """A road speed that is late by 0.25 s while the truck gains 1 m/s2 is 0.25 m/s behind."""
    t = np.arange(N) * 0.02
    road = 8.0 + accel_mps2 * (t - t[-1])
    values = {
        "engine_torque": np.full(N, 500.0),
        "engine_speed": rpm(1.0) * (engine_mps - 8.0 + road),
        "gear_ratio": np.full(N, 4.0),
        "vehicle_speed": road,
    }
    gate = FilteredModel(model_spec(config(list(values)))).process(ticks(values, N)).gate
    assert (gate[-1] == Gate.DRIVELINE) == parted


@pytest.mark.parametrize(
    "clutch", [{"clutch_slip": 0.0}, {"lockup_engaged": math.nan}, {"clutch_switch": 0.0}]
)
@pytest.mark.parametrize("engine_mps", [5.0, 10.0, 16.0])
def test_an_engine_that_the_road_denies_drives_nothing(clutch, engine_mps) -> None:
    """Whatever the clutch says of itself: its torque is not at the wheels, or the road speed is frozen."""
    values = TRUCK | {"engine_speed": rpm(engine_mps), "vehicle_speed": 8.0} | clutch
    del values["driveline_engaged"]
    gate = FilteredModel(model_spec(config(list(values)))).process(ticks(values, N)).gate
    assert gate[-1] == Gate.DRIVELINE


def test_where_the_road_takes_over_from_the_engine_the_step_between_them_teaches_nothing() -> None:
    """The step looks like an acceleration, and must not excuse the engine as one that is late does."""
    t = np.arange(2 * N) * 0.02
    engine_mps = 8.0 + np.maximum(t - 2.0, 0.0) * 3.0  # a clutch that begins to slip
    values = TRUCK | {"engine_speed": rpm(1.0) * engine_mps, "vehicle_speed": 8.0}
    block = FilteredModel(model_spec(config(list(values)))).process(ticks(values, 2 * N))
    assert (block.gate[:100] == 0)[-1]
    by_road = block.raw_speed_mps == 8.0
    assert by_road[-1]
    assert (block.gate[by_road & (t > 2.0)] == Gate.DRIVELINE).all()


def test_what_is_not_used_as_a_speed_is_left_out_of_the_range_and_stuck_sensor_checks() -> None:
    """EEC1 and CCVS1: a brake that the road speed shows convicts an accelerometer."""
    roles = ["engine_torque", "engine_speed", "vehicle_speed", "longitudinal_accel"]
    assert motion_roles(*facts(config(roles))) == {"vehicle_speed", "longitudinal_accel"}
    assert motion_roles(*facts(config([*roles, "clutch_slip"]))) == {"engine_speed", "longitudinal_accel"}
    speed = 10.0 - 3.0 * np.clip(np.arange(300) * 0.02 - 3.0, 0.0, 2.0)
    values = {"engine_torque": 0.0, "engine_speed": 900.0, "vehicle_speed": speed, "longitudinal_accel": 0.1}
    silent = StuckSensor(model_spec(config(roles))).mask_stuck(ticks(values, 300))
    assert np.isnan(silent.values["longitudinal_accel"][-1])


def test_the_steps_of_the_speed_in_use_count() -> None:
    """Not the engine's, whose speed is finer than a road's in half miles per hour, where it is not used."""
    few = {
        "engine_speed": {"message": "EEC1", "signal": "EngSpeed"},
        "vehicle_speed": {"message": "CCVS1", "signal": "WheelBasedVehicleSpeed"},
    }
    mapped = config(list(few)).model_dump() | {"dbc": ["j1939.dbc"], "signals": few}
    assert resolution_of(read_databases(Config.model_validate(mapped)))["speed"] == pytest.approx(
        1 / 256 / 3.6
    )
