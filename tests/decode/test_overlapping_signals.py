"""A database whose signals overlap, or whose messages share a name or identifier, is loaded, with a note."""

import pytest

import canest
from canest.cli.main import run
from canest.config.database_files import read_database
from canest.core.errors import ConfigError
from canest.decode.database import overlap_warnings
from canest.doctor.config_warnings import config_warnings

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


SECOND = 'BO_ 256 Other: 8 E\n SG_ Level : 0|8@1+ (1,0) [0|0] "%" E\n'


def test_messages_of_one_identifier_are_named(config, capsys):
    (config.parent / "car.dbc").write_text(DBC.replace("8|8@1+", "48|8@1+") + SECOND)
    assert run(["check", "-c", str(config)]) == 0
    done = capsys.readouterr()
    assert "messages Motor (car.dbc) and Other (car.dbc) have the same identifier 0x100" in done.out
    assert "Overwriting" not in done.err


def test_a_message_of_two_files_is_named(config, tmp_path):
    (tmp_path / "more.dbc").write_text(DBC.replace("256", "257"))
    config.write_text(config.read_text().replace("car.dbc]", f"car.dbc, {tmp_path}/more.dbc]"))
    notes = config_warnings(canest.load_config(config))
    assert "message Motor is in car.dbc and in more.dbc: the first one is used" in notes


def test_messages_that_are_not_used_may_be_the_same(config):
    sound = DBC.replace("8|8@1+", "48|8@1+")
    (config.parent / "car.dbc").write_text(sound + SECOND.replace("256", "257") * 2)
    assert not config_warnings(canest.load_config(config))


def test_a_signal_beyond_its_message_is_still_refused(tmp_path):
    path = tmp_path / "long.dbc"
    path.write_text(DBC.replace("16|16@1+", "56|16@1+"))
    with pytest.raises(ConfigError, match="does not fit"):
        read_database(path)


def test_a_sound_database_has_nothing_to_report(tmp_path):
    path = tmp_path / "sound.dbc"
    path.write_text(DBC.replace("8|8@1+", "32|8@1+"))
    assert not overlap_warnings([read_database(path)])
