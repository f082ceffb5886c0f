"""Forces against numbers worked out by hand, for a truck in third gear (total ratio 8) at 10 m/s."""

from __future__ import annotations

import math
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
    WHEEL_INERTIA,
    config,
    ticks,
)

from canest.pipeline.build import model_spec
from canest.vehicle.facts import Vehicle
from canest.vehicle.gear_ratio import GearRatio
from canest.vehicle.model import LongitudinalModel, RawModel

RATIO = 2.0 * FINAL_DRIVE
#: speeds of two ticks: 1 m/s2 between them
V = np.array([10.0, 10.02])
ROTATING_KG = (WHEEL_INERTIA + ENGINE_INERTIA * RATIO**2 * EFFICIENCY) / RADIUS_M**2
AERO_N = 0.5 * DENSITY * DRAG_AREA_M2 * V[1] ** 2


def rpm(speed_mps: Any, ratio: float = FINAL_DRIVE) -> Any:
    return speed_mps / RADIUS_M * ratio * 30 / math.pi


SIGNALS = {
    "engine_torque_pct": 55.0,  # less 5 % friction: 50 % of 2000 N m
    "engine_speed": rpm(V, RATIO),
    "output_shaft_speed": rpm(V),
    "gear": 3.0,
}


def process(changes: dict[str, Any] | None = None, **more: Any) -> RawModel:
    signals = SIGNALS | (changes or {})
    signals = {r: v for r, v in signals.items() if v is not None}
    return LongitudinalModel(model_spec(config(list(signals), **more))).process(ticks(signals))


def test_a_pulling_engine() -> None:
    raw = process()
    assert raw.traction_N[1] == pytest.approx(1000 * RATIO / RADIUS_M * EFFICIENCY)
    assert raw.speed_mps == pytest.approx(V)
    assert raw.columns.accel_mps2 == pytest.approx([0.0, 1.0])
    assert raw.rotating_mass_kg == pytest.approx([ROTATING_KG] * 2)
    assert raw.aero_N[1] == pytest.approx(AERO_N)
    assert raw.force_per_torque_1pm == pytest.approx([RATIO / RADIUS_M * EFFICIENCY] * 2)
    assert raw.force_N[1] == pytest.approx(14_400 - 1091.2 - AERO_N)
    assert raw.columns.mu == pytest.approx([MU] * 2)
    assert raw.usable.all()
    assert raw.geared.all()


def test_an_engine_on_the_overrun_pays_its_losses_too() -> None:
    raw = process({"engine_torque_pct": 0.0})
    assert raw.traction_N[1] == pytest.approx(-100 * RATIO / RADIUS_M / EFFICIENCY)


def test_an_engine_braking_in_first_gear_brakes_its_own_inertia_through_the_losses() -> None:
    """By hand: 12 t on the level, foot off in first gear (ratio 32), slowing down.

    Forwards: from a torque at the crank to a deceleration, of three bodies with the forces between them.
    """
    mass_kg, ratio, torque_Nm, g = 12_000.0, 8.0 * FINAL_DRIVE, -150.0, 9.80665
    speed = 2.0
    drag_N = mass_kg * g * MU + 0.5 * DENSITY * DRAG_AREA_M2 * speed**2
    # unknowns: torque in the gearbox, torque at the wheels, deceleration
    #   crank:   J_e (i / r) a         = T - T_gearbox
    #   gearbox: T_wheels              = T_gearbox i / eta      (the wheels drive)
    #   vehicle: (M + J_w / r^2) a     = T_wheels / r - drag
    equations = np.array(
        [
            [1.0, 0.0, ENGINE_INERTIA * ratio / RADIUS_M],
            [ratio / EFFICIENCY, -1.0, 0.0],
            [0.0, 1.0 / RADIUS_M, -(mass_kg + WHEEL_INERTIA / RADIUS_M**2)],
        ]
    )
    in_gearbox, at_wheels, accel = np.linalg.solve(equations, [torque_Nm, 0.0, drag_N])
    assert in_gearbox < 0  # it is overrun in the gearbox as well
    v = np.array([speed - accel * 0.02, speed])
    raw = process(
        {
            "engine_torque_pct": None,
            "engine_torque": torque_Nm,
            "gear": 1.0,
            "output_shaft_speed": rpm(v),
            "engine_speed": rpm(v, ratio),
        }
    )
    assert raw.force_N[1] == pytest.approx(mass_kg * (accel + g * MU), rel=1e-9)
    assert raw.force_N[1] + raw.aero_N[1] + raw.wheel_mass_kg[1] * accel == pytest.approx(
        at_wheels / RADIUS_M, rel=1e-9
    )
    assert raw.traction_N[1] == pytest.approx(torque_Nm * ratio / RADIUS_M / EFFICIENCY)


