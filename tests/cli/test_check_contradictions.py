"""The doctor on signals that contradict each other, their DBC, or what vehicles do."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from canest.config import load_config, parse_config, read_databases
from canest.core.errors import ConfigError
from canest.core.frames import FrameBlock
from canest.doctor.check import Doctor
from canest.doctor.config_warnings import config_warnings
from canest.doctor.facts import FactsCheck
from canest.logs import open_log
from tests.pulsing_truck import config_of, write_drive

VEHICLE = """
vehicle: {mass_min_kg: 800, mass_max_kg: 5000, wheel_radius_m: 0.34, final_drive: 4.0, drag_area_m2: 2.0,
  rolling_resistance: 0.01, gear_ratios: {1: 4.0, 2: 2.5, 3: 1.6, 4: 1.0}}
dbc: [DBC]
signals:
"""
DBC = """VERSION ""
BU_: X
BO_ 257 MOT: 8 X
 SG_ Torque : 0|12@1+ (0.125,-100) [0|0] "TORQUE" X
 SG_ EngSpeed : 16|16@1- (1,0) [0|0] "rpm" X
 SG_ Speed : 32|16@1+ (0.01,0) [0|0] "mph" X
 SG_ Gear : 48|4@1+ (1,0) [0|15] "" X
 SG_ Brake : 52|2@1+ (1,0) [0|3] "" X
