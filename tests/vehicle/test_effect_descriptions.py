"""What an effect's class says of itself for the diagnosis and its report."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from canest.vehicle.effects import EFFECTS, DrivenData, Effect, effect_from_config

DRIVES = DrivenData(
    roles=frozenset({"accelerator", "yaw_rate"}),
    mass_kg=20_000.0,
    gears=(11, 12),
    temperature_span_K=8.0,
    loading_stops_s=(400.0,),
    switches={"fan_speed": 50.0},
)


def made(name: str, **values: object) -> Effect:
    return effect_from_config({"effect": name, **values})


def test_no_two_effects_are_equally_rare() -> None:
    rarities = [cls.rarity for cls in EFFECTS.values()]
    assert len(set(rarities)) == len(rarities)
    assert min(EFFECTS, key=lambda name: EFFECTS[name].rarity) == "torque_delay"


@pytest.mark.parametrize("name", EFFECTS)
def test_every_trial_is_a_config_entry_with_the_fitted_parameter(name: str) -> None:
    cls = EFFECTS[name]
    trials = cls.trials(DRIVES)
    assert trials
    assert len({t.label for t in trials}) == len(trials)
    for trial in trials:
        fitted = cls.fitted_parameter()
        effect = made(name, **{fitted: cls.parameters[fitted].neutral}, **dict(trial.shape))
        if len(trials) > 1 and cls.several_by:
            assert cls.several_by in {key for t in trials for key, _ in t.shape}
        sentence = effect.describe(0.25)
        assert sentence[0].islower() or sentence[0].isdigit()
        assert "\n" not in sentence and not sentence.endswith(".")


@pytest.mark.parametrize(
    ("name", "without"),
    [
        ("cornering_drag", {"roles": frozenset()}),
        ("retarder_unreported", {"roles": frozenset()}),
        ("rolling_resistance_temperature", {"temperature_span_K": 2.0}),
        ("switched_load", {"switches": {}}),
        ("payload_change", {"loading_stops_s": ()}),
    ],
)
def test_what_the_drives_cannot_show_is_not_tried(name: str, without: dict[str, object]) -> None:
    cls = EFFECTS[name]
    assert not cls.trials(replace(DRIVES, **without))  # type: ignore[arg-type]
    assert cls.untried_reason or cls().signal


@pytest.mark.parametrize(
    ("effect", "std", "text"),
    [
        (made("headwind", wind_mps=6.48), 0.4, "a headwind of 6.48 ± 0.4 m/s"),
        (made("headwind", wind_mps=-6.48), 0.4, "a tailwind of 6.48 ± 0.4 m/s"),
        (made("drag_area", cda_delta_m2=1.2), 0.3, "a drag area 1.2 ± 0.3 m2 larger than declared"),
        (made("drag_area", cda_delta_m2=-1.2), 0.3, "a drag area 1.2 ± 0.3 m2 smaller than declared"),
        (made("driveline_loss", loss=0.05, gear=9), 0.01, "5.0 ± 1 % of traction lost in gear 9"),
        (made("driveline_loss", loss=0.05), 0.01, "5.0 ± 1 % of traction lost in the driveline"),
        (made("torque_delay", delay_s=0.063), 0.006, "torque reported 63 ± 6 ms late"),
        (made("retarder_unreported", torque_Nm=300.0, cause="brake"), 20.0,
         "an unreported retarder of 300 ± 2e+01 Nm at the crank under the brake"),
        (made("switched_load", power_kW=32.0, signal="fan_speed"), 0.5,
         "32 ± 0.5 kW taken while fan_speed is on"),
        (made("payload_change", mass_delta_kg=-4000.0, t_s=700.0), 90.0,
         "4,000 ± 90 kg unloaded in the stop around t_s 700"),
        (made("cornering_drag", coefficient_s2pm=0.02), 0.004, "cornering drag of 0.02 ± 0.004 s2/m"),
    ],
)  # fmt: skip
def test_an_effect_is_described_with_its_value(effect: Effect, std: float, text: str) -> None:
    assert effect.describe(std) == text


def test_a_loss_in_one_gear_is_caused_by_the_gear() -> None:
    assert made("driveline_loss", gear=9).caused_by == "gear"
    assert made("driveline_loss").caused_by == "torque"


def test_no_vehicle_has_less_than_nothing_of_what_it_declares() -> None:
    vehicle = SimpleNamespace(drag_area_m2=0.7, rolling_resistance=0.006, engine_inertia_kgm2=3.0)
    lowest = {
        name: next(iter(EFFECTS[name].parameters.values())).lowest(vehicle)
        for name in ("drag_area", "rolling_resistance", "rotating_inertia", "headwind")
    }
    assert lowest == {
        "drag_area": -0.7, "rolling_resistance": -0.006, "rotating_inertia": -1.0, "headwind": -30.0,
    }  # fmt: skip


def test_every_vehicle_has_some_wind_some_error_of_torque_and_of_rolling_resistance() -> None:
    vehicle = SimpleNamespace(drag_area_m2=0.7, rolling_resistance=0.006, engine_inertia_kgm2=3.0)
    spread = {name: next(iter(c.parameters.values())).usual_std(vehicle) for name, c in EFFECTS.items()}
    assert {name: s * 3**0.5 for name, s in spread.items() if s} == pytest.approx(
        {"headwind": 3.0, "torque_gain": 0.02, "rolling_resistance": 0.0009, "wheel_slip": 0.006}
    )