@pytest.mark.parametrize("torque_Nm", [-20.0, 20.0])
@pytest.mark.parametrize("accel", [-1.0, 1.0])
def test_losses_follow_the_torque_in_the_gearbox_not_that_of_the_engine(
    torque_Nm: float, accel: float
) -> None:
    """The crank's inertia takes 48 N m at 1 m/s2: more than the engine gives."""
    v = np.array([10.0, 10.0 + accel * 0.02])
    speeds = {"output_shaft_speed": rpm(v), "engine_speed": rpm(v, RATIO)}
    raw = process({"engine_torque_pct": None, "engine_torque": torque_Nm, **speeds})
    in_gearbox = torque_Nm - ENGINE_INERTIA * RATIO / RADIUS_M * accel
    kept = EFFICIENCY if accel < 0 else 1 / EFFICIENCY
    left = in_gearbox * RATIO / RADIUS_M * kept - WHEEL_INERTIA / RADIUS_M**2 * accel - raw.aero_N[1]
    assert raw.force_N[1] == pytest.approx(left)


def test_the_force_is_continuous_where_the_power_changes_its_direction() -> None:
    def force(torque_Nm: float) -> float:
        return float(process({"engine_torque_pct": None, "engine_torque": torque_Nm}).force_N[1])

    in_balance = ENGINE_INERTIA * RATIO / RADIUS_M  # at 1 m/s2
    per_Nm = RATIO / RADIUS_M / EFFICIENCY
    assert abs(force(in_balance + 1e-6) - force(in_balance - 1e-6)) < 2.1e-6 * per_Nm


def test_friction_and_reference_torque_from_the_bus_take_the_place_of_the_declared_ones() -> None:
    raw = process({"engine_friction_pct": 10.0, "reference_torque": 1000.0})
    assert raw.columns.torque_Nm[1] == pytest.approx(450.0)
    raw = process({"engine_friction_pct": np.nan, "reference_torque": np.nan})
    assert raw.columns.torque_Nm[1] == pytest.approx(1000.0)


def test_torque_in_newton_metres_is_net() -> None:
    raw = process({"engine_torque_pct": None, "engine_torque": 300.0})
    assert raw.columns.torque_Nm[1] == pytest.approx(300.0)


@pytest.mark.parametrize(
    ("roles", "torque"),
    [
        ({"wheel_torque": 5000.0}, 5000.0),
        ({"half_shaft_torque_left": 2000.0, "half_shaft_torque_right": 2500.0}, 4500.0),
    ],
)
def test_torque_measured_at_the_wheels_needs_no_gear_and_no_engine_inertia(
    roles: dict, torque: float
) -> None:
    raw = process({**dict.fromkeys(SIGNALS), "output_shaft_speed": rpm(V), **roles})
    rotating = WHEEL_INERTIA / RADIUS_M**2
    assert raw.traction_N[1] == pytest.approx(torque / RADIUS_M)
    assert raw.rotating_mass_kg[1] == pytest.approx(rotating)
    assert raw.force_N[1] == pytest.approx(torque / RADIUS_M - rotating - AERO_N)
    assert raw.geared.all()
    assert raw.force_per_torque_1pm == pytest.approx([1.0 / RADIUS_M] * 2)


@pytest.mark.parametrize("location", ["crank", "output_shaft"])
def test_torque_measured_at_the_wheels_has_what_a_retarder_takes(location: str) -> None:
    vehicle = {"retarder": {"reference_torque_Nm": 1500, "location": location}}
    raw = process({"wheel_torque": -8000.0, "retarder_torque_pct": -40.0}, vehicle=vehicle)
    assert raw.force_N[1] == process({"wheel_torque": -8000.0}).force_N[1]


@pytest.mark.parametrize("location", ["crank", "output_shaft"])
def test_a_retarder_reports_negative_percent_and_takes_force(location: str) -> None:
    vehicle = {"retarder": {"reference_torque_Nm": 1500, "location": location}}
    raw = process({"retarder_torque_pct": -40.0}, vehicle=vehicle)
    change = raw.force_N[1] - process().force_N[1]
    if location == "crank":
        assert change == pytest.approx(-600 * RATIO / RADIUS_M * EFFICIENCY)
    else:
        assert change == pytest.approx(-600 * FINAL_DRIVE / RADIUS_M)
    assert process({"retarder_torque_pct": np.nan}, vehicle=vehicle).force_N[1] == process().force_N[1]


def test_air_density_from_the_weather_where_it_is_plausible() -> None:
    raw = process({"barometric_pressure": 90.0, "ambient_temperature": 0.0})
    assert raw.columns.density_kgpm3[1] == pytest.approx(90_000 / (287.05 * 273.15))
    for pressure, temperature in ((np.nan, 20.0), (90.0, np.nan), (5.0, 20.0), (90.0, -273.15)):
        raw = process({"barometric_pressure": pressure, "ambient_temperature": temperature})
        assert raw.columns.density_kgpm3[1] == DENSITY


