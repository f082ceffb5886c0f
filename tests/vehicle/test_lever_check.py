"""Speeds that contradict the declared ratio or radius leave a std; those that agree leave none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from vehicle_helpers import FINAL_DRIVE, RADIUS_M, config, ticks

from canest.core.frames import FloatColumn
from canest.pipeline.build import model_spec
from canest.vehicle.filtered_model import FilteredModel

V = 20.0
RPM = V / RADIUS_M * FINAL_DRIVE * 30 / math.pi
COMMON: dict[str, Any] = {"engine_torque_pct": 40.0, "gear_ratio": 1.0}
SHAFT = COMMON | {"output_shaft_speed": RPM, "undriven_speed": V}
ENGINE = COMMON | {"engine_speed": RPM, "vehicle_speed": V, "clutch_switch": 0.0}
WHEELS = {"wheel_torque": 9000.0, "vehicle_speed": V, "gps_speed": V}


def lever_std(signals: dict[str, Any], n: int = 1500, cut: int = 0, **vehicle: Any) -> FloatColumn | None:
    """Return the column of n ticks in gear, cut in two."""
    model = FilteredModel(model_spec(config(list(signals), vehicle=vehicle)))
    parts = [(0, cut), (cut, n)] if cut else [(0, n)]
    found = []
    for begin, end in parts:
        own = {role: v[begin:end] if np.ndim(v) else v for role, v in signals.items()}
        found.append(model.process(ticks(own, end - begin, begin, begin > 0)).lever_std)
    return None if found[0] is None else np.concatenate(found)


@pytest.mark.parametrize("signals", [SHAFT, ENGINE], ids=["shaft", "engine"])
@pytest.mark.parametrize("times", [0.96, 1.05])
def test_a_wrong_radius_leaves_what_is_beyond_three_percent(signals: dict[str, Any], times: float) -> None:
    std = lever_std(signals, wheel_radius_m=RADIUS_M * times)
    assert std is not None
    assert std[0] == 0.0
    assert std[-1] == pytest.approx(math.sqrt(math.log(times) ** 2 - 0.03**2), rel=1e-6)
    first = int(np.flatnonzero(std)[0])
    assert 100 <= first <= 200  # 2 s, and the dwell of the gates at the start


def test_a_wrong_final_drive_does_as_much() -> None:
    std = lever_std(SHAFT, final_drive=FINAL_DRIVE * 1.1)
    assert std is not None
    assert std[-1] == pytest.approx(math.sqrt(math.log(1.1) ** 2 - 0.03**2), rel=1e-6)


def test_a_wheel_speed_that_satellites_contradict_does_as_much() -> None:
    std = lever_std(WHEELS | {"vehicle_speed": 1.07 * V})
    assert std is not None
    assert std[-1] == pytest.approx(math.sqrt(math.log(1.07) ** 2 - 0.03**2), rel=1e-6)


def test_worn_tyres_and_what_cannot_be_compared_leave_nothing() -> None:
    worn = lever_std(SHAFT, wheel_radius_m=RADIUS_M * 0.975)
    assert worn is not None
    assert not worn.any()
    alone = {role: value for role, value in SHAFT.items() if role != "undriven_speed"}
    assert lever_std(alone, wheel_radius_m=RADIUS_M * 0.8) is None


def test_slow_or_hard_accelerated_driving_is_not_compared() -> None:
    slow = SHAFT | {"output_shaft_speed": RPM * 0.35, "undriven_speed": V * 0.35}
    std = lever_std(slow, wheel_radius_m=RADIUS_M * 0.9)
    assert std is not None
    assert not std.any()
    ramp = np.linspace(0.5, 2.0, 1000)  # 30 m/s in 20 s
    quick = SHAFT | {"output_shaft_speed": RPM * ramp, "undriven_speed": V * ramp}
    std = lever_std(quick, 1000, wheel_radius_m=RADIUS_M * 0.9)
    assert std is not None
    assert not std.any()


@pytest.mark.parametrize("value", [math.inf, 1e300, math.nan, -5.0, 0.0])
@pytest.mark.parametrize(
    "role", ["output_shaft_speed", "undriven_speed", "gear_ratio", "vehicle_speed", "gps_speed"]
)
def test_what_is_no_speed_is_not_compared(role: str, value: float) -> None:
    for signals in (SHAFT, ENGINE, WHEELS):
        if role in signals:
            std = lever_std(signals | {role: value}, 400)
            assert std is not None
            assert not std.any()


def test_what_is_mended_is_forgotten_in_a_minute() -> None:
    n = 6000
    road = np.where(np.arange(n) < n / 2, 1.08 * V, V)
    std = lever_std(SHAFT | {"undriven_speed": road}, n)
    assert std is not None
    assert std[n // 2 - 1] > 0.07
    assert std[-1] == 0.0


@pytest.mark.parametrize("cut", [1, 137, 250, 1003])
def test_any_cut_gives_the_same_bits(cut: int) -> None:
    rng = np.random.default_rng(3)
    signals = SHAFT | {"undriven_speed": V * (1.06 + 0.01 * rng.standard_normal(1500))}
    whole, parts = lever_std(signals), lever_std(signals, cut=cut)
    assert whole is not None
    assert whole.any()
    np.testing.assert_array_equal(whole, parts)
