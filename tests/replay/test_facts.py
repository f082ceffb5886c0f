"""What contradicts the config is a note of the replay, in the words of `canest check`."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import parse_config, read_databases
from canest.core.frames import FrameBlock
from canest.doctor.check import Doctor
from canest.logs import open_log
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from tests.pulsing_truck import config_of, write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive"), 120)


@pytest.mark.parametrize(
    ("overrides", "without", "note"),
    [
        ((), (), None),
        (
            ("vehicle.wheel_radius_m=0.55",),
            ("gear_ratio", "output_shaft_speed", "undriven_speed"),
            "engine and vehicle speed agree with wheel_radius_m 0.50",
        ),
        (("vehicle.gear_ratios={}",), ("gear_ratio",), "vehicle.gear_ratios is missing"),
        (("signals.driveline_engaged.invert=true",), (), "driveline_engaged is open"),
    ],
)
def test_what_contradicts_the_config_is_noted_as_check_names_it(drive, overrides, without, note):
    config = config_of(drive, *overrides, without=without)
    result = replay(drive, config)
    found = [text for text in result.warnings if "vehicle.gear_ratios" in text or "wheel_radius" in text]
    found += [text for text in result.warnings if "in which the vehicle pulls" in text]
    assert result.summary["notes"] == result.warnings
    if note is None:
        assert found == []
        return
    assert any(text.startswith(note) for text in found)
    doctor = Doctor(config)
    with open_log(drive) as log:
        for block in log:
            doctor.push(block)
    report = doctor.report()
    assert set(found) <= {*report.hints, report.stops}


@pytest.mark.parametrize(
    ("labels", "noted"), [("", True), ('VAL_ 290 Brake 2 "on" ;', True), ('VAL_ 290 Brake 2 "SNA" ;', False)]
)
def test_a_brake_whose_number_j1939_reserves_is_noted(tmp_path, labels, noted):
    dbc = f"""VERSION ""
BU_: E
BO_ 290 Car: 8 E
 SG_ Torque : 0|16@1- (0.1,0) [0|0] "Nm" E
 SG_ Speed : 16|16@1+ (0.01,0) [0|0] "km/h" E
 SG_ Brake : 32|2@1+ (1,0) [0|0] "" E
{labels}
"""
    (tmp_path / "car.dbc").write_text(dbc)
    text = f"""
vehicle:
  {{mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 4, drag_area_m2: 0.7,
   rolling_resistance: 0.01}}
dbc: [{tmp_path / "car.dbc"}]
signals:
  engine_torque: {{message: Car, signal: Torque}}
  vehicle_speed: {{message: Car, signal: Speed}}
  brake_switch: {{message: Car, signal: Brake}}
"""
    config = read_databases(parse_config(text, str(tmp_path / "car.yaml")))
    frames = []
    for i in range(2000):
        data = np.array([1000, 5000, 2 * (i % 500 > 400), 0], "<u2").tobytes()
        frames.append((20_000 * i, 290, data))
    result = replay(FrameLog(FrameBlock.from_frames(frames)), config)
    found = [text for text in result.warnings if "that J1939 reserves" in text]
    assert len(found) == noted
    if noted:
        assert found[0].startswith("brake_switch: 396 of 2,000 samples hold a number")
        assert "signals.brake_switch needs validity: full" in found[0]


def test_single_torques_of_a_fixed_number_are_noted_as_check_names_them(tmp_path):
    rows = [f"{i / 50},{0 if i % 100 == 50 else 200 + i % 7},{15 + 5 * np.sin(i / 80)}" for i in range(2000)]
    (tmp_path / "car.csv").write_text("\n".join(["t_s,tq,v", *rows]) + "\n")
    text = """
vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 4, drag_area_m2: 0.7,
  rolling_resistance: 0.01}
dbc: []
signals: {engine_torque: {column: tq, unit: Nm}, vehicle_speed: {column: v, unit: m/s}}
"""
    config = parse_config(text, str(tmp_path / "car.yaml"))
    doctor = Doctor(config)
    with open_log(tmp_path / "car.csv", columns=["tq", "v"]) as log:
        for block in log:
            doctor.push(block)
    (named,) = [hint for hint in doctor.report().hints if "exactly zero in 20 single samples" in hint]
    assert named in replay(tmp_path / "car.csv", config).warnings
