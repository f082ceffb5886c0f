"""What no signal confirms is said, with the one that could: of the same motor first, and only if it came."""

from __future__ import annotations

from canest.doctor.config_warnings import config_warnings
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from tests.van_bus import BOTH, DBC, REAR, bus, config_of, report

TORQUE = REAR.splitlines(keepends=True)[0]


def unchecked(notes):
    return [note for note in notes if "nothing shows whether" in note]


def test_the_speed_beside_the_torque_is_proposed_before_another_motors(tmp_path):
    (note,) = unchecked(config_warnings(config_of(tmp_path, TORQUE)))
    assert note.startswith("no signals.engine_speed") and note.endswith("(MCU_R.MotR_Speed could)")


def test_no_speed_is_proposed_that_the_log_has_not(tmp_path):
    config = config_of(tmp_path, TORQUE, DBC.replace("MotR_Speed", "Wheel"))
    (note,) = unchecked(config_warnings(config))
    assert note.endswith("(MCU_F.MotF_Speed could)")
    assert unchecked(report(config, bus()).notes) == [note]
    assert unchecked(replay(FrameLog(bus()), config).summary["notes"]) == [note]
    assert not unchecked(report(config, bus(front_Nm=None)).notes)
    assert not unchecked(replay(FrameLog(bus(front_Nm=None)), config).summary["notes"])


def test_torques_at_the_wheels_need_a_speed_that_turns_with_them(tmp_path):
    (note,) = unchecked(report(config_of(tmp_path, BOTH), bus()).notes)
    assert note.startswith(
        "no signals.output_shaft_speed: nothing shows whether wheel_radius_m and the unit of"
    )
    assert note.endswith("(MCU_F.MotF_Speed could, with scale: final_drive / its ratio to the wheels)")
    shaft = "  output_shaft_speed: {message: MCU_R, signal: MotR_Speed, scale: 0.0943396}\n"
    for more in (shaft, REAR.splitlines(keepends=True)[1]):
        found = report(config_of(tmp_path, BOTH + more), bus(radius_m=0.387))
        assert not unchecked(found.notes)
        assert [hint for hint in found.hints if "agree with wheel_radius_m 0.387" in hint]


def test_the_speed_of_an_engine_with_gears_does_not_turn_with_the_wheels(tmp_path):
    dbc = DBC.replace("MotF_Speed", "EngSpeed").replace("MotR_Speed", "FanSpeed")
    assert not unchecked(config_warnings(config_of(tmp_path, BOTH, dbc)))