def test_in_reverse_the_air_resists_the_other_way() -> None:
    raw = process({"output_shaft_speed": rpm(-V)})
    assert raw.aero_N[1] == pytest.approx(-AERO_N)


@pytest.mark.parametrize(
    ("signals", "ratio", "gear"),
    [
        ({"gear_ratio": 3.3, "gear": 3.0}, 3.3, 3),  # what the transmission says counts
        ({"gear_ratio": np.nan, "gear": 2.0}, 4.0, 2),
        ({"gear_ratio": 0.0, "gear": 2.0}, 4.0, 2),
        ({"gear": 1.0}, 8.0, 1),
        ({"gear": np.nan}, 2.0, math.nan),  # from the shafts
        ({"gear": None}, 2.0, 3),
        ({"gear": None, "engine_speed": rpm(V, 4.05 * FINAL_DRIVE)}, 4.0, 2),  # snapped to the table
        ({"gear": None, "engine_speed": rpm(V, 3.0 * FINAL_DRIVE)}, 0.0, 0),  # fits no gear
        ({"gear": None, "gear_ratio": 4.1}, 4.1, 2),
        ({"gear": 7.0, "engine_speed": np.nan}, 0.0, 7),  # no such gear
        ({"gear": 0.0, "engine_speed": 600.0}, 0.0, 0),
        ({"gear": 0.0}, 0.0, 0),  # neutral, though the engine turns as it would in third
        ({"gear": 126.0}, 0.0, 126),  # park
    ],
)
def test_where_the_ratio_comes_from(signals: dict[str, Any], ratio: float, gear: float) -> None:
    raw = process(signals)
    assert raw.columns.ratio[1] == pytest.approx(ratio * FINAL_DRIVE)
    assert raw.columns.gear[1] == pytest.approx(gear, nan_ok=True)
    assert raw.geared[1] == (ratio > 0)


def test_a_reported_ratio_of_zero_is_neutral_whatever_its_neighbours_in_the_block() -> None:
    signals = SIGNALS | {"gear_ratio": [0.0, math.nan]}
    del signals["gear"]
    model = LongitudinalModel(model_spec(config(list(signals))))
    assert model.process(ticks(signals)).geared.tolist() == [False, True]


def test_a_vehicle_with_one_gear_needs_no_gear_signal() -> None:
    raw = process({"gear": None, "engine_speed": None}, vehicle={"gear_ratios": {1: 2.0}})
    assert raw.columns.ratio[1] == pytest.approx(RATIO)
    raw = process({"gear": None, "engine_speed": None}, vehicle={"gear_ratios": {}})
    assert raw.columns.ratio[1] == pytest.approx(FINAL_DRIVE)


def test_efficiency_per_gear() -> None:
    raw = process(vehicle={"gear_efficiency": {3: 0.95, 4: 0.98}})
    assert raw.columns.efficiency == pytest.approx([0.95] * 2)


def test_speed_falls_back_from_the_finest_to_the_coarsest_signal() -> None:
    speeds = {
        "output_shaft_speed": rpm(V),
        "undriven_speed": V + 1,
        "engine_speed": rpm(V + 2, RATIO),
        "vehicle_speed": V + 3,
        "gps_speed": V + 4,
    }
    lost: dict[str, Any] = {"driveline_engaged": 1.0}
    for offset, role in enumerate(speeds):
        raw = process({**speeds, **lost})
        assert raw.speed_mps == pytest.approx(V + offset)
        lost[role] = np.nan
    raw = process({**speeds, **lost})
    assert np.isnan(raw.speed_mps).all()
    assert not raw.usable.any()


def test_an_engines_speed_is_none_of_the_vehicle_without_a_clutch_signal() -> None:
    speeds = {"output_shaft_speed": np.nan, "engine_speed": rpm(V + 2, RATIO), "vehicle_speed": V + 3}
    assert process(speeds).speed_mps == pytest.approx(V + 3)
    one_gear = {"gear_ratios": {1: 2.0}}
    assert process({**speeds, "gear": None}, vehicle=one_gear).speed_mps == pytest.approx(V + 2)


@pytest.mark.parametrize("off", [0.97, 1.0, 1.03])
def test_the_road_speed_gives_the_gear_where_no_shaft_does(off: float) -> None:
    """Within a tyre's size and a late message; table entries are much further apart."""
    road = {"gear": None, "output_shaft_speed": None, "vehicle_speed": V * off}
    for gear, ratio in {1: 8.0, 2: 4.0, 3: 2.0, 4: 1.0}.items():
        raw = process({**road, "engine_speed": rpm(V, ratio * FINAL_DRIVE)})
        assert raw.columns.ratio == pytest.approx([ratio * FINAL_DRIVE] * 2)
        assert raw.columns.gear.tolist() == [gear, gear]
    between = process({**road, "engine_speed": rpm(V, 2.8 * FINAL_DRIVE)})
    assert not between.geared.any()


