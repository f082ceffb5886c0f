"""How well the facts are known: two standard deviations in percent, and what the estimator gets of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from canest.config import load_config, parse_config
from canest.core.errors import ConfigError
from canest.core.samples import VehicleFacts
from canest.doctor.signal_report import RoleReport, Sender
from canest.doctor.slow_signals import slow_signal_hints
from canest.pipeline.build import build, facts_of
from canest.simulation.data_sheet import known_config
from canest.simulation.reading import load_scenario
from canest.system.shipped_files import shipped

ACCURACIES = ("torque", "wheel_radius", "rolling_resistance", "drag_area")
SIMULATED = (0.01, 0.0025, 0.085, 0.05)
TRUCK = (shipped("configs") / "class8.yaml").read_text()


def accuracies(facts: VehicleFacts) -> tuple[float, ...]:
    return tuple(getattr(facts, f"{name}_accuracy") for name in ACCURACIES)


def test_a_config_that_states_none_has_the_same_as_facts_made_by_hand(tmp_path: Path) -> None:
    text = (shipped("configs") / "kenworth.yaml").read_text()
    lines = [line for line in text.splitlines() if "_accuracy_pct" not in line]
    path = tmp_path / "kenworth.yaml"
    path.write_text("\n".join(lines).replace("[j1939.dbc]", f"[{shipped('dbc') / 'j1939.dbc'}]"))
    given, by_hand = facts_of(load_config(str(path))), VehicleFacts(4_000.0, 36_000.0)
    assert accuracies(given) == accuracies(by_hand) == (0.025, 0.01, 0.15, 0.1)
    assert given.valid_std == by_hand.valid_std == 0.045


@pytest.mark.parametrize("name", ["class8", "class8-j1587", "vcan", "testcar"])
def test_simulated_vehicles_state_their_own(name: str) -> None:
    assert accuracies(facts_of(load_config(name))) == SIMULATED


@pytest.mark.parametrize("name", ["kenworth", "bmw-i3"])
def test_a_measured_vehicle_states_every_accuracy_with_its_source_beside_it(name: str) -> None:
    lines = (shipped("configs") / f"{name}.yaml").read_text().splitlines()
    stated = [line for line in lines if "_accuracy_pct:" in line]
    assert len(stated) == len(ACCURACIES)
    assert all("#" in line and line.partition("#")[2].strip() for line in stated)


@pytest.mark.parametrize("name", ["pulse-21t", "hill-11.8-percent"])
def test_the_config_of_a_simulated_drive_states_them_too(name: str) -> None:
    declared = known_config(load_scenario(name))["vehicle"]
    assert [declared[f"{fact}_accuracy_pct"] / 200.0 for fact in ACCURACIES] == list(SIMULATED)


@pytest.mark.parametrize("name", ACCURACIES)
def test_two_standard_deviations_in_percent_become_one_as_a_fraction(name: str) -> None:
    config = load_config("kenworth", [f"vehicle.{name}_accuracy_pct=3"])
    changed = accuracies(build(config).estimator.facts)
    expected = [0.015 if other == name else 0 for other in ACCURACIES]
    assert [new if new == 0.015 else 0 for new in changed] == expected


def test_the_limit_of_valid_becomes_a_fraction_of_the_mass() -> None:
    config = load_config("class8", ["estimator.valid_std_pct=2"])
    assert build(config).estimator.facts.valid_std == 0.02


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("0", "greater than 0"),
        ("-2", "greater than 0"),
        ("101", "less than or equal to"),
        ("yes", "a number"),
    ],
)
@pytest.mark.parametrize("name", ACCURACIES)
def test_an_impossible_accuracy_is_refused_with_file_and_line(name: str, value: str, expected: str) -> None:
    key = f"{name}_accuracy_pct"
    lines = [f"  {key}: {value}" if key in line else line for line in TRUCK.splitlines()]
    where = next(i for i, line in enumerate(lines, 1) if key in line)
    with pytest.raises(ConfigError) as refused:
        parse_config("\n".join(lines), "truck.yaml")
    assert str(refused.value).startswith(f"truck.yaml:{where}: vehicle.{key}")
    assert expected in str(refused.value)


@pytest.mark.parametrize(("value", "expected"), [("0", "greater than 0"), ("21", "less than or equal to 20")])
def test_an_impossible_limit_of_valid_is_refused_with_file_and_line(value: str, expected: str) -> None:
    text = TRUCK + f"\nestimator:\n  valid_std_pct: {value}\n"
    with pytest.raises(ConfigError) as refused:
        parse_config(text, "truck.yaml")
    where = len(text.splitlines())
    assert str(refused.value).startswith(f"truck.yaml:{where}: estimator.valid_std_pct, found {value}, ")
    assert expected in str(refused.value)


def test_torque_in_eighths_of_a_percent_is_known_as_finely(tmp_path: Path) -> None:
    text = (shipped("configs") / "class8.yaml").read_text()
    line = "  engine_torque_fraction: {message: EEC1, signal: ActlEngPrcntTorqueFractional, source: 0x00}\n"
    finer = tmp_path / "finer.yaml"
    finer.write_text(
        text.replace("signals:\n", "signals:\n" + line).replace(
            "[j1939.dbc]", f"[{shipped('dbc') / 'j1939.dbc'}]"
        )
    )
    whole, eighths = (facts_of(load_config(c)).torque_step_Nm for c in ("class8", str(finer)))
    assert eighths == whole / 8.0


@pytest.mark.parametrize(("period_s", "used"), [(None, True), (0.2, True), (0.5, True), (1.0, False)])
def test_an_accelerometer_that_shows_moments_is_not_used(period_s: float | None, used: bool) -> None:
    config = load_config("class8")
    source = config.signals["longitudinal_accel"].model_copy(update={"period_s": period_s})
    signals = {**config.signals, "longitudinal_accel": source}
    assert facts_of(config.model_copy(update={"signals": signals})).has_accelerometer == used


@pytest.mark.parametrize(("rate_hz", "said"), [(10.0, False), (2.0, False), (1.0, True)])
def test_check_says_that_an_accelerometer_shows_moments(rate_hz: float, said: bool) -> None:
    sender = Sender(None, rate_hz, 600, 600, 0, 0, 0)
    report = RoleReport("longitudinal_accel", "", "optional", "", None, "m/s2", senders=[sender])
    hints = slow_signal_hints(load_config("class8"), [report])
    assert any("such moments are no means" in hint for hint in hints) == said


@pytest.mark.parametrize(
    ("name", "overrides", "std_Nm"),
    [
        ("class8", [], 0.0),
        ("class8", ["vehicle.unreported_torque_Nm=null"], 63.0),
        ("class8", ["vehicle.unreported_torque_Nm=null", "vehicle.gear_ratios={}"], 63.0),
        ("kenworth", [], 57.0),
        ("kenworth", ["effects=[{effect: torque_offset, torque_Nm: 40}]"], 0.0),
        ("testcar", ["vehicle.unreported_torque_Nm=null"], 3.0),
        ("bmw-i3", [], 3.0),
    ],
    ids=["stated", "40 t", "ratio on the bus", "36 t", "told by an effect", "at the half-shafts", "one gear"],
)
def test_torque_that_no_signal_reports_grows_with_the_mass_of_a_vehicle_with_gears(name, overrides, std_Nm):
    facts = facts_of(load_config(name, overrides))
    assert facts.unreported_torque_Nm == pytest.approx(std_Nm)
    assert facts.torque_lags == (name != "bmw-i3")


@pytest.mark.parametrize(("name", "known"), [("class8", True), ("kenworth", False)])
def test_a_retarder_that_is_reported_is_known_by_its_reference_torque(name: str, known: bool) -> None:
    config = load_config(name)
    assert "retarder_torque_pct" in config.signals
    assert facts_of(config).knows_retarder is known
