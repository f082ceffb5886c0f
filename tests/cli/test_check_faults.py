"""The doctor on faults that a user makes: it is not ready, and the line to mend is in its words."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

from canest.cli import check_view
from canest.config import load_config, parse_config, read_databases
from canest.core.frames import ERROR, EXTENDED, FrameBlock
from canest.doctor.check import Doctor
from canest.doctor.constant_torque import constant_torque_hints
from canest.doctor.facts import FactsCheck
from canest.doctor.signal_report import RoleReport
from canest.doctor.switches import SwitchCheck
from canest.doctor.torque_samples import TorqueSampleCheck
from canest.logs import open_log
from tests.cli.conftest import KENWORTH
from tests.pulsing_truck import config_of, write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive"), 120)


def report(drive, *overrides, without=()):
    return report_of(config_of(drive, *overrides, without=without), drive)


def report_of(config, path):
    doctor = Doctor(config)
    with open_log(path) as log:
        for block in log:
            doctor.push(block)
    return doctor.report()


def test_a_config_that_fits_is_ready(drive):
    found = report(drive)
    assert found.ready and not found.stops and not found.hints


def test_an_inverted_driveline_is_not_ready_and_named(drive):
    found = report(drive, "signals.driveline_engaged.invert=true")
    assert not found.ready and "driveline" in found.stops
    assert any("driveline_engaged is open" in h and h.endswith("invert: false") for h in found.hints)


def test_hardly_any_open_sample_is_not_ready(canest, drive):
    """A few samples come through before the first frame of the message: 24 of 14,999 were 'ready'."""
    late = drive.read_text().splitlines(keepends=True)
    gone = [line for i, line in enumerate(late) if "FEF1" not in line or i > len(late) // 40]
    path = drive.with_name("late.log")
    path.write_text("".join(gone))
    done = canest(
        "check", "-c", drive.with_suffix(".yaml"), path, "--strict", "--json", "-",
        "--set", "signals.brake_switch.invert=true", "--set", "signals.brake_switch.stale_s=1",
    )  # fmt: skip
    found = json.loads(done.out)
    assert done.code == 1 and found["ready"] is False
    assert 0 < found["updated"] < 0.05 * found["samples"]
    assert found["stops"].startswith("hardly any sample may be learned from, ")
    assert any("brake_switch is on" in h for h in found["hints"])


def test_a_missing_gear_table_is_measured(drive):
    for without in (("gear_ratio",), ("gear_ratio", "gear")):
        found = report(drive, "vehicle.gear_ratios={}", without=without)
        assert found.stops.startswith("vehicle.gear_ratios is missing")
        line = found.stops.split("gear_ratios: ")[1].split("}")[0] + "}"
        table = parse_config_ratios(line)
        assert {round(r, 2) for r in table.values()} >= {1.0, 0.74}
        if "gear" not in without:
            assert table[9] == pytest.approx(1.0, rel=0.01) and table[10] == pytest.approx(0.74, rel=0.01)


def test_what_a_shift_passes_is_no_gear():
    """The Kenworth passes 2.3 on its way from first to second, and stays in 1.81, 1.41 and 1.00."""
    config = load_config("kenworth", ["vehicle.gear_ratios={}"])
    signals = {role: s for role, s in config.signals.items() if role not in ("gear", "gear_ratio")}
    found = report_of(config.model_copy(update={"signals": signals}), KENWORTH)
    table = parse_config_ratios(found.stops.split("gear_ratios: ")[1].split("}")[0] + "}")
    assert list(table.values()) == pytest.approx([1.81, 1.41, 1.0], rel=0.01)
    assert found.stops.endswith("numbered from the largest that stayed in for a second")


def parse_config_ratios(line: str) -> dict[int, float]:
    import yaml

    return yaml.safe_load(line)


def test_a_wrong_axle_names_both_suspects(drive):
    (hint_text,) = report(drive, "vehicle.final_drive=3.0").hints
    assert "wheel_radius_m 0.402" in hint_text and "or with final_drive 3.73" in hint_text


def seconds(n: int) -> np.ndarray:
    return np.arange(n, dtype=np.int64) * 100_000


def hints_of_switches(n=600, **values) -> list[str]:
    config = load_config("class8")
    switches = SwitchCheck(config)
    t_us = seconds(n)
    speed = 10 + 5 * np.sin(t_us / 5e6)
    samples = {
        "vehicle_speed": speed,
        "engine_torque_pct": 50 + 45 * np.cos(t_us / 5e6),
        **values,
    }
    for first in range(0, n, 100):
        rows = slice(first, first + 100)
        switches.push({r: (t_us[rows], np.broadcast_to(v, n)[rows] * 1.0) for r, v in samples.items()})
    return switches.hints()


def test_a_brake_that_is_always_on_is_named():
    (hint_text,) = hints_of_switches(brake_switch=1.0)
    assert "brake_switch is on" in hint_text and "all the time" in hint_text
    assert hints_of_switches(brake_switch=0.0) == []


def hints_of_braking(most_mps2, **values) -> list[str]:
    """Return what is said of a brake while the vehicle slows down once in 20 s, for 10 s and by so much."""
    facts = FactsCheck(load_config("class8"))
    t_us = seconds(2000)
    samples = {
        "vehicle_speed": 18 + most_mps2 * 20 / (2 * np.pi) * np.cos(t_us / 10e6 * np.pi),
        "engine_torque_pct": np.maximum(0.0, -40 * np.sin(t_us / 10e6 * np.pi)),
        "brake_switch": 0.0,
        **values,
    }
    for first in range(0, 2000, 77):
        rows = slice(first, first + 77)
        facts.push({r: (t_us[rows], np.broadcast_to(v, 2000)[rows] * 1.0) for r, v in samples.items()})
    return [hint for hint in facts.hints() if "never reported a brake" in hint]


def test_a_brake_that_is_never_reported_is_named():
    (hint_text,) = hints_of_braking(3.0)
    assert hint_text.startswith("brake_switch never reported a brake, though the vehicle slowed down for ")
    assert "assume_when_pedal_released" in hint_text


@pytest.mark.parametrize(
    ("most_mps2", "values"),
    [
        (1.5, {}),
        (3.0, {"brake_switch": np.arange(2000) == 1000}),
        (3.0, {"brake_pedal": 20.0}),
        (3.0, {"brake_switch": np.nan}),
        (3.0, {"engine_torque_pct": -40.0}),
        (3.0, {"retarder_torque_pct": -40.0}),
    ],
)
def test_no_brake_is_missed_where_none_is_needed_or_one_is_reported(most_mps2, values):
    assert hints_of_braking(most_mps2, **values) == []


def test_a_clutch_that_never_opens_is_named():
    standing = {"vehicle_speed": 0.0, "engine_speed": 600.0, "gear": 1.0, "driveline_engaged": 1.0}
    (hint_text,) = hints_of_switches(**standing)
    assert "driveline_engaged never reported an open clutch" in hint_text
    opens = np.ones(600)
    opens[300:] = 0.0
    assert hints_of_switches(**{**standing, "driveline_engaged": opens}) == []
    assert hints_of_switches(**{**standing, "gear": 0.0}) == []


@pytest.mark.parametrize(
    ("number", "hint_text"), [(0.0, "exactly zero"), (125.0, "exactly 125, the largest")]
)
@pytest.mark.parametrize("cut", [3, 1000])
def test_single_torques_of_a_fixed_number_are_named(number, hint_text, cut):
    t_us = np.arange(1000, dtype=np.int64) * 20_000
    torque = 50 + 20 * np.sin(t_us / 1e6)
    torque[50::100] = number
    judge = TorqueSampleCheck(load_config("class8"))
    for first in range(0, 1000, cut):
        judge.push({"engine_torque_pct": (t_us[first : first + cut], torque[first : first + cut])})
    (hint,) = judge.hints()
    assert f"engine_torque_pct reads {hint_text}" in hint and "in 10 single samples (1 %)" in hint


@pytest.mark.parametrize(
    ("torque", "speed", "named"),
    [((0.0, 0.0), (0.0, 20.0), True), ((0.0, 0.1), (0.0, 20.0), False), ((0.0, 0.0), (0.0, 0.0), False)],
)
def test_a_torque_that_never_changes_while_the_speed_does_is_named(torque, speed, named):
    found = [
        RoleReport(role, "", "needed", f"EEC1.{role}", 0, "%", low=low, high=high, values=1000)
        for role, (low, high) in {"engine_torque_pct": torque, "output_shaft_speed": speed}.items()
    ]
    hints = constant_torque_hints(load_config("class8"), found)
    assert ["EEC1.engine_torque_pct is always 0 %" in hint for hint in hints] == [True] * named


def test_a_torque_that_passes_zero_is_no_fault():
    t_us = np.arange(5000, dtype=np.int64) * 20_000
    judge = TorqueSampleCheck(load_config("class8"))
    judge.push({"engine_torque_pct": (t_us, np.round(30 * np.sin(t_us / 1e6)))})
    assert judge.hints() == []


@pytest.mark.parametrize(("first", "used"), [(0x31, 0x31), (0x00, 0x00)])
def test_of_several_senders_the_one_in_use_comes_first(first, used):
    """The estimator takes the first address with a value, here that of 36 km/h or 72 km/h."""
    config = load_config("class8")
    signals = {role: s.model_copy(update={"source": None}) for role, s in config.signals.items()}
    doctor = Doctor(config.model_copy(update={"signals": signals}))
    n, speed = 400, {0x00: 36 * 256, 0x31: 72 * 256}
    addresses = np.array([first, 0x31 - first] * (n // 2), np.uint32)
    words = np.array([0xFFFFFFFFFF0000FF | speed[a] << 8 for a in addresses.tolist()], np.uint64)
    ids = np.uint32(EXTENDED | 0x18FEF100) | addresses
    doctor.push(FrameBlock(np.arange(n, dtype=np.int64) * 50_000, ids, np.full(n, 8, np.uint8), words))
    found = doctor.report()
    speeds = role(found, "vehicle_speed")
    assert [s.address for s in speeds.senders] == [used, 0x31 - used] and speeds.verdict == "several"
    assert (speeds.low == pytest.approx(10.0)) == (used == 0x00)
    assert any(f"(0x{used:02X}, 0x{0x31 - used:02X}), 0x{used:02X} is used" in hint for hint in found.hints)


DBC = """VERSION ""
BU_: X
BO_ 416 Gearbox: 8 X
 SG_ Gear : 0|4@1+ (1,0) [0|15] "" X
 SG_ Brake : 4|2@1+ (1,0) [0|3] "" X
 SG_ Wheel : 16|16@1+ (0.01,0) [0|0] "km/h" X
 SG_ Torque : 32|16@1+ (0.1,0) [0|0] "Nm" X
