"""A database whose signals overlap is loaded, and every overlap is named."""

import pytest

import canest
from canest.cli.main import run
from canest.config.database_files import read_database
from canest.core.errors import ConfigError
from canest.decode.database import overlap_warnings

DBC = """VERSION ""
BU_: E
BO_ 256 Motor: 8 E
 SG_ Torque : 0|16@1+ (0.1,-500) [0|0] "Nm" E
 SG_ TorqueLow : 8|8@1+ (1,0) [0|0] "" E
 SG_ Speed : 16|16@1+ (0.01,0) [0|0] "km/h" E
"""
CONFIG = """
vehicle: {name: car, mass_min_kg: 1000, mass_max_kg: 2500, wheel_radius_m: 0.3, gear_ratios: {1: 9.0},
  final_drive: 1.0, drag_area_m2: 0.7, rolling_resistance: 0.01}
dbc: [DBC]
signals:
  engine_torque: {message: Motor, signal: Torque}
  vehicle_speed: {message: Motor, signal: Speed}
"""


@pytest.fixture
def config(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    path = tmp_path / "car.yaml"
    path.write_text(CONFIG.replace("DBC", str(tmp_path / "car.dbc")))
    return path


def test_overlapping_signals_are_loaded_and_named(config):
    database = read_database(config.parent / "car.dbc")
    assert {s.name for s in database.messages[0].signals} == {"Torque", "TorqueLow", "Speed"}
    (named,) = overlap_warnings([database])
    assert "TorqueLow" in named and "Torque " in named and "Motor" in named


def test_replay_and_check_report_it(config, tmp_path, capsys):
    log = tmp_path / "car.log"
    log.write_text("".join(f"({n * 0.02:.6f}) can0 100#A00F{n % 200:02X}0300000000\n" for n in range(200)))
    result = canest.replay(log, config)
    assert any("overlapping" in note for note in result.summary["notes"])
    for arguments in ([], [str(log)]):
        run(["check", "-c", str(config), *arguments])
        assert "overlapping in message Motor" in capsys.readouterr().out


def test_many_overlaps_are_counted(tmp_path):
    path = tmp_path / "many.dbc"
    messages = DBC[DBC.index("BO_") :]
    many = [messages.replace("256 Motor", f"{256 + n} Motor{n}") for n in range(5)]
    path.write_text(DBC[: DBC.index("BO_")] + "".join(many))
    *first, last = overlap_warnings([read_database(path)])
    assert len(first) == 3 and last.startswith("2 more messages")


def test_a_signal_beyond_its_message_is_still_refused(tmp_path):
    path = tmp_path / "long.dbc"
    path.write_text(DBC.replace("16|16@1+", "56|16@1+"))
    with pytest.raises(ConfigError, match="does not fit"):
        read_database(path)


def test_a_sound_database_has_nothing_to_report(tmp_path):
    path = tmp_path / "sound.dbc"
    path.write_text(DBC.replace("8|8@1+", "32|8@1+"))
    assert not overlap_warnings([read_database(path)])
