"""Databases that are missing, damaged or lack a signal: one line that says where and what is near."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from decode_helpers import shipped_database, wants

from canest.config import load_config
from canest.config.database_files import read_database
from canest.core.errors import ConfigError
from canest.decode import Decoder
from canest.decode.database import find_signal
from canest.pipeline.signal_map import resolution_of
from canest.system.shipped_files import shipped


def test_loaded_once_per_process():
    path = shipped("dbc") / "canest.dbc"
    assert read_database(path) is read_database(str(path))


def test_a_file_that_was_edited_is_read_again(tmp_path):
    path = tmp_path / "own.dbc"
    factors = []
    for factor in (1, 2, 2):
        path.write_text(f'BO_ 291 EEC1: 8 X\n SG_ EngSpeed : 0|8@1+ ({factor},0) [0|0] "rpm" X\n')
        os.utime(path, ns=(factor, factor))
        factors.append(find_signal([read_database(path)], "EEC1", "EngSpeed")[1].scale)
    assert factors == [1, 2, 2]
    assert read_database(path) is read_database(path)


def test_loading_imports_no_bus_and_leaves_cantools_whole():
    code = (
        "import sys; from canest.config.database_files import read_database; "
        "from canest.system.shipped_files import shipped; "
        "read_database(shipped('dbc') / 'canest.dbc'); assert 'can' not in sys.modules; "
        "import cantools.tester; cantools.tester.Tester; import cantools.logreader; cantools.logreader.Parser"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_mark_of_utf_8_at_the_begin_does_no_harm(tmp_path):
    path = tmp_path / "own.dbc"
    text = 'BO_ 291 EEC1: 8 X\n SG_ EngSpeed : 0|8@1+ (1,0) [0|0] "°C" X\n'
    for encoding in ("utf-8-sig", "cp1252"):
        path.write_bytes(text.encode(encoding))
        assert find_signal([read_database(path)], "EEC1", "EngSpeed")[1].unit == "°C"
    path.write_bytes(("BO_ 291 EEC1: 99999999 X\n").encode("utf-8-sig"))
    with pytest.raises(ConfigError, match="message too long"):
        read_database(path)


def test_missing_file(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere\.dbc: cannot be read.*No such file"):
        read_database(tmp_path / "nowhere.dbc")


@pytest.mark.parametrize(
    "content",
    [
        b"\x00\x01\x02\xff\xfe",
        b"hello",
        b"",
        b'BO_ 1 A: 1 X\n SG_ S : 0|64@1+ (1,0) [0|0] "" X\n',
        b'BO_ 419361001 NoExtendedFlag: 8 X\n SG_ S : 0|8@1+ (1,0) [0|0] "" X\n',
    ],
)
def test_damaged_file_is_one_line_with_its_name(tmp_path, content):
    path = tmp_path / "damaged.dbc"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        read_database(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_file_cut_in_mid_line(tmp_path):
    path = tmp_path / "cut.dbc"
    path.write_text("BO_ 2566844926 CCVS1: 8 X\n SG_ Speed : 8|16@1+ (0.0")
    with pytest.raises(ConfigError, match=r"no such signal in CCVS1.*found 'Speed'.*cut short"):
        find_signal([read_database(path)], "CCVS1", "Speed")


def test_missing_message_and_signal_name_what_is_near():
    databases = [shipped_database()]
    with pytest.raises(
        ConfigError,
        match=r"signals\.gear: no such message, found 'ETC22'.*expected a name of the DBC, perhaps ETC2",
    ):
        find_signal(databases, "ETC22", "TransCurrentGear", "signals.gear")
    with pytest.raises(ConfigError, match=r"no such signal in ETC2.*perhaps TransCurrentGear"):
        find_signal(databases, "ETC2", "TransCurentGear", "signals.gear")
    with pytest.raises(ConfigError, match="one of AGW"):
        find_signal(databases, "zzzzzzzz", "x")


def test_decoder_names_the_role_that_lacks_its_signal():
    with pytest.raises(ConfigError, match=r"signals\.vehicle_speed"):
        Decoder(wants(("vehicle_speed", "CCVS1", "Speed")), [shipped_database()])


def test_first_database_that_has_the_message_counts(tmp_path):
    path = tmp_path / "own.dbc"
    path.write_text('BO_ 291 EEC1: 8 X\n SG_ EngSpeed : 0|8@1+ (100,0) [0|0] "rpm" X\n')
    message, signal = find_signal([read_database(path), shipped_database()], "EEC1", "EngSpeed")
    assert (message.frame_id, signal.scale) == (291, 100)


def test_the_step_of_two_half_shafts_is_that_of_their_sum():
    assert resolution_of(load_config("testcar"))["torque"] == pytest.approx(0.5 * 2**0.5)