def test_a_missing_torque_makes_a_tick_unusable() -> None:
    assert process({"engine_torque_pct": [np.nan, 50.0]}).usable.tolist() == [False, True]


def test_no_acceleration_across_a_gap() -> None:
    model = LongitudinalModel(model_spec(config(list(SIGNALS))))
    model.process(ticks(SIGNALS))
    faster = SIGNALS | {"output_shaft_speed": rpm(V + 5)}
    assert model.process(ticks(faster, first=2, continues=True)).columns.accel_mps2[0] == pytest.approx(249.0)
    assert model.process(ticks(SIGNALS, first=900)).columns.accel_mps2[0] == 0.0


def test_a_force_at_the_wheels_is_the_traction_whatever_gear_and_radius() -> None:
    signals = {"wheel_force": 14_400.0, "vehicle_speed": V}
    no_torque = {"engine_torque_pct": None, "engine_speed": None, "output_shaft_speed": None, "gear": None}
    raw = process(no_torque | signals, vehicle={"wheel_radius_m": 0.4, "gear_ratios": {}})
    assert raw.traction_N == pytest.approx([14_400.0] * 2)
    assert raw.geared.all() and raw.usable.all()


def test_power_divided_by_the_engine_speed_is_torque_at_the_crank() -> None:
    watts = 1000.0 * SIGNALS["engine_speed"] * math.pi / 30
    raw = process({"engine_torque_pct": None, "power": watts / 1000.0})
    assert raw.traction_N == pytest.approx([1000 * RATIO / RADIUS_M * EFFICIENCY] * 2)


def test_power_without_an_engine_speed_is_a_force_at_the_wheels_and_finite_at_a_stop() -> None:
    none = {"engine_torque_pct": None, "engine_speed": None, "output_shaft_speed": None, "gear": None}
    raw = process(none | {"power": 100.0, "vehicle_speed": V}, vehicle={"gear_ratios": {}})
    assert raw.traction_N == pytest.approx(100_000.0 / V)
    stopped = process(none | {"power": 2.0, "vehicle_speed": [0.0, 0.0]}, vehicle={"gear_ratios": {}})
    assert stopped.traction_N == pytest.approx([2000.0] * 2)


@pytest.mark.parametrize(("fraction", "added"), [(0.875, 0.875), (0.0, 0.0), (1.875, 0.0), (math.nan, 0.0)])
def test_eighths_of_a_percent_add_to_the_torque_and_what_is_none_does_not(
    fraction: float, added: float
) -> None:
    raw = process({"engine_torque_fraction": fraction})
    assert raw.traction_N[1] == pytest.approx((50.0 + added) * 20.0 * RATIO / RADIUS_M * EFFICIENCY)


def test_a_gain_of_the_engine_is_none_of_its_retarder() -> None:
    roles = {"engine_torque_pct": 0.0, "retarder_torque_pct": -50.0}
    retarder = {"location": "crank", "reference_torque_Nm": 1500.0}
    for effects in ((), ({"effect": "torque_gain", "gain": 0.9},)):
        raw = process(roles, effects=effects, vehicle={"retarder": retarder, "friction_torque_pct": 0.0})
        assert raw.columns.torque_Nm[1] == pytest.approx(-750.0)


@pytest.mark.parametrize("reverse", [6.0, 6.1])
def test_without_a_gear_signal_a_ratio_is_that_of_a_forward_gear(reverse: float) -> None:
    vehicle = canest_vehicle(gear_ratios={-1: reverse, 1: 6.0, 2: 3.5})
    shaft_rpm = 400.0
    ratio, gear = GearRatio(vehicle).of(
        {
            "engine_speed": np.full(3, 6.06 * shaft_rpm),
            "output_shaft_speed": np.full(3, shaft_rpm),
        },
        3,
    )
    assert ratio.tolist() == [6.0] * 3 and gear.tolist() == [1.0] * 3


def canest_vehicle(**facts: Any) -> Vehicle:
    return Vehicle(
        mass_min_kg=8000, mass_max_kg=40000, wheel_radius_m=0.5, final_drive=3.0, drag_area_m2=6.0,
        rolling_resistance=0.006, **facts,
    )  # fmt: skip


def test_an_electric_car_whose_whole_ratio_is_its_final_drive_has_its_motor_for_a_speed() -> None:
    facts = {"gear_ratios": {}, "final_drive": 9.0}
    roles = ["half_shaft_torque_left", "half_shaft_torque_right", "engine_speed"]
    assert model_spec(config(roles, vehicle=facts)).roles == tuple(roles)