VAL_ 416 Gear 1 "Gang_1" 2 "Gang_2" 3 "Gang_3" 4 "Neutral" 15 "SNA" ;
VAL_ 416 Brake 0 "off" 1 "on" 2 "on, by the hill holder" 3 "SNA" ;
"""
CONFIG = """
vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 4, drag_area_m2: 0.7,
  rolling_resistance: 0.01, gear_ratios: {1: 3.5, 2: 2.0, 3: 1.2}}
"""


def car(tmp_path, gear, brake, more=""):
    """Return the report on a bus of 11-bit identifiers."""
    (tmp_path / "car.dbc").write_text(DBC)
    text = (
        f"{CONFIG}\ndbc: [{tmp_path}/car.dbc]\nsignals:\n"
        "  gear: {message: Gearbox, signal: Gear" + more + "}\n"
        "  brake_switch: {message: Gearbox, signal: Brake}\n"
        "  vehicle_speed: {message: Gearbox, signal: Wheel}\n"
        "  engine_torque: {message: Gearbox, signal: Torque}\n"
    )
    config = read_databases(parse_config(text))
    n = len(gear)
    words = np.array(gear, np.uint64) | np.array(brake, np.uint64) << np.uint64(4)
    doctor = Doctor(config)
    doctor.push(
        FrameBlock(
            np.arange(n, dtype=np.int64) * 20_000, np.full(n, 416, np.uint32), np.full(n, 8, np.uint8), words
        )
    )
    return doctor.report()


def test_a_bus_of_other_11_bit_identifiers_is_shown_with_them(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    signals = "".join(
        f"  {role}: {{message: Gearbox, signal: {name}}}\n"
        for role, name in (("gear", "Gear"), ("vehicle_speed", "Wheel"), ("engine_torque", "Torque"))
    )
    text = f"{CONFIG}\ndbc: [{tmp_path}/car.dbc]\nsignals:\n{signals}"
    doctor = Doctor(read_databases(parse_config(text)))
    identifiers = np.array([0x111, 0x211, ERROR | 4], np.uint32)
    doctor.push(
        FrameBlock(np.arange(3) * 20_000, identifiers, np.full(3, 8, np.uint8), np.zeros(3, np.uint64))
    )
    (hint,) = [h for h in doctor.report().hints if "11-bit" in h]
    assert "a DBC that has 0x111, 0x211 is needed" in hint


def role(found, name):
    return next(finding for finding in found.roles if finding.role == name)


def test_labels_of_the_dbc_are_shown_and_a_map_is_proposed(tmp_path):
    found = car(tmp_path, [1, 2, 3, 4] * 100, [0] * 400)
    labels = {label.raw: (label.label, label.value, label.count) for label in role(found, "gear").labels}
    assert labels[3] == ("Gang_3", 3.0, 100) and labels[4] == ("Neutral", 4.0, 100)
    (hint_text,) = [h for h in found.hints if h.startswith("signals.gear")]
    assert hint_text.endswith("paste map: {Gang_1: 1, Gang_2: 2, Gang_3: 3, Neutral: 0}")
    assert any(entry["labels"] for entry in found.to_json()["roles"])
    pasted = car(
        tmp_path, [1, 2, 3, 4] * 100, [0] * 400, ", map: {Gang_1: 1, Gang_2: 2, Gang_3: 3, Neutral: 0}"
    )
    assert not [h for h in pasted.hints if h.startswith("signals.gear")]
    assert {label.raw: label.value for label in role(pasted, "gear").labels}[4] == 0.0


def test_a_rule_is_proposed_where_reserved_numbers_are_values(tmp_path):
    """Raw 2 of two bits is an error to J1939; a car's bus says something with it."""
    found = car(tmp_path, [1] * 400, ([0] * 10 + [2] * 10) * 20)
    (hint_text,) = [h for h in found.hints if "signals.brake_switch" in h]
    assert "200 of 400 samples" in hint_text and "2 'on, by the hill holder'" in hint_text
    assert hint_text.endswith("paste validity: full")
    mixed = car(tmp_path, [1] * 400, ([0] * 10 + [2] * 9 + [3]) * 20)
    assert any(h.endswith("paste map: {0: 0, 2: 2}") for h in mixed.hints)


