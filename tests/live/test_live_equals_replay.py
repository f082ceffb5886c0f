"""Live estimates equal those of a replay of the recording, to the last bit."""

from __future__ import annotations

import numpy as np

from canest.bus.kernel_drain import Drained
from canest.core.frames import FrameBlock
from canest.pipeline.pipeline import Pipeline
from tests.live.rig import Rig, config, kenworth, rows


def test_live_estimates_equal_a_replay_of_the_daemons_recording(tmp_path, drive, monkeypatch):
    settings = config(
        tmp_path, f"service.record={tmp_path}/seen.log", f"service.log_estimates={tmp_path}/est.csv"
    )
    with Rig(monkeypatch, settings, drive[:40_000]) as rig:
        rig.run_out()
    from canest.offline.replay import replay

    replay(tmp_path / "seen.log", settings, output=tmp_path / "replayed.csv")
    live, replayed = rows(tmp_path / "est.csv"), rows(tmp_path / "replayed.csv")
    assert len(replayed) > 1500
    assert {t: live[t] for t in replayed} == replayed
    assert len(live) - len(replayed) < 100  # the ticks after the last frame
    assert rig.daemon.estimation.late_frames == 0


def test_so_it_is_with_can_fd_frames_of_which_a_recording_holds_eight_bytes(tmp_path, drive, monkeypatch):
    settings = config(
        tmp_path, f"service.record={tmp_path}/seen.log", f"service.log_estimates={tmp_path}/est.csv"
    )
    length = drive.length[:30_000].copy()
    length[:4000:7] = length[15_000:18_000] = length[-1000:] = 12
    frames = FrameBlock(drive.t_us[:30_000], drive.can_id[:30_000], length, drive.data[:30_000])
    with Rig(monkeypatch, settings, frames) as rig:
        rig.run_out()
        lost = rig.daemon.pipeline.decoder.counters.lost()
    from canest.offline.replay import replay

    result = replay(tmp_path / "seen.log", settings, output=tmp_path / "replayed.csv")
    live, replayed = rows(tmp_path / "est.csv"), rows(tmp_path / "replayed.csv")
    assert len(replayed) > 1000
    assert {t: live[t] for t in replayed} == replayed
    assert result.summary["skipped_lines"] == 0
    assert lost["frames of wrong length"] > 1000
    note_begin = f"not decoded: {lost['frames of wrong length']:,} frames of wrong length"
    assert any(note.startswith(note_begin) for note in result.warnings)


def test_live_numbers_have_the_same_bits_as_one_block(tmp_path, data, monkeypatch):
    frames = kenworth(data)
    settings = config(tmp_path, name="kenworth")
    seen = []
    with Rig(monkeypatch, settings, frames) as rig:
        log = rig.daemon.outputs.add_estimates
        rig.daemon.outputs.add_estimates = lambda estimates, now_s: (
            seen.append(estimates),
            log(estimates, now_s),
        )
        rig.run_out()
    whole = Pipeline(settings).push(frames)
    for column in ("t_us", "mass_kg", "mass_std_kg", "grade", "grade_std", "status", "gate"):
        live = np.concatenate([getattr(e, column) for e in seen])[: len(whole)]
        assert np.array_equal(
            live, getattr(whole, column), equal_nan=column not in ("t_us", "status", "gate")
        )


def test_frames_that_come_too_late_are_used_when_they_come_and_the_recording_still_replays(
    tmp_path, drive, monkeypatch
):
    settings = config(
        tmp_path, f"service.record={tmp_path}/seen.log", f"service.log_estimates={tmp_path}/est.csv"
    )
    with Rig(monkeypatch, settings, drive[:20_000]) as rig:
        drain, held = rig.script.drain, []

        def late():
            """A driver that hands every tenth batch over one drain later than it promised."""
            drained = drain()
            frames = FrameBlock.concatenate([*held, drained.frames])
            held.clear()
            if rig.daemon.schedule.ticks // 10 % 10 == 0 and len(frames):
                held.append(frames)
                frames = FrameBlock.empty()
            return Drained(frames, drained.reached_us)

        rig.script.drain = late
        rig.run_out()
        assert rig.daemon.estimation.late_frames > 100
    from canest.offline.replay import replay

    replay(tmp_path / "seen.log", settings, output=tmp_path / "replayed.csv")
    live, replayed = rows(tmp_path / "est.csv"), rows(tmp_path / "replayed.csv")
    assert len(replayed) > 800
    assert {t: live[t] for t in replayed} == replayed
