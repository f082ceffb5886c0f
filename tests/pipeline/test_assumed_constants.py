"""Constants of the engine that are sent late, taken back, or wrong at first."""

from __future__ import annotations

import lzma
from functools import cache

import numpy as np
import pytest
from pipeline_helpers import bundled, differences, run

from canest.config import load_config
from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.core.samples import Status
from canest.decode import j1939
from canest.demo import DRIVE
from canest.logs import open_log
from canest.offline.compare import compare
from canest.pipeline.pipeline import Pipeline

TRUE_KG = 21_000.0  # of the demo's drive
LATE_S = 90
EEC3 = 0xFEDF
TRANSPORT = (j1939.TP_CM_PGN, j1939.TP_DT_PGN)
WRONG = "vehicle.reference_torque_Nm=1700"  # it is 2100, and the engine says so


@cache
def drive() -> FrameBlock:
    return FrameBlock.concatenate(list(open_log(DRIVE)))


def seconds(frames: FrameBlock) -> np.ndarray:
    return (frames.t_us - frames.t_us[0]) * 1e-6


def of(frames: FrameBlock, *groups: int) -> np.ndarray:
    return np.array([j1939.pgn_of(i) in groups for i in frames.can_id.tolist()])


def changed(frames: FrameBlock, which: np.ndarray, data: int) -> FrameBlock:
    return FrameBlock(
        frames.t_us, frames.can_id, frames.length, np.where(which, np.uint64(data), frames.data)
    )


def estimated(frames: FrameBlock, *overrides: str, config: str = "class8") -> Estimates:
    pipeline = Pipeline(load_config(config, list(overrides)))
    return Estimates.concatenate([pipeline.push(frames), pipeline.finish()])


def off_pct(estimates: Estimates) -> float:
    return abs(float(estimates.mass_kg[-1]) / TRUE_KG - 1) * 100


@pytest.mark.parametrize("estimator", ["canest", "rlsmf", "ekf"])
def test_a_reference_torque_that_comes_late_begins_the_mass_anew(estimator):
    frames = drive()
    late = frames[~(of(frames, *TRANSPORT) & (seconds(frames) < LATE_S))]
    whole = estimated(frames, f"estimator.name={estimator}")
    e = estimated(late, WRONG, f"estimator.name={estimator}")
    received = int(np.searchsorted(e.t_us, frames.t_us[0] + (LATE_S + 6) * 1_000_000))
    before, after = e.status[: LATE_S * 50], e.status[received - 400 : received + 1]
    assert (before == Status.VALID).any()
    assert (after != Status.VALID).any()
    assert np.isfinite(e.mass_kg[LATE_S * 50 :]).all()
    assert off_pct(e) < off_pct(whole) + 3.0


def test_a_restored_mass_is_what_it_begins_with():
    frames = drive()
    late = frames[~(of(frames, *TRANSPORT) & (seconds(frames) < LATE_S))]
    pipeline = Pipeline(load_config("class8", [WRONG]))
    pipeline.restore(TRUE_KG, 300.0)
    e = Estimates.concatenate([pipeline.push(late), pipeline.finish()])
    off = np.abs(e.mass_kg / TRUE_KG - 1)
    assert off[LATE_S * 50 - 1] > 0.08  # led astray by the wrong torque
    assert off[(LATE_S + 6) * 50 :].max() < 0.04


@pytest.mark.parametrize("group", [EEC3, j1939.TP_DT_PGN])
def test_not_available_does_not_take_back_a_constant(group):
    frames = drive()
    away = of(frames, group) & (seconds(frames) > 60) & (seconds(frames) < 120)
    if group == EEC3:
        gone = changed(frames, away, (1 << 64) - 1)
    else:  # its packets, each with its number
        numbers = frames.data & np.uint64(0xFF)
        gone = FrameBlock(
            frames.t_us,
            frames.can_id,
            frames.length,
            np.where(away, numbers | np.uint64(((1 << 64) - 1) ^ 0xFF), frames.data),
        )
    lost = frames[~away]
    for column in ("mass_kg", "grade"):
        ended, silent = (getattr(estimated(f, WRONG), column) for f in (gone, lost))
        assert ended.tobytes() == silent.tobytes()


def test_a_controller_that_wakes_with_nothing_is_not_used():
    frames = drive()
    third = of(frames, j1939.TP_DT_PGN) & (frames.data & np.uint64(0xFF) == 3) & (seconds(frames) < 30)
    zero = np.uint64(0x0000_FFFF_FFFF_FFFF)  # of the torque's two bytes
    frames = FrameBlock(
        frames.t_us, frames.can_id, frames.length, np.where(third, frames.data & zero, frames.data)
    )
    e = estimated(frames)
    assert e.status[-1] == Status.VALID
    assert off_pct(e) < 3.0


def test_a_clock_set_back_takes_no_constant_back():
    frames = drive()
    back = (seconds(frames) > 90) * 3_600_000_000
    e = estimated(FrameBlock(frames.t_us - back, frames.can_id, frames.length, frames.data), WRONG)
    right = estimated(FrameBlock(frames.t_us - back, frames.can_id, frames.length, frames.data))
    assert np.abs(e.mass_kg[-1000:] / right.mass_kg[-1000:] - 1).max() < 0.01


def test_any_cut_begins_anew_at_the_same_sample():
    log = bundled("vcan/cycle.log.xz")
    late = log[~(of(log, *TRANSPORT, EEC3) & (seconds(log) < 8))]
    config = load_config("class8", [WRONG])
    whole = run(config, late)
    for cuts in (range(1, len(late), 7), range(3, len(late), 333), [len(late) // 2]):
        assert not differences(whole, run(config, late, cuts))


def test_a_comparison_begins_anew_as_a_replay_does(tmp_path):
    with lzma.open(DRIVE, "rt") as file:
        lines = file.readlines()[:30_000]
    half = len(lines) // 2
    late = [line for i, line in enumerate(lines) if i > half or not line.split()[2].startswith("18E")]
    log = tmp_path / "late.log"
    log.write_text("".join(late))
    config = load_config("class8", [WRONG])
    compared = compare(config, log, names=("canest", "rlsmf")).estimates
    for name, estimates in compared.items():
        frames = FrameBlock.concatenate(list(open_log(log)))
        replayed = estimated(frames, WRONG, f"estimator.name={name}")
        assert estimates.mass_kg.tobytes() == replayed.mass_kg.tobytes()
