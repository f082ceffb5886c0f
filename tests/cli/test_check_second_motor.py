"""A motor whose torque no role takes makes masses too light, and is named where it drives with the other."""

from __future__ import annotations

import numpy as np
import pytest

from canest.doctor.check import Doctor
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from tests.van_bus import BOTH, DBC, REAR, T_S, TORQUE_NM, bus, config_of, report


def named(found):
    return [hint for hint in found.hints if "second motor" in hint]


@pytest.mark.parametrize("share", [0.7, -0.7], ids=["same way", "mounted the other way round"])
def test_a_second_motor_is_named(tmp_path, share):
    (hint,) = named(report(config_of(tmp_path, REAR), bus(share * TORQUE_NM)))
    assert hint.startswith("no role takes MCU_F.MotF_Torque, which goes with engine_torque")
    assert "docs/config.md" in hint


def test_small_blocks_give_the_same(tmp_path):
    config, frames = config_of(tmp_path, REAR), bus()
    doctor = Doctor(config)
    for first in range(0, len(frames), 40):
        doctor.push(frames[first : first + 40])
    assert named(doctor.report()) == named(report(config, frames)) != []


@pytest.mark.parametrize(
    ("signals", "front_Nm"),
    [
        (BOTH, 0.7 * TORQUE_NM),
        (REAR, None),
        (REAR, 0.0 * TORQUE_NM),
        (REAR, np.random.default_rng(1).normal(5.0, 3.0, len(T_S))),
    ],
    ids=["both are mapped", "another van's DBC", "it does not drive", "a pump"],
)
def test_no_motor_is_missing(tmp_path, signals, front_Nm):
    assert not named(report(config_of(tmp_path, signals), bus(front_Nm)))


def test_a_demand_is_no_motor(tmp_path):
    """Its message has no speed of a motor."""
    assert not named(report(config_of(tmp_path, REAR, DBC.replace('"rpm"', '""', 1)), bus()))


def test_a_replay_notes_it(tmp_path):
    notes = replay(FrameLog(bus()), config_of(tmp_path, REAR)).summary["notes"]
    assert [note for note in notes if "MCU_F.MotF_Torque" in note]
