"""A valid mass that becomes another in motion: hardly any load does that, a torque's gain may."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from canest.config import load_config
from canest.core.samples import STEP_US, Status
from canest.doctor.mass_jump import MassJump
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from canest.simulation import simulate

N = 20_000  #: ticks
TICKS = 85_000_000_000 + np.arange(N)


def found(mass_kg, *, std=0.02, status=Status.VALID, stopped=(0, 0), block=977):
    jump = MassJump()
    mass = np.broadcast_to(np.asarray(mass_kg, float), N)
    stands = np.zeros(N, bool)
    stands[slice(*stopped)] = True
    statuses = np.broadcast_to(np.asarray(status, np.uint8), N)
    for begin in range(0, N, block):
        rows = slice(begin, begin + block)
        samples = SimpleNamespace(t_us=TICKS[rows] * STEP_US, stopped=stands[rows])
        estimates = SimpleNamespace(mass_kg=mass[rows], mass_std_kg=std * mass[rows], status=statuses[rows])
        jump(samples, estimates)
    return jump.found


STEP = np.where(np.arange(N) < 12_000, 21_000.0, 10_500.0)


def test_a_mass_that_halves_in_motion_is_named():
    assert "from 21,000 to 10,500 kg within" in found(STEP)


@pytest.mark.parametrize("block", [10, 500, N])
def test_however_blocks_are_cut_it_is_the_same(block):
    assert found(STEP, block=block) == found(STEP)


def test_a_load_that_changes_in_a_stop_is_one():
    assert not found(STEP, stopped=(11_900, 12_100))


def test_a_spreader_is_one():
    assert not found(np.linspace(26_000.0, 20_400.0, N))  # 14 kg/s


def test_what_is_uncertain_or_not_valid_tells_nothing():
    assert not found(STEP, std=0.2)
    assert not found(STEP, status=np.where(np.arange(N) < 12_000, Status.CONVERGING, Status.VALID))


def test_a_torque_that_is_halved_on_the_way_is_noted_by_a_replay():
    """EEC1's torque, one byte in percent with an offset of 125: from 120 s on half of it."""
    drive = simulate("pulse-21t")
    frames = drive.frames
    eec1 = (frames.can_id & 0x00FF_FF00) == 0x00F0_0400
    late = eec1 & (frames.t_us > frames.t_us[0] + 120_000_000)
    raw = (frames.data >> np.uint64(16)) & np.uint64(0xFF)
    halved = (np.round((raw.astype(float) - 125.0) / 2.0) + 125.0).astype(np.uint64)
    data = np.where(
        late & (raw <= 250),
        (frames.data & ~np.uint64(0xFF_0000)) | (halved << np.uint64(16)),
        frames.data,
    )
    config = load_config("class8", [])
    assert not any("mass went" in note for note in replay(FrameLog(frames), config).warnings)
    found = replay(FrameLog(replace(frames, data=data)), config).warnings
    assert any("mass went from 21," in note for note in found)
