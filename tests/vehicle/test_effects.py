"""Every effect: nothing at its neutral value, the sign and size worked out by hand, the config round trip."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from vehicle_helpers import (
    DENSITY,
    DRAG_AREA_M2,
    EFFICIENCY,
    ENGINE_INERTIA,
    FINAL_DRIVE,
    MU,
    RADIUS_M,
    config,
    ticks,
)

from canest.core.errors import ConfigError
from canest.core.samples import GRAVITY_MPS2
from canest.pipeline.build import TORQUE_ROLES, grid_spec, model_spec
from canest.vehicle.effects import EFFECTS, effect_from_config
from canest.vehicle.model import LongitudinalModel, RawModel

RATIO = 2.0 * FINAL_DRIVE
V = np.array([10.0, 10.02])
ENGINE_RADPS = V[1] / RADIUS_M * RATIO
SIGNALS: dict[str, Any] = {
    "engine_torque_pct": 55.0,
    "engine_speed": ENGINE_RADPS * 30 / math.pi,
    "output_shaft_speed": V / RADIUS_M * FINAL_DRIVE * 30 / math.pi,
    "gear": 3.0,
    "accelerator": 50.0,
    "brake_switch": 0.0,
    "retarder_request": 0.0,
    "yaw_rate": 0.1,
    "fan_speed": 100.0,
    "ambient_temperature": 5.0,
}
PER_TORQUE = RATIO / RADIUS_M * EFFICIENCY
TRACTION_N = 1000 * PER_TORQUE
ENGINE_KG = ENGINE_INERTIA * RATIO**2 * EFFICIENCY / RADIUS_M**2


REGIMES: list[tuple[str, dict[str, Any]]] = [
    ("pedal_up", {"accelerator": 0.0}),
    ("brake", {"brake_switch": 1.0}),
    ("request", {"retarder_request": -30.0}),
]


def process(*effects: dict[str, Any], **signals: Any) -> RawModel:
    values = SIGNALS | signals
    model = LongitudinalModel(model_spec(config(list(values), effects)))
    model.process(ticks(values))
    return model.process(ticks(values, first=2, continues=True))


def entry(name: str, **values: Any) -> dict[str, Any]:
    return {"effect": name, **({"signal": "fan_speed"} if name == "switched_load" else {}), **values}


def neutral(name: str) -> dict[str, Any]:
    return entry(name, **{k: p.neutral for k, p in EFFECTS[name].parameters.items()})


def columns(raw: RawModel) -> dict[str, bytes]:
    kept = {f.name: getattr(raw, f.name).tobytes() for f in fields(raw) if f.name != "columns"}
    return kept | {"mu": raw.columns.mu.tobytes(), "accel": raw.columns.accel_mps2.tobytes()}


def test_the_documented_effects_are_there() -> None:
    assert set(EFFECTS) >= {
        "headwind", "drag_area", "rolling_resistance", "rolling_resistance_speed", "rolling_warmup",
        "torque_gain", "torque_offset", "torque_delay", "driveline_loss", "wheel_radius", "rotating_inertia",
        "brake_drag", "retarder_unreported",
        "cornering_drag", "wheel_slip", "switched_load", "payload_change",
    }  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_neutral_value_it_changes_nothing_to_the_bit(name: str) -> None:
    up = {"accelerator": 0.0}  # the cause of `retarder_unreported` is on
    assert columns(process(neutral(name), **up)) == columns(process(**up))


@pytest.mark.parametrize("name", EFFECTS)
def test_it_survives_the_config(name: str) -> None:
    values = {
        k: p.neutral + 0.5 * min(p.step, p.high - p.neutral) for k, p in EFFECTS[name].parameters.items()
    }
    effect = effect_from_config(entry(name, **values))
    assert effect_from_config(effect.to_config()) == effect
    assert effect.to_config()["effect"] == name
    assert {k: effect.to_config()[k] for k in values} == values


@pytest.mark.parametrize(("name", "key"), [(n, k) for n, e in EFFECTS.items() for k in e.parameters])
def test_its_bounds_are_kept(name: str, key: str) -> None:
    bounds = EFFECTS[name].parameters[key]
    assert bounds.low <= bounds.neutral <= bounds.high
    assert bounds.step > 0
    for inside in (bounds.low, bounds.high):
        effect_from_config(entry(name, **{key: inside}))
    for outside in (math.nextafter(bounds.low, -math.inf), math.nextafter(bounds.high, math.inf), math.nan):
        with pytest.raises(ConfigError, match=key):
            effect_from_config(entry(name, **{key: outside}))


@pytest.mark.parametrize(
    ("effect", "force_N"),
    [
        (entry("headwind", wind_mps=2.0), -0.5 * DENSITY * DRAG_AREA_M2 * ((V[1] + 2) ** 2 - V[1] ** 2)),
        (entry("headwind", wind_mps=-2.0), -0.5 * DENSITY * DRAG_AREA_M2 * ((V[1] - 2) ** 2 - V[1] ** 2)),
        (entry("drag_area", cda_delta_m2=0.5), -0.5 * DENSITY * 0.5 * V[1] ** 2),
        (entry("torque_gain", gain=0.9), -0.1 * TRACTION_N),
        (entry("torque_offset", torque_Nm=100.0), -100 * PER_TORQUE),
        (entry("driveline_loss", loss=0.1), -0.1 * (TRACTION_N - ENGINE_KG)),
        (entry("driveline_loss", loss=0.1, gear=3), -0.1 * (TRACTION_N - ENGINE_KG)),
        (entry("driveline_loss", loss=0.1, gear=4), 0.0),
        (entry("rotating_inertia", inertia_kgm2=1.5), -0.5 * ENGINE_KG),
        (entry("brake_drag", force_N=500.0), -500.0),
        (entry("retarder_unreported", torque_Nm=200.0), 0.0),
        (entry("retarder_unreported", torque_Nm=200.0, cause="fan_speed"), -200 * PER_TORQUE),
        (entry("switched_load", power_kW=10.0), -10_000 / ENGINE_RADPS * PER_TORQUE),
        (entry("switched_load", power_kW=10.0, threshold=100.0), 0.0),
        (
            entry("switched_load", power_kW=10.0, exponent=3.0, reference_rpm=ENGINE_RADPS * 15 / math.pi),
            -80_000 / ENGINE_RADPS * PER_TORQUE,
        ),
        (entry("rolling_resistance", crr_delta=0.001), 0.0),
        (entry("payload_change", mass_delta_kg=5000.0, t_s=1.0), 0.0),
        (entry("torque_delay", delay_s=0.1), 0.0),
    ],
)
def test_its_force_by_hand(effect: dict[str, Any], force_N: float) -> None:
    plain, with_it = process(), process(effect)
    assert with_it.force_N[1] - plain.force_N[1] == pytest.approx(force_N, rel=1e-9, abs=1e-9)


def test_an_unreported_retarder_acts_while_its_cause_is_on() -> None:
    # the engine idles along: 1000 - 200 N m still drives
    for cause, on in REGIMES:
        effect = entry("retarder_unreported", torque_Nm=200.0, cause=cause)
        assert process(effect).force_N[1] == process().force_N[1]
        assert process(effect, **on).force_N[1] - process().force_N[1] == pytest.approx(-200 * PER_TORQUE)


def test_a_load_may_act_in_a_regime() -> None:
    for cause, on in REGIMES:
        effect = entry("switched_load", power_kW=10.0, signal=cause)
        assert process(effect).force_N[1] == process().force_N[1]
        torque_Nm = 10_000.0 / ENGINE_RADPS
        taken_N = process(**on).force_N[1] - process(effect, **on).force_N[1]
        assert taken_N == pytest.approx(torque_Nm * PER_TORQUE)


@pytest.mark.parametrize(
    ("effect", "mu"),
    [
        (entry("rolling_resistance", crr_delta=0.001), 0.001),
        (entry("rolling_resistance_speed", crr_per_mps=1e-4), 1e-4 * V[1]),
        (entry("rolling_warmup", crr_cold=0.002, tau_s=10.0), 0.002 * math.exp(-0.06 / 10)),
        (entry("cornering_drag", coefficient_s2pm=0.2), 0.2 / GRAVITY_MPS2 * (V[1] * 0.1) ** 2),
    ],
)
def test_its_rolling_resistance_by_hand(effect: dict[str, Any], mu: float) -> None:
    assert process(effect).columns.mu[1] - process().columns.mu[1] == pytest.approx(mu, rel=1e-9)


def test_a_larger_wheel_is_faster_and_pulls_less() -> None:
    raw = process(entry("wheel_radius", factor=1.02))
    assert raw.speed_mps[1] == pytest.approx(1.02 * V[1])
    assert raw.traction_N[1] == pytest.approx(TRACTION_N / 1.02)


def test_a_larger_wheel_goes_further_than_the_road_speed_counted_at_it() -> None:
    signals = {"output_shaft_speed": np.nan, "vehicle_speed": V}
    assert process(entry("wheel_radius", factor=1.02), **signals).speed_mps == pytest.approx(1.02 * V)
    assert process(**signals).speed_mps.tolist() == V.tolist()


def test_a_slipping_wheel_is_faster_than_the_road() -> None:
    raw = process(entry("wheel_slip", slip_per_mps2=0.02))
    assert raw.speed_mps[1] == pytest.approx(V[1] * (1 - 0.02 * TRACTION_N / 16_000))  # sqrt(8 t x 32 t)
    raw = process(entry("wheel_slip", slip_per_mps2=0.02, mass_kg=20_000))
    assert raw.speed_mps[1] == pytest.approx(V[1] * (1 - 0.02 * TRACTION_N / 20_000))


def test_slip_needs_no_torque_to_leave_a_speed_known() -> None:
    raw = process(entry("wheel_slip", slip_per_mps2=0.02), engine_torque_pct=np.nan)
    assert raw.speed_mps == pytest.approx(V)


def test_axles_that_are_not_driven_do_not_slip() -> None:
    raw = process(entry("wheel_slip", slip_per_mps2=0.02), output_shaft_speed=np.nan, undriven_speed=V)
    assert raw.speed_mps == pytest.approx(V)


def test_a_load_that_is_off_takes_nothing_whatever_the_engine_turns() -> None:
    off = {"fan_speed": 0.0, "engine_speed": np.nan}
    raw = process(entry("switched_load", power_kW=20.0), **off)
    assert raw.traction_N[1] == pytest.approx(TRACTION_N)


def test_without_an_engine_speed_a_load_turns_with_the_wheels() -> None:
    values = {role: value for role, value in SIGNALS.items() if role != "engine_speed"}
    effect = entry("switched_load", power_kW=20.0)
    for speeds in ({}, {"output_shaft_speed": None, "vehicle_speed": V}):
        known = {role: value for role, value in (values | speeds).items() if value is not None}
        raw = LongitudinalModel(model_spec(config(list(known), [effect]))).process(ticks(known))
        assert raw.traction_N[1] == pytest.approx(TRACTION_N - 20_000 / ENGINE_RADPS * PER_TORQUE)


def test_tyres_stay_warm_when_the_clock_is_set_back() -> None:
    model = LongitudinalModel(
        model_spec(config(list(SIGNALS), [entry("rolling_warmup", crr_cold=0.002, tau_s=300.0)]))
    )
    mu = [model.process(ticks(SIGNALS, first=first)).columns.mu[0] for first in (180_000, 195_000, 15_000)]
    assert mu[0] == pytest.approx(MU + 0.002)
    assert mu[1] == pytest.approx(MU + 0.002 * math.exp(-1.0), rel=1e-3)  # 15,000 ticks are 300 s
    assert mu[2] == pytest.approx(mu[1], rel=1e-3)


def test_a_torque_delay_makes_the_grid_wait() -> None:
    late = grid_spec(config(list(SIGNALS), [entry("torque_delay", delay_s=0.06)]))
    delays = {c.role: c.delay_us for c in late.channels}
    assert {r for r, d in delays.items() if d == 60_000} == {r for r in SIGNALS if r in TORQUE_ROLES}
    assert {d for r, d in delays.items() if r not in TORQUE_ROLES} == {0}
