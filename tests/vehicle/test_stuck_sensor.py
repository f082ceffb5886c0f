"""An accelerometer that repeats itself while the speed shows a brake is taken as silent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from vehicle_helpers import FINAL_DRIVE, RADIUS_M, config, ticks

from canest.config.schema import Config
from canest.grid.grid import GridBlock
from canest.pipeline.build import model_spec
from canest.vehicle.stuck_sensor import StuckSensor

N = 1000
T_S = np.arange(N) * 0.02
#: 8 m/s, faster by 0.4 m/s2 from 5 s on
SPEED = 8.0 + 0.4 * np.maximum(T_S - 5.0, 0.0)
RPM_PER_MPS = FINAL_DRIVE / RADIUS_M * 30 / math.pi
#: as sensors are: no two samples are the same
NOISE = 0.02 * np.random.default_rng(5).standard_normal(N)
SHAFT = (SPEED + NOISE) * RPM_PER_MPS
FROM = 300  #: the tick of the freeze
ROLES = ("engine_torque_pct", "engine_speed", "output_shaft_speed", "undriven_speed", "gear", "yaw_rate",
         "longitudinal_accel")  # fmt: skip
#: from 12 s on it brakes, as the sensor feels
BRAKED = SPEED - 1.5 * np.clip(T_S - 12.0, 0.0, 3.0)
ACCEL = np.gradient(BRAKED, T_S) + NOISE


def mapped() -> Config:
    """A bus in which the engine's speed comes with its torque, and the shaft's with the gear."""
    plain = config(ROLES)
    messages = {"engine_torque_pct": "A", "engine_speed": "A", "output_shaft_speed": "B", "gear": "B",
                "longitudinal_accel": "C", "yaw_rate": "C"}  # fmt: skip
    signals = {
        role: source.model_copy(update={"message": messages.get(role, role), "signal": role, "column": None})
        for role, source in plain.signals.items()
    }
    return plain.model_copy(update={"signals": signals})


def drive(**changes: Any) -> GridBlock:
    values = {
        "engine_torque_pct": 50.0,
        "engine_speed": SHAFT,
        "output_shaft_speed": SHAFT,
        "undriven_speed": SPEED,
        "gear": 4.0,
        "yaw_rate": 0.01,
        "longitudinal_accel": NOISE,
    }
    return ticks(values | changes, N)


def frozen(column: np.ndarray, begin: int = FROM, end: int = N) -> np.ndarray:
    still = column.copy()
    still[begin:end] = column[begin]
    return still


def silent(before: GridBlock, after: GridBlock) -> dict[str, np.ndarray]:
    """Return role -> ticks on which it fell silent."""
    lost = {r: np.flatnonzero(np.isnan(after.values[r]) & ~np.isnan(v)) for r, v in before.values.items()}
    return {r: at for r, at in lost.items() if len(at)}


@pytest.mark.parametrize(
    ("shaft", "undriven"),
    [
        (SHAFT, SPEED),
        (frozen(SHAFT), frozen(SPEED + NOISE)),  # nobody moves
        (np.round(SPEED / 0.447) * 0.447 * RPM_PER_MPS, SPEED + NOISE),  # whole miles per hour
        (np.where(T_S < 9, 0.0, SHAFT), np.clip(0.5 * (T_S - 6), 0.0, None)),  # no pulses below 1.5 m/s
        (frozen(SHAFT), np.where(T_S < 9, 8.0, 12.0)),  # a jump is no motion
        (frozen(SHAFT), np.full(N, np.nan)),
    ],
    ids=["moving", "all still", "coarse", "standing", "jump", "alone"],
)
def test_a_speed_that_may_be_true_is_left_alone(shaft: np.ndarray, undriven: np.ndarray) -> None:
    sensor, block = (
        StuckSensor(model_spec(mapped())),
        drive(output_shaft_speed=shaft, undriven_speed=undriven),
    )
    block = ticks(block.values | {"engine_speed": SHAFT}, N)
    assert silent(block, sensor.mask_stuck(block)) == {}
    assert not sensor.stuck_ticks


@pytest.mark.parametrize(
    ("speed", "accel", "stuck"),
    [
        (BRAKED, ACCEL, False),
        (BRAKED, frozen(ACCEL), True),
        (SPEED, frozen(ACCEL), False),  # slower than a road may be
        (np.where(T_S < 12, SPEED, SPEED + 20), frozen(ACCEL), False),  # a jump is no motion
    ],
    ids=["braking", "frozen", "slow", "jump"],
)
def test_an_accelerometer_that_shows_no_braking_is_taken_as_stuck(
    speed: np.ndarray, accel: np.ndarray, stuck: bool
) -> None:
    sensor = StuckSensor(model_spec(mapped()))
    shaft = (speed + NOISE) * RPM_PER_MPS
    block = drive(
        output_shaft_speed=shaft, engine_speed=shaft, longitudinal_accel=accel, undriven_speed=speed
    )
    lost = silent(block, sensor.mask_stuck(block))
    assert set(lost) == ({"longitudinal_accel", "yaw_rate"} if stuck else set())
    if stuck:  # a second of 1.5 m/s2 at the latest, and to the end
        assert 12.0 < T_S[lost["yaw_rate"][0]] < 13.0
        assert lost["yaw_rate"][-1] == N - 1
        assert sensor.stuck_ticks == {"longitudinal_accel": len(lost["yaw_rate"])}


@pytest.mark.parametrize("late_s", [0.0, 0.5, 1.0])
def test_a_sensor_that_is_quiet_while_the_vehicle_stands_is_not_stuck(late_s: float) -> None:
    """It stops from 8 m/s at 1.5 m/s2 after 8 s, and the speed that is used comes late."""
    speed = np.maximum(8.0 - 1.5 * np.maximum(T_S - late_s - 8.0 + 8.0 / 1.5, 0.0), 0.0)
    accel = np.where((T_S > 8.0 - 8.0 / 1.5) & (T_S < 8.0), -1.5 + NOISE, 0.0)
    shaft = speed * RPM_PER_MPS
    sensor = StuckSensor(model_spec(mapped()))
    block = drive(output_shaft_speed=shaft, undriven_speed=speed, longitudinal_accel=accel)
    assert silent(block, sensor.mask_stuck(block)) == {}


def test_any_cut_gives_the_same_bits() -> None:
    still = frozen(frozen(SHAFT), 100, 260)
    gone = np.where((T_S > 12) & (T_S < 12.5), np.nan, SPEED)
    block = drive(
        output_shaft_speed=still - (SPEED - BRAKED) * RPM_PER_MPS,
        engine_speed=frozen(SHAFT, 500, 900),
        undriven_speed=gone,
        longitudinal_accel=frozen(ACCEL, 400, 950),
    )
    whole = StuckSensor(model_spec(mapped())).mask_stuck(block)
    assert len(silent(block, whole)) == 2
    rng = np.random.default_rng(11)
    for pieces in (2, 5, 40, 400):
        cuts = np.sort(rng.choice(np.arange(1, N), pieces, replace=False))
        sensor, rest, at, parts = StuckSensor(model_spec(mapped())), block, 0, []
        for cut in [*cuts.tolist(), N]:
            part, rest = rest.split(cut - at)
            at = cut
            parts.append(sensor.mask_stuck(part))
        for role, column in whole.values.items():
            assert column.tobytes() == np.concatenate([p.values[role] for p in parts]).tobytes(), role
