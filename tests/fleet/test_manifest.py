"""Which vehicle and config a log has: the rules, the VIN in the log, and the names that the lake gives."""

from __future__ import annotations

from pathlib import Path

import pytest

from canest.core.errors import ConfigError, LogError
from canest.decode.j1939 import TP_CM_PGN, TP_DT_PGN, pack
from canest.fleet.manifest import Rule, read_manifest
from canest.fleet.process_log import choose_by_vin
from canest.fleet.source import find_logs, fits
from canest.fleet.vehicle_names import folder_of, read_key, vehicle_name, vehicle_of
from canest.fleet.vin import vin_of

VIN = "1FUJGLDR0CSBM1234"


def manifest(folder: Path, text: str, name: str = "fleet.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def vin_log(folder: Path, *sent: tuple[int, str]) -> Path:
    """Write a log in which addresses send VINs as broadcasts of three packets."""
    lines, t_s = [], 100.0
    for source, vin in sent:
        payload = vin.encode() + b"*"
        frames = [(TP_CM_PGN, bytes([32, len(payload), 0, 3, 0xFF, 0xEC, 0xFE, 0]))]
        padded = payload.ljust(21, b"\xff")
        frames += [(TP_DT_PGN, bytes([n + 1]) + padded[7 * n : 7 * n + 7]) for n in range(3)]
        for pgn, data in frames:
            t_s += 0.05
            lines.append(f"({t_s:.6f}) can0 {pack(pgn, source, 7) & 0x1FFFFFFF:08X}#{data.hex().upper()}")
    path = folder / "vin.log"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_first_rule_that_fits_counts(tmp_path):
    rules = read_manifest(manifest(
        tmp_path, "pattern,vehicle,config\n# comment\na/*,first,kenworth\n*.log,second,class8\n"
    ))  # fmt: skip
    assert [r.vehicle for r in rules.rules_for("a/b/x.log")] == ["first"]
    assert [r.vehicle for r in rules.rules_for("b/x.log")] == ["second"]
    assert rules.rules_for("b/x.blf") == []


def test_a_pattern_without_folder_is_one_of_names():
    assert fits("deep/down/x.log", "x.*")
    assert not fits("deep/x/y.log", "x*")
    assert fits("deep/x/y.log", "deep/*")
    assert fits("odd[1].log", "odd[1].log")


def test_yaml_and_csv_mean_the_same(tmp_path):
    (tmp_path / "t.yaml").write_text("")
    yaml = read_manifest(manifest(
        tmp_path, "logs:\n- {pattern: 'a/*', vehicle: 7, config: t.yaml}\nvins: {1FUJ*: class8}\n", "f.yaml"
    ))  # fmt: skip
    csv = read_manifest(manifest(tmp_path, "pattern,vehicle,config\nvin:1FUJ*,,class8\na/*,7,t.yaml\n"))
    message = [[(r.pattern, r.vehicle, r.config) for r in m.rules] for m in (yaml, csv)]
    assert message[0] == message[1]
    assert csv.rules[1].config == str(tmp_path / "t.yaml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("file,truck\n", "fleet.csv:1: not the header of a manifest, found 'file,truck'"),
        ("pattern,vehicle,config\na,b\n", "fleet.csv:2: row of a manifest, found '2 cells'"),
        ("pattern,vehicle,config\n*,t,\n", "fleet.csv:2: config: is empty"),
        ("pattern,vehicle,config\n", "fleet.csv: the manifest has no rules"),
    ],
)
def test_mistakes_name_their_line(tmp_path, text, complaint):
    with pytest.raises(ConfigError) as caught:
        read_manifest(manifest(tmp_path, text))
    assert complaint in str(caught.value)


def test_the_vin_in_a_log_leads_to_vehicle_and_config(tmp_path):
    log = vin_log(tmp_path, (0x00, VIN), (0x21, "1XKYDP9X0EJ400000"))
    assert vin_of(log).vin == VIN
    rules = [(Rule("vin:1XK*", "", "a"), "A"), (Rule("vin:1FUJ*", "", "b"), "B")]
    assert choose_by_vin(rules, log) == (VIN, "B")
    assert choose_by_vin([(Rule("*", "", "c"), "C")], log) == (VIN, "C")
    assert choose_by_vin(rules[:1], log) == "no rule of the manifest fits the VIN in the log"


def test_what_no_vin_decides_is_not_guessed(tmp_path):
    rules = [(Rule("*", "", "c"), "C")]
    several = vin_log(tmp_path, (0x0B, VIN), (0x21, "1XKYDP9X0EJ400000"))
    assert choose_by_vin(rules, several) == "the log carries 2 different VINs, and none of the engine"
    (tmp_path / "none.log").write_text("(1.000000) can0 18FEF100#0000000000000000\n")
    # -c CONFIG is this rule alone: no manifest is blamed
    way_out = choose_by_vin(rules, tmp_path / "none.log")
    assert way_out.startswith("the log carries no VIN: name its vehicle in the column vehicle of a manifest")
    by_vin = [(Rule("vin:1FUJ*", "truck", "c"), "C")]
    assert choose_by_vin(by_vin, tmp_path / "none.log").endswith("and the log carries no VIN")


def test_vins_are_hashed_with_a_key_and_fleet_numbers_are_not(tmp_path):
    (tmp_path / "key").write_bytes(b"k" * 32)
    key = read_key(str(tmp_path / "key"))
    hashed = vehicle_name(VIN, key)
    assert hashed == vehicle_name(VIN.lower(), key)
    assert hashed.startswith("vin-")
    assert VIN not in hashed
    assert hashed != vehicle_name(VIN, b"l" * 32)
    assert vehicle_name("truck 7", key) == "truck 7"
    assert vehicle_name(VIN, None) == VIN


@pytest.mark.parametrize("name", ["truck 7", "a/b", "50%", "Müller", "x=y", "..", "?"])
def test_any_name_can_be_a_folder(name, tmp_path):
    (tmp_path / folder_of(name)).mkdir()
    assert vehicle_of(folder_of(name)) == name


def test_a_folder_gives_logs_and_passes_over_the_rest(tmp_path):
    for name in ("a/x.log", "a/y.MF4.gz", "a/x.truth.csv", "notes.md", ".hidden/z.log", "b [1]/w.asc"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    listing = find_logs(str(tmp_path))
    assert [log.name for log in listing.logs] == ["a/x.log", "a/y.MF4.gz", "b [1]/w.asc"]
    assert listing.passed_over == [".hidden/z.log", "a/x.truth.csv", "notes.md"]
    assert [log.name for log in find_logs(f"{tmp_path}/**/*.log").logs] == [".hidden/z.log", "a/x.log"]
    assert [log.name for log in find_logs(f"{tmp_path}/a/x.log").logs] == ["x.log"]
    assert [log.name for log in find_logs(f"{tmp_path}/b [1]").logs] == ["w.asc"]
    with pytest.raises(LogError, match="no logs there"):
        find_logs(str(tmp_path / "nowhere"))
