"""Every mistake in a config becomes one line: file, line, key, what was found, what was expected."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from canest.config import load_config, parse_config, read_databases
from canest.core.errors import ConfigError
from canest.core.roles import _EVERYDAY, ROLES
from canest.pipeline.pipeline import Pipeline
from canest.pipeline.signal_map import decoder_for
from canest.system.shipped_files import shipped

TRUCK = (shipped("configs") / "class8.yaml").read_text()


def line_with(text: str, mark: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if mark in line)


def refused(text: str, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "truck.yaml", overrides)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_code == 2
    return message


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        (
            "mass_min_kg: 7000",
            "mass_min_kg: -7000",
            "vehicle.mass_min_kg",
            "found -7000, expected greater than",
        ),
        ("mass_min_kg: 7000", "mass_min_kg: 50000", "vehicle.mass_min_kg", "less than mass_max_kg, 40000"),
        (
            "mass_min_kg: 7000",
            "mass_min_kg: heavy",
            "vehicle.mass_min_kg",
            "found 'heavy', expected a number",
        ),
        ("mass_min_kg: 7000", "mass_min_kg: yes", "vehicle.mass_min_kg", "expected a number"),
        ("mass_min_kg: 7000", "mass_min_kg: .inf", "vehicle.mass_min_kg", "expected a finite number"),
        (
            "mass_min_kg: 7000",
            "mass_min_kg: [7000]",
            "vehicle.mass_min_kg",
            "found 'list', expected a number",
        ),
        (
            "wheel_radius_m: 0.500",
            "wheel_radius_m: 20",
            "vehicle.wheel_radius_m",
            "found 20, expected less than 2",
        ),
        ("efficiency: 0.96", "efficiency: 96", "vehicle.driveline_efficiency", "less than or equal to 1"),
        (
            "drag_area_m2:",
            "drag_aera_m2:",
            "vehicle.drag_aera_m2",
            "unknown key, expected a key of vehicle:, perhaps drag_area_m2",
        ),
        ("1: 12.69", "1: 1269", "vehicle.gear_ratios.1", "found 1269, expected between"),
        ("1: 12.69", "0: 12.69", "vehicle.gear_ratios.0", "neutral has no ratio, found 12.69, expected no"),
        ("1: 12.69", "126: 12.69", "vehicle.gear_ratios.126", "park has no ratio, found 12.69, expected no"),
        ("1: 12.69", "first: 12.69", "vehicle.gear_ratios.first", "expected a whole number"),
        ("{9: 0.98}", "{9: 98}", "vehicle.gear_efficiency.9", "found 98, expected above 0.5"),
        ("location: crank", "location: moon", "vehicle.retarder.location", "'crank' or 'output_shaft'"),
        (
            "{reference_torque_Nm: 1500,",
            "{torque: 9,",
            "vehicle.retarder.torque",
            "reference_torque_Nm, location",
        ),
        ("dbc: [j1939.dbc]", "dbc: 5", "dbc", "found 5, expected a list"),
        (
            "EngSpeed, source: 0x00",
            "EngSpeed, source: 999",
            "signals.engine_speed.source",
            "less than or equal to 253",
        ),
        (
            "EngSpeed, source: 0x00",
            "EngSpeed, sauce: 0",
            "signals.engine_speed.sauce",
            "unknown key, expected a key of engine_speed:, perhaps source",
        ),
        (
            "EngSpeed, source: 0x00",
            "EngSpeed, source: yes",
            "signals.engine_speed.source",
            "expected a number",
        ),
        (
            "EngSpeed, source",
            "EngSpeed, unit: parsec, source",
            "signals.engine_speed.unit",
            "one of %, 1/min",
        ),
        (
            "EngSpeed, source: 0x00",
            "EngSpeed, column: v",
            "signals.engine_speed",
            "either message and signal, or column",
        ),
        ("signal: EngSpeed, ", "", "signals.engine_speed", "either message and signal, or column"),
        (
            "  engine_speed: ",
            "  engine_sped: ",
            "signals.engine_sped",
            "unknown role, expected a role, perhaps engine_speed",
        ),
        ("vehicle:", "vehicles:", "vehicles", "unknown key, expected a section, perhaps vehicle"),
        (
            "dbc: [j1939.dbc]",
            "service: {state_dir: ~nobody-of-that-name/canest}",
            "service.state_dir",
            "its ~nobody-of-that-name is nobody's home",
        ),
    ],
)
def test_a_mistake_names_its_line_and_key(old: str, new: str, key: str, words: str) -> None:
    text = TRUCK.replace(old, new, 1)
    assert text != TRUCK
    message = refused(text)
    line = line_with(text, new or "engine_speed:")
    assert message.startswith(f"truck.yaml:{line}: {key}"), message
    assert words in message


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("", "truck.yaml: ", "holds no sections, found 'nothing'"),
        ("# only a comment\n", "truck.yaml: ", "holds no sections"),
        ("just words", "truck.yaml: ", "found 'str', expected vehicle:, signals: and so on"),
        ("vehicle:\n  name: [\n", "truck.yaml:3: ", "not valid YAML"),
        ("vehicle:\n  a: 1\n  b: 2\n  a: 3\n", "truck.yaml:4: ", "key given twice: vehicle.a"),
        ("vehicle: {name: x}\nvehicle: {name: y}\n", "truck.yaml:2: ", "key given twice: vehicle"),
        ("vehicle:\n  t: 2001-99-99\n", "truck.yaml: ", "not valid YAML"),
        ("\x00", "truck.yaml: ", "not valid YAML"),
        ("vehicle:\n\tname: a\n", "truck.yaml:2: ", "a tab: only spaces may indent a line"),
        ("vehicle:\n  name: a\n\tkey: b\n", "truck.yaml:3: ", "a tab: only spaces may indent a line"),
        ("[" * 30 + "]" * 30, "truck.yaml", "holds no sections"),
        ("[" * 5000 + "]" * 5000, "truck.yaml", "nested too deeply"),
        ("a: &x [*x]", "truck.yaml:1: ", "a: unknown key"),
        ("signals: {}\n", "truck.yaml:1: ", "vehicle: is missing, expected a value"),
    ],
)
def test_what_is_no_config_is_refused_in_one_line(text: str, where: str, words: str) -> None:
    message = refused(text)
    assert message.startswith(where), message
    assert words in message


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("speed", "a role, perhaps vehicle_speed"),
        ("velocity", "a role, perhaps vehicle_speed"),
        ("RPM", "a role, perhaps engine_speed"),
        ("brake", "a role, perhaps brake_switch or brake_pedal"),
        ("throttle", "a role, perhaps accelerator"),
        ("engine_sped", "a role, perhaps engine_speed or vehicle_speed"),
    ],
)
def test_a_word_of_everyday_leads_to_its_role(word: str, expected: str) -> None:
    text = TRUCK.replace("signals:\n", f"signals:\n  {word}: {{column: a}}\n", 1)
    assert f"signals.{word}: unknown role, expected {expected}" in refused(text)


def test_every_word_of_everyday_stands_for_roles() -> None:
    assert not _EVERYDAY.keys() & ROLES.keys()
    assert {role for meant in _EVERYDAY.values() for role in meant} <= ROLES.keys()


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("EngData.EngTq", "found 'EngData.EngTq', expected {message: EngData, signal: EngTq} of a DBC, or"),
        ("torque", "found 'torque', expected {message: MESSAGE, signal: SIGNAL} of a DBC, or {column: NAME}"),
    ],
)
def test_a_source_that_is_one_word_is_answered_with_its_form(source: str, words: str) -> None:
    text = TRUCK.replace("signals:\n", f"signals:\n  engine_torque: {source}\n", 1)
    line = line_with(text, "engine_torque:")
    assert refused(text).startswith(f"truck.yaml:{line}: signals.engine_torque: {words}")


def test_a_cutoff_at_half_the_sampling_rate_is_refused_with_its_reason() -> None:
    text = TRUCK + "\nfilter:\n  order: 5\n  cutoff_hz: 25\n"
    message = refused(text)
    line = line_with(text, "cutoff_hz")
    assert message.startswith(f"truck.yaml:{line}: filter.cutoff_hz: found 25 Hz, expected below 25 Hz")
    assert "no digital Butterworth exists there" in message
    assert parse_config(text, overrides=["filter.cutoff_hz=24.9"]).filter.cutoff_hz == 24.9


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{effect: flying}", "unknown effect, found 'flying', expected one of headwind, drag_area"),
        ("{wind_mps: 3}", "unknown effect"),
        (
            "{effect: headwind, wind_kmh: 3}",
            "headwind: unknown key wind_kmh, expected a key of headwind, perhaps wind_mps",
        ),
        ("{effect: headwind, signal: fan_speed}", "headwind: unknown key signal, expected one of wind_mps"),
        ("{effect: headwind, wind_mps: 300}", "headwind.wind_mps, found 300, expected -30 to 30 m/s"),
        ("{effect: headwind, wind_mps: .nan}", "headwind.wind_mps, found nan, expected -30 to 30 m/s"),
        ("{effect: headwind, wind_mps: strong}", "headwind.wind_mps, found 'strong', expected -30 to 30 m/s"),
        ("{effect: headwind, wind_mps: yes}", "headwind.wind_mps, found True"),
        ("{effect: headwind, wind_mps: null}", "headwind.wind_mps, expected -30 to 30 m/s"),
        ("{effect: driveline_loss, gear: low}", "driveline_loss.gear, found 'low', expected a whole number"),
        ("{effect: retarder_unreported, cause: 4}", "retarder_unreported.cause, found 4, expected a name"),
        (
            "{effect: switched_load, reference_rpm: 0}",
            "switched_load.reference_rpm, found 0, expected 100 to",
        ),
        ("{effect: wheel_slip, mass_kg: 0}", "wheel_slip.mass_kg, found 0, expected 50 to"),
        ("{effect: switched_load, signal: compressor}", "needs the signal compressor"),
        ("{effect: switched_load, power_kW: 20}", "switched_load: without signal it never acts"),
        ("headwind", "found 'headwind', expected a section"),
    ],
)
def test_a_mistake_in_an_effect_names_its_line(entry: str, words: str) -> None:
    text = TRUCK + f"\neffects:\n  - {{effect: brake_drag, force_N: 100}}\n  - {entry}\n"
    message = refused(text)
    assert message.startswith(f"truck.yaml:{line_with(text, entry)}: effects.1"), message
    assert words in message


def test_an_effect_that_needs_a_signal_the_map_lacks_names_the_signal() -> None:
    lines = [line for line in TRUCK.splitlines() if "yaw_rate" not in line]
    assert "yaw_rate" in refused("\n".join(lines), "effects=[{effect: cornering_drag}]")


def test_a_signal_that_only_an_effect_knows_is_a_role() -> None:
    text = TRUCK.replace("  fan_speed:", "  my_compressor:")
    assert "signals.my_compressor: unknown role" in refused(text)
    config = parse_config(text, overrides=["effects=[{effect: switched_load, signal: my_compressor}]"])
    assert "my_compressor" in config.signals


def test_a_value_table_without_an_entry_says_what_one_holds() -> None:
    assert refused(TRUCK, "signals.fan_speed.map={}").endswith(
        "signals.fan_speed.map: found no entry, expected labels or raw numbers with the number of each"
    )


def test_a_role_set_to_nothing_is_taken_away() -> None:
    with_altitude = load_config("class8")
    assert "altitude" in with_altitude.signals
    without = load_config("class8", ["signals.altitude=null"])
    assert set(without.signals) == set(with_altitude.signals) - {"altitude"}


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("filter.cutoff_hz", "malformed --set, found 'filter.cutoff_hz', expected dotted.key=value"),
        ("=3", "malformed --set"),
        (
            "filter.cutof_hz=3",
            "--set: filter.cutof_hz: unknown key, expected a key of filter:, perhaps cutoff_hz",
        ),
        ("fitler.order=3", "--set: fitler: unknown key"),
        ("filter.order=9", "--set: filter.order, found 9, expected less than or equal to 6"),
        ("filter.order={", "--set filter.order: not a YAML value, found '{'"),
        ("filter.order=2001-99-99", "--set filter.order: not a YAML value"),
        ("vehicle.name.first=x", "--set vehicle.name.first: name is not a section"),
        ("effects=[{effect: headwind, wind_mps: 99}]", "--set: effects.0: headwind.wind_mps, found 99"),
        ("gates..enabled=no", "--set: gates."),
        ("signals.engine_speed.scale=0", "--set: signals.engine_speed.scale: found 0, expected a factor"),
        (
            "signals.engine_speed.scale=1e150",
            "--set: signals.engine_speed.scale: found 1e+150, expected a factor",
        ),
        (
            "signals.engine_speed.scale=-1e-12",
            "--set: signals.engine_speed.scale: found -1e-12, expected a factor",
        ),
        ("filter.cutoff_hz=0.001", "--set: filter.cutoff_hz, found 0.001, expected greater than or equal"),
        ("estimator.initial_mass_kg=1", "estimator.initial_mass_kg: no mass of this vehicle, found 1"),
        ("estimator.initial_mass_kg=1e9", "expected 7000 to 40000 kg"),
    ],
)
def test_a_mistake_in_an_override_names_the_override(override: str, words: str) -> None:
    assert words in refused(TRUCK, override)


def test_an_override_creates_the_sections_it_needs() -> None:
    config = parse_config(TRUCK, overrides=["gates.shift.recovery_s=2.5", "vehicle.gear_ratios.3=7.0"])
    assert config.gates.shift.recovery_s == 2.5
    assert config.vehicle.gear_ratios[3] == 7.0
    assert config.gates.brake.recovery_s == parse_config(TRUCK).gates.brake.recovery_s


def test_several_mistakes_are_counted() -> None:
    text = TRUCK.replace("final_drive: 3.73", "final_drive: -1").replace(
        "drag_area_m2: 6.4", "drag_area_m2: -1"
    )
    assert "vehicle.final_drive" in refused(text)
    assert "(and 1 more)" in refused(text)


def test_all_keys_that_a_section_lacks_are_named() -> None:
    text = TRUCK.replace("final_drive: 3.73", "").replace("drag_area_m2: 6.4", "")
    assert "vehicle.final_drive: is missing" in refused(text)
    assert refused(text).endswith("(and 1 more: drag_area_m2)")


def test_a_file_that_is_not_there_lists_what_ships(tmp_path: Path) -> None:
    for name in (str(tmp_path / "none.yaml"), str(tmp_path), "x" * 5000, "a\0b"):
        with pytest.raises(ConfigError, match=r"class8\.yaml"):
            load_config(name)


def test_a_directory_is_not_said_to_be_missing(tmp_path: Path) -> None:
    (tmp_path / "dir.dbc").mkdir()
    with pytest.raises(ConfigError, match="is a directory, not a config file, expected a path or"):
        load_config(tmp_path)
    with pytest.raises(ConfigError, match=r"dbc\.0: is a directory, not a dbc file, found '.*dir\.dbc'"):
        load_config("class8", [f"dbc=['{tmp_path / 'dir.dbc'}']"])


def test_a_pipe_is_not_said_to_be_missing(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match="is a pipe or a device, not a config file, expected a path or"):
        load_config(tmp_path / "pipe.yaml")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\xff\xfe\x00\x81" * 10)
    with pytest.raises(ConfigError, match=r"binary\.yaml:1: cannot be read"):
        load_config(path)


def test_letters_that_are_no_utf_8_are_shown_with_their_line(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes("vehicle:\n  name: Größe\n".encode("latin-1"))
    text = r"latin\.yaml:2: .* not UTF-8, found 'byte 0xf6', expected a file saved as UTF-8"
    with pytest.raises(ConfigError, match=text):
        load_config(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "dbc: [j1939.dbc]",
            "dbc: [j1989.dbc]",
            ["dbc.0: no such dbc file, found 'j1989", "canest.dbc"],
        ),
        ("dbc: [j1939.dbc]", "dbc: []", ["signals.", "no dbc: file"]),
        ("message: EEC2", "message: EEC22", ["signals.accelerator: no such message", "perhaps", "EEC2"]),
        ("signal: EngSpeed", "signal: EngSped", ["signals.engine_speed: no such signal in EEC1", "EngSpeed"]),
        ("EngSpeed, source", "EngSpeed, unit: kg, source", ["signals.engine_speed: unit", "'kg'", "rpm"]),
    ],
)
def test_a_signal_that_the_dbc_does_not_have(old: str, new: str, words: list[str]) -> None:
    text = TRUCK.replace(old, new, 1)
    config = parse_config(text, "truck.yaml")
    with pytest.raises(ConfigError) as caught:
        decoder_for(read_databases(config))
    assert all(word in str(caught.value) for word in words), str(caught.value)
    if new != "dbc: []":
        assert str(caught.value).startswith(f"truck.yaml:{line_with(text, new)}: {words[0]}")


def test_a_torque_that_the_dbc_does_not_have_is_named_with_its_line() -> None:
    """Limits and noise are asked for its step before anything is decoded."""
    text = TRUCK.replace("signal: ActualEngPercentTorque", "signal: ActualTorque", 1)
    with pytest.raises(ConfigError) as caught:
        Pipeline(read_databases(parse_config(text, "truck.yaml")))
    line = line_with(text, "ActualTorque")
    assert str(caught.value).startswith(f"truck.yaml:{line}: signals.engine_torque_pct: no such signal")


def test_all_roles_that_the_dbc_lacks_are_named_at_once() -> None:
    text = TRUCK.replace("message: EEC2", "message: EEC22").replace("message: CCVS1", "message: Speeds")
    with pytest.raises(ConfigError) as caught:
        decoder_for(read_databases(parse_config(text, "truck.yaml")))
    first, others = str(caught.value).split("Nor is there one for: ")
    config = parse_config(text, "truck.yaml")
    lacking = [role for role, source in config.signals.items() if source.message in ("EEC22", "Speeds")]
    assert len(lacking) > 2
    assert f"signals.{lacking[0]}: no such message" in first
    assert others.split("; ")[0].split(", ") == lacking[1:]
    assert "map each to what the DBC calls it, or delete its line" in others
    assert others.endswith("`dbc:` names j1939.dbc")
    with pytest.raises(ConfigError, match=r"names j1939\.dbc where it is not given"):
        decoder_for(read_databases(parse_config(text.replace("dbc: [j1939.dbc]\n", ""), "truck.yaml")))


def test_an_address_where_none_can_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nBU_:\nBO_ 416 Motion: 8 Vector__XXX\n'
        ' SG_ Speed : 0|16@1+ (0.01,0) [0|655.35] "km/h" Vector__XXX\n'
    )
    speed = "  vehicle_speed: {message: Motion, signal: Speed, source: 0x03}"
    before = next(line for line in TRUCK.splitlines() if line.lstrip().startswith("vehicle_speed:"))
    text = TRUCK.replace(before, speed)
    config = tmp_path / "truck.yaml"
    config.write_text(text)
    with pytest.raises(ConfigError) as caught:
        decoder_for(load_config(config, ["dbc=[car.dbc, j1939.dbc]"]))
    line = line_with(text, "Motion")
    assert str(caught.value) == (
        f"{config}:{line}: signals.vehicle_speed.source: Motion is no J1939 message: its identifier holds "
        "no source address, found '0x03', expected no such key"
    )
    refusal = refused(text.replace("message: Motion, signal: Speed", "column: v"))
    assert refusal == (
        f"truck.yaml:{line}: signals.vehicle_speed.source: found 3, expected no such key: "
        "a column has no address"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'SG_ Torque : 0|16@1- (1,0) [0|0] "Nm" X\n\nSIG_VALTYPE_ 256 Torque : 1;',
            "float signal of this width",
        ),
        ('SG_ Torque : 64|16@1+ (1,0) [0|0] "Nm" X', "signal beyond the eighth byte of a frame"),
        (
            'SG_ Deep m0M : 0|8@1+ (1,0) [0|0] "" X\n SG_ Top M : 8|8@1+ (1,0) [0|0] "" X\n'
            ' SG_ Torque m3 : 16|16@1+ (1,0) [0|0] "Nm" X\n\nSG_MUL_VAL_ 256 Torque Deep 3-3;\n'
            "SG_MUL_VAL_ 256 Deep Top 0-0;",
            "multiplexed more than one level deep",
        ),
    ],
)
def test_a_signal_that_no_frame_can_carry_names_its_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "own.dbc").write_text(f'VERSION ""\n\nBU_: X\n\nBO_ 256 Motor: 12 X\n {text}\n')
    config = tmp_path / "own.yaml"
    mapped = "  engine_torque: {message: Motor, signal: Torque, validity: full}"
    lines = [x for x in TRUCK.splitlines() if not x.strip().startswith("engine_torque_pct")]
    lines.insert(lines.index("signals:") + 1, mapped)
    config.write_text("\n".join(lines).replace("[j1939.dbc]", "[j1939.dbc, own.dbc]"))
    with pytest.raises(ConfigError) as caught:
        Pipeline(load_config(config))
    line = line_with(config.read_text(), "engine_torque:")
    assert str(caught.value).startswith(f"{config}:{line}: signals.engine_torque: ")
    assert words in str(caught.value)


def test_a_dbc_beside_its_config_is_found_from_anywhere_and_comes_before_the_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "truck"
    folder.mkdir()
    ours = (shipped("dbc") / "j1939.dbc").read_text().replace(" EngSpeed ", " Revolutions ")
    (folder / "j1939.dbc").write_text(ours)
    (folder / "truck.yaml").write_text(TRUCK.replace("signal: EngSpeed,", "signal: Revolutions,"))
    monkeypatch.chdir(tmp_path)
    config = load_config("truck/truck.yaml")
    monkeypatch.chdir("/")
    decoder_for(config)
    assert config.dbc == (str(folder / "j1939.dbc"),)
    assert load_config("class8").dbc == ("j1939.dbc",)


def test_a_model_without_torque_or_speed_names_what_it_needs() -> None:
    def without(*roles: str) -> str:
        return "\n".join(x for x in TRUCK.splitlines() if not x.strip().startswith(roles))

    speeds = ("output_shaft_speed:", "undriven_speed:", "engine_speed:", "vehicle_speed:")
    half = without("engine_torque_pct:").replace(
        "signals:", "signals:\n  half_shaft_torque_left: {column: left}"
    )
    for text, line, words in (
        (without("engine_torque_pct:"), "signals:", "signals: no torque, expected engine_torque_pct"),
        (half, "signals:", "signals: no torque, .*both half-shaft"),
        (without(*speeds), "signals:", "signals: no speed, expected output_shaft"),
        (
            without("gear_ratio:", "gear:", "output_shaft_speed:", "vehicle_speed:"),
            "signals:",
            "signals: no signal shows which of the 10 vehicle.gear_ratios is engaged, expected gear_ratio",
        ),
        (
            without(*(s for s in speeds if s != "engine_speed:"), "driveline_", "lockup_", "clutch_"),
            "signals:",
            "signals: engine_speed is the only speed, and no signal shows when the clutch is open, expected",
        ),
        (without("reference_torque"), "vehicle:", "vehicle.reference_torque_Nm: is missing"),
    ):
        with pytest.raises(ConfigError, match=f"^truck.yaml:{line_with(text, line)}: {words}"):
            Pipeline(read_databases(parse_config(text, "truck.yaml")))


@pytest.mark.parametrize(
    ("entry", "mark", "words"),
    [
        (
            "name: magic",
            "magic",
            "estimator.name: unknown estimator, found 'magic', expected one of",
        ),
        (
            "name: rlsmf\n  options:\n    window_s: 2\n    forgeting: 0.9",
            "forgeting",
            "estimator.options.forgeting: unknown option, found 'forgeting', "
            "expected an option, perhaps forgetting_mass",
        ),
        (
            "name: rlsmf\n  options: {forgetting_mass: 3}",
            "forgetting_mass",
            "estimator.options.forgetting_mass: wrong value, found 3, expected less than or equal to 1",
        ),
        (
            "name: rlsmf\n  options:\n    preset: '1999'",
            "preset",
            "estimator.options.preset: unknown preset, found '1999', expected one of 2005",
        ),
    ],
)
def test_a_mistake_in_the_estimator_names_its_line(entry: str, mark: str, words: str) -> None:
    sections = re.sub(r"^estimator:(\n .*)+", "", TRUCK, flags=re.MULTILINE)
    text = f"{sections}\nestimator:\n  {entry}\n"
    with pytest.raises(ConfigError) as caught:
        Pipeline(read_databases(parse_config(text, "truck.yaml")))
    assert str(caught.value).startswith(f"truck.yaml:{line_with(text, mark)}: {words}")


def test_an_option_of_an_override_is_named_as_such() -> None:
    config = parse_config(TRUCK, overrides=["estimator.name=rls", "estimator.options.forgeting=0.9"])
    with pytest.raises(ConfigError, match=r"^--set: estimator\.options\.forgeting: unknown option"):
        Pipeline(read_databases(config))


def test_an_effect_in_a_gear_that_the_vehicle_has_not() -> None:
    entry = "effects:\n  - {effect: driveline_loss, loss: 0.1, gear: 11}\n"
    message = refused(f"{TRUCK}\n{entry}")
    line = line_with(f"{TRUCK}\n{entry}", "gear: 11")
    assert message.startswith(
        f"truck.yaml:{line}: effects.0.gear: no gear of this vehicle, found 11, expected"
    )
    assert "1, 2, 3, 4, 5, 6, 7, 8, 9, 10 (vehicle.gear_ratios)" in message
    # without a table only the bus knows the gears
    bare = ["vehicle.gear_ratios={}", "effects=[{effect: driveline_loss, gear: 11}]"]
    assert parse_config(TRUCK, overrides=bare).effects[0]["gear"] == 11
    assert "found 11, expected null" in refused(TRUCK, *bare, "signals.gear=null")


def test_a_channel_may_be_a_number() -> None:
    assert parse_config(TRUCK, "truck.yaml", ["bus={interface: kvaser, channel: 0}"]).bus.channel == "0"
    assert "bus.channel" in refused(TRUCK, "bus.channel=[0]")
    assert "bus.channel" in refused(TRUCK, "bus.channel=1.5")


def test_a_key_of_a_section_leaves_its_others_at_their_defaults() -> None:
    plain = parse_config(TRUCK, "truck.yaml").gates
    for name, gate in plain:
        if "recovery_s" in type(gate).model_fields:
            changed = parse_config(TRUCK, "truck.yaml", [f"gates.{name}.enabled=false"]).gates
            assert getattr(changed, name).recovery_s == gate.recovery_s, name
