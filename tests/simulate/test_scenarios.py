"""Scenario files: the shipped ones load and give accepted configs; wrong ones say where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from canest.config import parse_config
from canest.core import jit
from canest.core.errors import CanestError, ConfigError, OutputError
from canest.simulate import load_scenario, shipped_scenarios, simulate, simulate_to_directory
from canest.simulate.files import config_text
from canest.simulate.known import known_config

PLAIN = """\
duration_s: 20
vehicle: {preset: class8, crr: 0.007}
mass_kg: 20000
driver: {kind: pulses}
"""


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenario_loads_and_its_config_is_one(name: str):
    scenario = load_scenario(name)
    assert scenario.title
    config = parse_config(config_text(known_config(scenario)), name)
    assert config.effects == ()


def test_a_dozen_and_more_ship():
    names = shipped_scenarios()
    assert len(names) >= 12
    assert {"pulse-21t", "hill-11.8-percent", "demo", "city-payload", "headwind", "fan"} <= set(names)


@pytest.mark.parametrize(
    ("change", "line", "said"),
    [
        (("kind: pulses", "kind: pulses, speed_mpss: 3"), 4, "speed_mpss"),
        (("crr: 0.007", "crr: 0.007, wheels: 3"), 2, "wheels"),
        (("duration_s: 20", "duration_s: soon"), 1, "duration_s"),
        (("preset: class8", "preset: class9"), 2, "class9"),
        (("kind: pulses", "kind: rally"), 4, "driver"),
        (("mass_kg: 20000", "mass_kg: 20000\nundeclared:\n  - {effect: headwind, wind: 5}"), 5, "wind"),
        (("mass_kg: 20000", "mass_kg: 20000\nundeclared:\n  - {effect: sidewind}"), 5, "headwind"),
        (("mass_kg: 20000", "mass_kg: 20000\nmass_kg: 30000"), 4, "twice"),
        (("mass_kg: 20000\n", ""), 1, "missing"),
        (("duration_s: 20", "duration_s: .inf"), 1, "finite"),
        (("mass_kg: 20000", "mass_kg: [{t_s: 5, mass_kg: 9000}]"), 3, "mass_kg"),
        (
            ("duration_s: 20", "duration_s: 20\nseed: -1"),
            2,
            "seed, found -1, expected greater than or equal to 0",
        ),
        (
            ("kind: pulses", "kind: mixed, hold_s: [0, 0]"),
            4,
            "hold_s: found [0, 0], expected a second number",
        ),
        (
            ("kind: pulses", "kind: pulses, throttle: [0.9, 0.5]"),
            4,
            "throttle: found [0.9, 0.5], expected two",
        ),
        (
            ("kind: pulses", "kind: given, at_s: [5, 1], speed_mps: [1, 1]"),
            4,
            "at_s: found [5.0, 1.0], expected",
        ),
        (
            ("mass_kg: 20000", "mass_kg: 20000\nroad: {kind: points, at_m: [0], grade: []}"),
            4,
            "found 0 values of grade",
        ),
        (
            ("mass_kg: 20000", "mass_kg: 20000\nroad: {kind: steps, grades: []}"),
            4,
            "road.steps.grades, found []",
        ),
        (
            ("mass_kg: 20000", "mass_kg: 20000\nroad: {kind: highway, stretch_m: [0, 0]}"),
            4,
            "stretch_m: found [0, 0]",
        ),
    ],
)
def test_a_mistake_is_named_with_file_line_and_key(
    tmp_path: Path, change: tuple[str, str], line: int, said: str
):
    path = tmp_path / "mine.yaml"
    path.write_text(PLAIN.replace(*change))
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert f"{path}:{line}: " in str(caught.value)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("seed", "-1", "seed, found -1, expected greater than or equal to 0"),
        ("vehicle", "{preset: class8, gear_ratios: []}", "vehicle.gear_ratios, found []"),
        ("driver", "{kind: mixed, hold_s: [0, 0]}", "hold_s: found [0, 0], expected a second"),
        ("driver", "{kind: pulses, throttle: [0.9, 0.5]}", "throttle: found [0.9, 0.5], expected two"),
        ("driver", "{kind: given, at_s: [5, 1], speed_mps: [1, 1]}", "at_s: found [5.0, 1.0], expected"),
        ("driver", "{kind: given, at_s: [0, 1], speed_mps: [1]}", "found 1 values of speed_mps"),
        ("road", "{kind: points, at_m: [0], grade: []}", "found 0 values of grade"),
        ("road", "{kind: steps, grades: []}", "road.steps.grades, found []"),
        ("road", "{kind: highway, stretch_m: [0, 0]}", "stretch_m: found [0, 0]"),
    ],
)
def test_numbers_that_make_no_drive_are_refused(tmp_path: Path, key: str, value: str, said: str):
    kept = [line for line in PLAIN.splitlines() if not line.startswith(f"{key}:")]
    path = tmp_path / "mine.yaml"
    path.write_text("\n".join([f"{key}: {value}", *kept]))
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert f"{path}:1: " in str(caught.value)
    assert said in str(caught.value)


@pytest.mark.parametrize("text", ["", "[1, 2", "- a\n- b\n", "\x00"])
def test_a_file_that_is_no_scenario_is_refused(tmp_path: Path, text: str):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"mine\.yaml"):
        load_scenario(path)


def test_an_unknown_name_lists_what_ships():
    with pytest.raises(ConfigError, match="pulse-21t"):
        load_scenario("pulse-22t")


def test_a_gear_that_the_vehicle_lacks_is_refused():
    with pytest.raises(ConfigError, match="fixed_gear"):
        simulate(
            {
                "duration_s": 5,
                "vehicle": "electric-car",
                "mass_kg": 1500,
                "driver": {"kind": "cruise", "speed_mps": 10, "fixed_gear": 2},
            }
        )


def test_a_name_with_a_dot_keeps_it(tmp_path: Path):
    name = next(name for name in shipped_scenarios() if "." in name)
    simulate_to_directory(name, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {name + end for end in (".log", ".truth.csv", ".yaml")}


def test_directory_gets_log_truth_and_config(tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text(PLAIN)
    told: list[float] = []
    written = simulate_to_directory(path, tmp_path / "out", told.append, compress=True)
    assert [p.name for p in written] == ["mine.log.xz", "mine.truth.csv", "mine.yaml"]
    assert told[0] == 0.0 and told[-1] == 1.0 and told == sorted(told)
    assert parse_config(written[2].read_text()).vehicle.rolling_resistance == 0.007
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError) as caught:
        simulate_to_directory(path, tmp_path / "file" / "below")
    assert isinstance(caught.value, CanestError)


@pytest.mark.slow
@pytest.mark.skipif(not jit.available(), reason="numba is not installed")
@pytest.mark.parametrize("name", ["fan", "mixed-36t", "electric-city"])
def test_a_drive_has_the_same_bits_compiled_and_interpreted(name: str):
    truths = []
    for compiled in (False, True):
        jit.enable(compiled)
        try:
            truths.append(simulate(name).truth)
        finally:
            jit.enable(False)
    for column, values in truths[0].items():
        np.testing.assert_array_equal(values, truths[1][column], err_msg=column)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenario_drives(name: str):
    drive = simulate(name)
    assert drive.truth["speed_mps"].max() > 5
    assert len(drive.frames) > 100_000 or drive.config["dbc"] == ["testcar.dbc"] or "grade" in name
