"""Frames that are there, but not as the DBC declares them: another frame format, another length."""

from __future__ import annotations

import json

import pytest

from tests.van_bus import DBC as DBC_OF_VAN
from tests.van_bus import REAR, bus, config_of, report

CONFIG = """
vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 4, drag_area_m2: 0.7,
  rolling_resistance: 0.01}
dbc: [car.dbc]
signals:
  engine_torque: {message: Motor, signal: Torque}
  vehicle_speed: {message: Motor, signal: Speed}
"""
DBC = """VERSION ""
BU_: X
BO_ NUMBER Motor: 8 X
 SG_ Torque : 0|16@1- (0.1,0) [0|0] "Nm" X
 SG_ Speed : 16|16@1+ (0.01,0) [0|0] "km/h" X
"""


def reasons(canest, tmp_path, number, frame, frames=300):
    """Return what stops `check`, and why `replay` has no mass."""
    (tmp_path / "car.yaml").write_text(CONFIG)
    (tmp_path / "car.dbc").write_text(DBC.replace("NUMBER", str(number)))
    log = tmp_path / "car.log"
    log.write_text("".join(f"({n * 0.02:.6f}) can0 {frame}\n" for n in range(frames)))
    check = canest("check", "-c", tmp_path / "car.yaml", log, "--json", "-")
    replay = canest("replay", log, "-c", tmp_path / "car.yaml", "--json", "-")
    return json.loads(check.out)["stops"], json.loads(replay.out)["reason"]


@pytest.mark.parametrize(
    ("number", "frame", "came", "right"),
    [
        (257, "00000101#00010002000000FF", "29-bit frames, and the DBC declares an 11-bit one", 2**31 + 257),
        (2**31 + 257, "101#00010002000000FF", "11-bit frames, and the DBC declares a 29-bit one", 257),
    ],
)
def test_an_identifier_in_the_other_frame_format_is_named(canest, tmp_path, number, frame, came, right):
    for reason in reasons(canest, tmp_path, number, frame):
        assert f"its identifier 0x101 came in {came}" in reason and f"BO_ {right}" in reason
    for reason in reasons(canest, tmp_path, right, frame):
        assert "its identifier" not in reason


def test_frames_of_another_length_are_named(canest, tmp_path):
    check, replay = reasons(canest, tmp_path, 257, "101#00010002")
    assert "another length" in check
    assert "none of 300 frames has the length that the DBC declares, 8" in replay


def test_an_identifier_that_never_came_is_only_not_found(canest, tmp_path):
    check, replay = reasons(canest, tmp_path, 257, "102#00010002000000FF")
    assert check.endswith("was not found as Motor.Torque") and "was never seen in 300 frames" in replay


def test_a_signal_that_its_multiplexor_never_selects_is_named(canest, tmp_path, monkeypatch):
    """Its message came all the time, so "never seen" is wrong."""
    page = ' SG_ Page M : 56|8@1+ (1,0) [0|0] "" X\n SG_ Torque m3 :'
    monkeypatch.setattr(f"{__name__}.DBC", DBC.replace(" SG_ Torque :", page))
    check, replay = reasons(canest, tmp_path, 257, "101#00010002000000FF")
    assert check.endswith("their multiplexor never selects it)")
    assert replay.endswith(
        "none of 300 frames holds it: they end before it, or their multiplexor never selects it"
    )


def test_an_identifier_that_never_came_is_named_beside_those_that_no_message_has(tmp_path):
    wrong = config_of(tmp_path, REAR, DBC_OF_VAN.replace("BO_ 162", "BO_ 163").replace("BO_ 161", "BO_ 1000"))
    (hint,) = [hint for hint in report(wrong, bus()).hints if "never came" in hint]
    assert hint == (
        "0xA3 (MCU_R) never came, and the bus has 0xA2 (50/s), 0xA1 (50/s), which no message of the DBC has"
    )
    assert not [hint for hint in report(config_of(tmp_path, REAR), bus()).hints if "never came" in hint]


def test_a_bus_of_another_vehicle_gets_the_one_hint_that_all_is_missing(canest, tmp_path):
    reasons(canest, tmp_path, 257, "102#00010002000000FF")
    done = canest("check", "-c", tmp_path / "car.yaml", tmp_path / "car.log", "--json", "-")
    assert not [hint for hint in json.loads(done.out)["hints"] if "never came" in hint]