@pytest.mark.parametrize("brake", [[3] * 400, ([0] * 10 + [3] * 10) * 20, [0] * 398 + [2] * 2])
def test_no_rule_is_proposed_for_what_is_no_value(tmp_path, brake):
    assert not [h for h in car(tmp_path, [1] * 400, brake).hints if "validity" in h]


def test_text_in_a_column_is_proposed_as_a_map(canest, tmp_path):
    rows = "".join(f"{i / 10},{('D1', 'D2', 'N')[i % 3]},36\n" for i in range(90))
    (tmp_path / "t.csv").write_text("t_s,gang,v\n" + rows)
    config = tmp_path / "c.yaml"
    signals = "dbc: []\nsignals:\n  vehicle_speed: {column: v, unit: km/h}\n  engine_torque: {column: v}\n"
    signals += "  gear: {column: gang"
    config.write_text(f"{CONFIG}{signals}}}\n")
    found = json.loads(canest("check", "-c", config, tmp_path / "t.csv", "--json", "-").out)
    assert any(h.endswith("paste map: {D1: 1, D2: 2, N: 0}") for h in found["hints"])
    config.write_text(f"{CONFIG}{signals}, map: {{D1: 1, D2: 2, N: 0}}}}\n")
    found = json.loads(canest("check", "-c", config, tmp_path / "t.csv", "--json", "-").out)
    assert not any("holds text" in h for h in found["hints"] + found["notes"])
    gear = next(r for r in found["roles"] if r["role"] == "gear")
    assert gear["values"] == 90 and {x["label"]: x["value"] for x in gear["labels"]}["N"] == 0.0


def test_at_eighty_columns_problems_come_first_and_roles_are_folded(drive, monkeypatch):
    found = report(drive, "signals.driveline_engaged.invert=true")
    lines = {}
    for verbose in (False, True):
        stream = io.StringIO()
        stream.isatty = lambda: True
        monkeypatch.setattr("sys.stdout", stream)
        monkeypatch.setenv("COLUMNS", "80")
        monkeypatch.setenv("TERM", "dumb")
        check_view.show(found, "config: log", verbose)
        lines[verbose] = stream.getvalue().splitlines()
    short = lines[False]
    assert max(map(len, short)) <= 80
    assert short[1].startswith("stops") and any(line.startswith("hint") for line in short[2:6])
    assert len(short) < 40 < len(lines[True])
    assert any("also ok (-v shows them)" in line for line in short)
    assert not any(line.startswith(" barometric_pressure") for line in short)
    assert any(line.startswith(" barometric_pressure") for line in lines[True])