"""
TORQUE = "  engine_torque: {message: MOT, signal: Torque, validity: full}\n"
SPEED = "  vehicle_speed: {message: MOT, signal: Speed}\n"
GEAR = "  gear: {message: MOT, signal: Gear}\n"
ENGINE = "  engine_speed: {message: MOT, signal: EngSpeed}\n"


def config(tmp_path, *signals, unit="Nm"):
    (tmp_path / "x.dbc").write_text(DBC.replace("TORQUE", unit))
    return read_databases(parse_config(VEHICLE.replace("DBC", str(tmp_path / "x.dbc")) + "".join(signals)))


def seconds(values, step_s=0.02):
    """Return samples of values that follow each other."""
    return np.arange(len(values), dtype=np.int64) * int(step_s * 1e6), np.asarray(values, np.float64)


def facts_hints(config, **samples):
    check = FactsCheck(config)
    check.push({role: seconds(values) for role, values in samples.items()})
    return check.hints()


def test_pounds_and_feet_are_a_torque(tmp_path):
    found = config(tmp_path, TORQUE, SPEED, GEAR, ENGINE, unit="ft-lb")
    hundred = np.full(50, 1600, np.uint64)
    torque = next(role for role in report(found, hundred).roles if role.role == "engine_torque")
    assert torque.low == pytest.approx(135.58179)


def test_a_unit_that_contradicts_the_dbc_is_named(tmp_path):
    stated = SPEED.replace("}", ", unit: km/h}")
    (note,) = config_warnings(config(tmp_path, TORQUE, stated, GEAR, ENGINE))
    assert note == "signals.vehicle_speed.unit: km/h counts, though the DBC says mph of MOT.Speed"
    assert not config_warnings(config(tmp_path, TORQUE, SPEED.replace("}", ", unit: mph}"), GEAR, ENGINE))


def test_a_torque_beside_the_one_that_counts_is_named(tmp_path):
    more = "  wheel_torque: {message: MOT, signal: Torque}\n"
    (note,) = config_warnings(config(tmp_path, TORQUE, more, SPEED, GEAR, ENGINE))
    assert note.startswith("signals.wheel_torque is the torque that counts")
    assert "engine_torque is mapped too, and neither added nor compared" in note
    halves = "".join(
        f"  half_shaft_torque_{s}: {{message: MOT, signal: Torque}}\n" for s in ("left", "right")
    )
    assert not config_warnings(config(tmp_path, halves, SPEED, ENGINE))


def test_without_an_engine_speed_nothing_checks_the_ratio(tmp_path):
    (note,) = config_warnings(config(tmp_path, TORQUE, SPEED, GEAR))
    assert note.startswith("no signals.engine_speed") and note.endswith("(MOT.EngSpeed could)")


def test_speeds_of_the_road_that_differ_are_named(tmp_path):
    found = config(tmp_path, TORQUE, SPEED, GEAR, "  gps_speed: {message: MOT, signal: Speed}\n")
    speed = 10.0 + np.arange(1000) * 0.01
    (hint,) = facts_hints(found, vehicle_speed=speed * 1.609344, gps_speed=speed)
    assert hint.startswith("gps_speed is 0.621 times vehicle_speed, as it is when mph is taken for km/h")
    assert not facts_hints(found, vehicle_speed=speed * 1.05, gps_speed=speed)


@pytest.mark.parametrize(
    ("role", "unit", "turned", "sound", "words"),
    [
        ("engine_speed", "rpm", -1500.0, 1500.0, "never positive"),
        ("retarder_torque_pct", "'%'", 40.0, -40.0, "never negative"),
    ],
)
def test_a_sign_that_is_turned_is_named(tmp_path, role, unit, turned, sound, words):
    found = config(
        tmp_path, TORQUE, SPEED, GEAR, f"  {role}: {{message: MOT, signal: EngSpeed, unit: {unit}}}\n"
    )
    (hint,) = facts_hints(found, **{role: np.full(200, turned)})
    assert f"signals.{role}" in hint and words in hint and "scale: -1" in hint
    assert not facts_hints(found, **{role: np.full(200, sound)})
    assert not facts_hints(found, **{role: np.repeat([turned, sound], 100)})  # backwards for a while


def test_a_shift_that_lasts_and_a_lockup_at_walking_pace_are_inverted(tmp_path):
    states = "".join(
        f"  {r}: {{message: MOT, signal: Brake}}\n" for r in ("shift_in_process", "lockup_engaged")
    )
    found = config(tmp_path, TORQUE, SPEED, GEAR, ENGINE, states)
    speed = np.repeat([1.0, 15.0], 2000)
    fast, brief = speed > 8.0, np.arange(4000) % 400 < 40
    right = {"vehicle_speed": speed, "lockup_engaged": fast, "shift_in_process": brief}
    assert not facts_hints(found, **right)
    shift, lockup = facts_hints(found, **{**right, "lockup_engaged": ~fast, "shift_in_process": ~brief})
    assert "shift_in_process is on in 36 of 40 s of driving" in shift
    assert "needs invert: true" in shift and "signals.lockup_engaged needs invert: true" in lockup


def report(found, words):
    doctor = Doctor(found)
    n = len(words)
    doctor.push(
        FrameBlock(
            np.arange(n, dtype=np.int64) * 20_000,
            np.full(n, 257, np.uint32),
            np.full(n, 8, np.uint8),
            np.asarray(words, np.uint64),
        )
    )
    return doctor.report()


def test_a_field_that_leaps_to_its_last_number_has_no_value(tmp_path):
    found = config(tmp_path, TORQUE, SPEED, GEAR, ENGINE)
    word = np.where(np.arange(1000) % 100 < 10, 4095, 1600 + np.arange(1000) % 50)
    (hint,) = [h for h in report(found, word).hints if "4095" in h]
    assert "100 of 1,000 samples hold raw number 4095, the last one of Torque" in hint
    assert "leave validity: full out" in hint
    ramp = np.minimum(np.arange(1000) * 5, 4095)  # a full scale that is reached step by step
    assert not [h for h in report(found, ramp).hints if "4095" in h]


def test_a_brake_of_one_and_two_gets_a_map(tmp_path):
    found = config(tmp_path, TORQUE, SPEED, GEAR, ENGINE, "  brake_switch: {message: MOT, signal: Brake}\n")
    brake = np.where(np.arange(1000) % 100 < 30, 1, 2).astype(np.uint64) << np.uint64(52)
    (hint,) = [h for h in report(found, brake).hints if "paste" in h]
    assert hint.endswith("paste map: {1: 1, 2: 0}, or the other way round")


def test_a_ratio_without_steps_is_no_gearbox(tmp_path):
    found = config(tmp_path, TORQUE, SPEED, ENGINE)
    found = found.model_copy(update={"vehicle": found.vehicle.model_copy(update={"gear_ratios": {}})})
    n = 15_000
    level = np.round(np.linspace(0.0, 1.0, n // 500) * 9) / 9  # stays for 10 s, then another one
    ratio = np.repeat(2.4 * 0.45**level, 500)
    speed = np.full(n, 15.0)
    (hint,) = facts_hints(
        found, engine_speed=ratio * 15.0 / found.vehicle.mps_per_shaft_rpm, vehicle_speed=speed
    )
    assert "turn in ratios without steps, 1.08 to 2.4" in hint and "signals.gear_ratio" in hint


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive"), 60)


def test_a_reference_torque_that_never_came_is_named(drive):
    with open_log(drive) as log:
        doctor = Doctor(
            config_of(drive, "signals.reference_torque={message: RC, signal: RetarderReferenceTorque}")
        )
        for block in log:
            doctor.push(block)
        hints = doctor.report().hints
    assert any("reference_torque (SPN 544) is mapped and never came: the 2,100 N m" in h for h in hints)


def test_replay_names_a_message_that_no_role_takes(canest, tmp_path, drive):
    log = tmp_path / "with.log"
    lines = drive.read_text().splitlines(keepends=True)
    stamp, channel, _ = lines[len(lines) // 2].split(maxsplit=2)
    lines.insert(len(lines) // 2, f"{stamp} {channel} 18F0000F#FFFFFFFFFFFFFFFF\n")
    log.write_text("".join(lines))
    without = drive.parent / "without.yaml"
    text = drive.with_suffix(".yaml").read_text()
    without.write_text(re.sub(r"  retarder_torque_pct:\n(    .*\n)+", "", text))
    assert "retarder_torque_pct" not in load_config(without).signals
    notes = json.loads(canest("replay", log, "-c", without, "--json", "-").out)["notes"]
    assert any("the bus has ERC1, and no role takes it" in note for note in notes)


def test_a_table_that_is_no_log_is_named(canest, tmp_path):
    path = tmp_path / "t.yaml"
    text = VEHICLE.replace("dbc: [DBC]", "dbc: []").replace(
        ", gear_ratios: {1: 4.0, 2: 2.5, 3: 1.6, 4: 1.0}", ""
    )
    path.write_text(f"{text}  engine_torque: {{column: tq}}\n  vehicle_speed: {{column: v}}\n")
    log = tmp_path / "milliseconds.csv"
    log.write_text("t_s,tq,v\n" + "".join(f"{i * 100},100,{i / 10}\n" for i in range(6000)))
    found = canest("check", log, "-c", path)
    assert found.code == 1 and f"{log}: column t_s: most rows come more than" in found.err


def test_a_label_that_yaml_takes_for_a_switch_is_explained(tmp_path):
    mapped = "  brake_switch: {message: MOT, signal: Brake, map: {no: 0, yes: 1}}\n"
    with pytest.raises(ConfigError, match="YAML reads a bare yes, no, true or false as on or off"):
        Doctor(config(tmp_path, TORQUE, SPEED, GEAR, ENGINE, mapped))
