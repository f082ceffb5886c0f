"""What no signal confirms is said, with the one that could: of the same motor first, and only if it came."""

from __future__ import annotations

from canest.doctor.config_warnings import config_warnings
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from tests.van_bus import DBC, REAR, bus, config_of, report

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
