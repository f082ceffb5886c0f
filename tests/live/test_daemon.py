"""The daemon on a scripted bus: live equals replay, and what happens when the world misbehaves."""

from __future__ import annotations

import csv
import json
import math
import time
from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config
from canest.decode import j1939
from canest.errors import ConfigError
from canest.frames import EXTENDED, FrameBlock
from canest.live.address_claim import CLAIM_PGN
from canest.live.daemon import MOST_FAILURES_IN_A_ROW
from canest.live.estimate_frame import decode
from canest.live.kernel_drain import Drained
from canest.logs.reader import open_log
from canest.pipeline import Pipeline
from canest.vehicle.samples import Status
from tests.live.rig import Rig, descriptors, kenworth, wait_for

OWN_PGN = 0xFF5A


def config(tmp_path, *changes, name="vcan"):
    base = [f"service.state_dir={tmp_path}", "service.learn='off'", "estimator.name=canest"]
    return load_config(name, [*base, *changes])


def estimates_sent(script):
    return [decode(p, i).estimate for _, i, p in script.sent if j1939.pgn_of(i) == OWN_PGN]


def rows(path):
    with path.open() as file:
        return {r["t_s"]: tuple(r.values()) for r in csv.DictReader(file)}


def test_what_the_daemon_said_live_is_what_replay_says_of_its_recording(tmp_path, drive, monkeypatch):
    settings = config(
        tmp_path, f"service.record={tmp_path}/seen.log", f"service.log_estimates={tmp_path}/est.csv"
    )
    with Rig(monkeypatch, settings, drive[:40_000]) as rig:
        rig.run_out()
    from canest.replay import replay

    replay(tmp_path / "seen.log", settings, output=tmp_path / "replayed.csv")
    live, replayed = rows(tmp_path / "est.csv"), rows(tmp_path / "replayed.csv")
    assert len(replayed) > 1500
    assert {t: live[t] for t in replayed} == replayed
    assert len(live) - len(replayed) < 100  # the ticks after the last frame
    assert rig.daemon.late_frames == 0


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
    from canest.replay import replay

    result = replay(tmp_path / "seen.log", settings, output=tmp_path / "replayed.csv")
    live, replayed = rows(tmp_path / "est.csv"), rows(tmp_path / "replayed.csv")
    assert len(replayed) > 1000
    assert {t: live[t] for t in replayed} == replayed
    assert result.summary["skipped_lines"] == 0
    assert lost["frames of wrong length"] > 1000
    told = f"not decoded: {lost['frames of wrong length']:,} frames of wrong length"
    assert any(note.startswith(told) for note in result.notes)


def test_live_numbers_have_the_same_bits_as_one_block(tmp_path, data, monkeypatch):
    frames = kenworth(data)
    settings = config(tmp_path, name="kenworth")
    seen = []
    with Rig(monkeypatch, settings, frames) as rig:
        keep = rig.daemon._note
        rig.daemon._note = lambda estimates, *rest: (seen.append(estimates), keep(estimates, *rest))
        rig.run_out()
    whole = Pipeline(settings).push(frames)
    for column in ("t_us", "mass_kg", "mass_std_kg", "grade", "grade_std", "status", "gate"):
        live = np.concatenate([getattr(e, column) for e in seen])[: len(whole)]
        assert np.array_equal(
            live, getattr(whole, column), equal_nan=column not in ("t_us", "status", "gate")
        )


def test_the_broadcast_is_the_newest_estimate_within_the_frames_resolution(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(60)
        said = rig.daemon.estimate(rig.now_us)
        sent = estimates_sent(rig.script)[-1]
        assert said.status == Status.VALID
        assert abs(sent.mass_kg - said.mass_kg) <= 1 and abs(sent.grade - said.grade) <= 0.00005
        assert (sent.status, sent.gate) == (said.status, said.gate)
        assert abs(said.mass_kg - 21_000) < 1_000


def test_when_the_bus_falls_silent_the_broadcast_says_not_available_and_comes_back(
    tmp_path, drive, monkeypatch
):
    gap_us = 30_000_000
    late = drive.t_us >= drive.t_us[0] + 50_000_000
    frames = FrameBlock(drive.t_us + np.where(late, gap_us, 0), drive.can_id, drive.length, drive.data)
    with Rig(monkeypatch, config(tmp_path), frames) as rig:
        rig.run(50)
        assert estimates_sent(rig.script)[-1].status == Status.VALID
        mass_kg = estimates_sent(rig.script)[-1].mass_kg
        rig.run(10)
        assert math.isnan(estimates_sent(rig.script)[-1].mass_kg)
        rig.run(22)
        back = estimates_sent(rig.script)[-1]
        assert abs(back.mass_kg - mass_kg) < 0.02 * mass_kg


def test_a_clock_set_back_and_forward_leaves_a_valid_mass_valid(tmp_path, drive, monkeypatch):
    frames = [drive]
    begin = drive.t_us[0]
    shift = np.zeros(len(drive), np.int64)
    shift[drive.t_us >= begin + 50_000_000] = -3_600_000_000
    shift[drive.t_us >= begin + 60_000_000] = 7_200_000_000
    frames = FrameBlock(drive.t_us + shift, drive.can_id, drive.length, drive.data)
    with Rig(monkeypatch, config(tmp_path), frames) as rig:
        # the script looks stamps up by search: hand the parts out in their own order
        rig.script.drain = in_order(rig, frames, shift)
        rig.run(49)
        before = rig.daemon.estimate(rig.now_us)
        assert before.status == Status.VALID
        rig.run(30)
        after = rig.daemon.estimate(rig.now_us)
        assert after.status == Status.VALID
        assert abs(after.mass_kg - before.mass_kg) < 0.03 * before.mass_kg
        clock = rig.daemon.pipeline.clock.counters
        assert clock["clock_set_back"] == 1 and clock["gaps"] >= 1


def in_order(rig, frames, shift):
    true_us, state, begin_us = frames.t_us - shift, {"at": 0}, rig.now_us

    def drain():
        now_us = int(true_us[0]) + rig.now_us - begin_us
        end = int(np.searchsorted(true_us, now_us, side="right"))
        part, state["at"] = frames[state["at"] : end], end
        offset = int(shift[min(end, len(shift)) - 1])
        return Drained(part, now_us + offset - 2_000)

    return drain


def test_full_load_noise_and_wrong_senders_do_not_move_a_valid_estimate(tmp_path, drive, monkeypatch):
    rng = np.random.default_rng(3)
    begin, n = int(drive.t_us[0]) + 45_000_000, 25_000
    t_us = np.sort(rng.integers(begin, begin + 10_000_000, n))
    random_ids = (rng.integers(0, 2**29, n) | EXTENDED).astype(np.uint32)
    wanted = np.unique(drive.can_id)
    wrong_sender = (wanted[rng.integers(0, len(wanted), n)] & np.uint32(0xFFFFFF00)) | rng.integers(
        0x40, 0xF0, n
    ).astype(np.uint32)
    ids = np.where(rng.random(n) < 0.5, random_ids, wrong_sender)
    ids[::50] |= np.uint32(0x2000_0000)
    noise = FrameBlock(
        t_us, ids, rng.integers(0, 9, n).astype(np.uint8), rng.integers(0, 2**63, n, dtype=np.uint64)
    )
    both = FrameBlock.concatenate([drive, noise])
    both = both[np.argsort(both.t_us, kind="stable")]
    with Rig(monkeypatch, config(tmp_path), both) as rig:
        rig.run(45)
        before = rig.daemon.estimate(rig.now_us)
        assert before.status == Status.VALID
        worst = 0.0
        for _ in range(12):
            rig.run(1)
            now = rig.daemon.estimate(rig.now_us)
            assert now.status == Status.VALID
            worst = max(worst, abs(now.mass_kg / before.mass_kg - 1))
        assert worst < 0.02
        assert rig.daemon.failures == 0
        assert len(rig.daemon.pipeline.decoder.counters.other_senders) > 50


def test_the_real_attack_logs_are_survived_and_counted(tmp_path, data, monkeypatch):
    from canest.live.snapshot import snapshot
    from canest.live.status_view import rows as rows_of

    told = {}
    for name in ("tsc1", "address_claim"):
        frames = FrameBlock.concatenate(list(open_log(data / "kenworth" / f"{name}.log.xz")))
        with Rig(monkeypatch, config(tmp_path, "broadcast.enabled=true", name="kenworth"), frames) as rig:
            rig.run_out()
            assert rig.daemon.failures == 0
            assert rig.daemon.pipeline.decoder.counters.frames > 0
            claims = [s for s in rig.script.sent if j1939.pgn_of(s[1]) == CLAIM_PGN]
            assert len(claims) < 5 * frames.t_us[-1] / 1e6
            told[name] = snapshot(rig.daemon, rig.now_us)
    assert told["tsc1"]["torque_commands"] == {"0x03": 619, "0x0B": 923}
    assert told["address_claim"]["claims"] == {"0x00": 1}
    assert told["address_claim"]["broadcast"]["cannot_claim_heard"] == 1
    assert ("addresses lost", "1 times an ECU had to give its own up; claims: 0x00 1") in rows_of(
        told["address_claim"]
    )
    unheard = told["address_claim"] | {"claims": {}}
    lost = next(text for name, text in rows_of(unheard) if name == "addresses lost")
    assert lost == "1 times an ECU had to give its own up; no claim of an address was heard"
    assert "addresses-lost-by-others now=1" in rig.log.getvalue()


def test_a_bus_that_cannot_be_opened_says_why_once(tmp_path, monkeypatch):
    from canest.live.snapshot import snapshot
    from canest.live.status_view import rows as rows_of

    with Rig(monkeypatch, config(tmp_path)) as rig:
        rig.script.state, rig.script.reason = "absent", "No such device"
        rig.run(10)
        told = snapshot(rig.daemon, rig.now_us)
        assert told["bus"]["reason"] == "No such device"
        assert ("why not valid", "the bus vcan0 is absent: No such device") in rows_of(told)
        rig.script.state, rig.script.reason = "up", ""
        rig.run(2)
    told = [line for line in rig.log.getvalue().splitlines() if line[3:].startswith("bus ")]
    assert told == ['<4>bus now="absent: No such device"', "<5>bus now=up"]


def test_a_quiet_bus_is_progress_for_the_watchdog(tmp_path, monkeypatch):
    class Supervisor:
        watchdog_s, pings, said = 10.0, 0, []

        def alive(self, now_s):
            self.pings += 1

        def status(self, text):
            self.said.append(text)

        def stopping(self): ...
        def close(self): ...

    with Rig(monkeypatch, config(tmp_path), notifier=Supervisor()) as rig:
        rig.run(30)
        assert 30 * 4 < rig.daemon.notifier.pings < 30 * 6
        assert "nothing has been heard on vcan0" in rig.daemon.notifier.said[-1]


def test_a_defect_in_the_estimation_is_survived_with_the_learned_mass(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path, "service.learn='on'"), drive) as rig:
        rig.run(60)
        before = rig.daemon.estimate(rig.now_us)

        def broken(frames):
            raise ZeroDivisionError("surprise")

        rig.daemon.pipeline.push = broken
        rig.run(5)
        assert rig.daemon.failures == 1
        assert "ZeroDivisionError" in rig.log.getvalue()
        after = rig.daemon.estimate(rig.now_us)
        assert abs(after.mass_kg - before.mass_kg) < 0.02 * before.mass_kg


def test_a_defect_that_stays_ends_the_daemon_for_systemd_to_restart_it(tmp_path, drive, monkeypatch):
    def broken(self, frames):
        raise ZeroDivisionError("surprise")

    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        monkeypatch.setattr(Pipeline, "push", broken)
        with pytest.raises(ZeroDivisionError):
            rig.run(5)
        assert rig.daemon.failures == MOST_FAILURES_IN_A_ROW


def test_a_mass_learned_survives_a_restart_with_more_doubt(tmp_path, drive, monkeypatch):
    settings = config(tmp_path, "service.learn='on+save'")
    with Rig(monkeypatch, settings, drive) as rig:
        rig.run(80)
        learned = rig.daemon.estimate(rig.now_us)
    saved = json.loads((tmp_path / "learned-vcan0.json").read_text())
    assert abs(saved["mass_kg"] - learned.mass_kg) < 100 and saved["valid"] is True
    assert saved["distance_km"] == rig.daemon.node.watch.distance_km is not None
    with Rig(monkeypatch, settings, drive) as rig:
        assert "mass-restored" in rig.log.getvalue()
        rig.run(3)
        restored = rig.daemon.estimate(rig.now_us)
        assert abs(restored.mass_kg - learned.mass_kg) < 0.02 * learned.mass_kg
        assert restored.mass_std_kg > learned.mass_std_kg


@pytest.mark.parametrize("learn", ["'off'", "'on'"])
def test_learning_switched_off_writes_nothing(tmp_path, drive, monkeypatch, learn):
    with Rig(monkeypatch, config(tmp_path, f"service.learn={learn}"), drive) as rig:
        rig.run(60)
    assert not (tmp_path / "learned-vcan0.json").exists()


def test_an_unusable_state_file_is_told_and_set_aside(tmp_path, monkeypatch):
    (tmp_path / "learned-vcan0.json").write_text("half a fi")
    with Rig(monkeypatch, config(tmp_path, "service.learn='on+save'")) as rig:
        assert "state-not-used" in rig.log.getvalue()
    assert (tmp_path / "learned-vcan0.json.bad-corrupt").exists()


def test_a_state_directory_that_cannot_be_written_is_told_once_and_counted(tmp_path, drive, monkeypatch):
    (tmp_path / "occupied").write_text("")
    settings = config(tmp_path, "service.learn='on+save'", f"service.state_dir={tmp_path}/occupied/x",
                      "service.save_every_s=2")  # fmt: skip
    with Rig(monkeypatch, settings, drive) as rig:
        rig.run(60)
        rig.daemon.background.flush(5)
        rig.run(5)
        assert rig.daemon.background.counters["state_failed"] > 3
        assert rig.log.getvalue().count("writing-state") == 1
        assert rig.daemon.estimate(rig.now_us).status == Status.VALID


def test_reload_takes_a_changed_config_over_and_keeps_the_learned_mass(tmp_path, drive, monkeypatch):
    settings = config(tmp_path, "service.learn='on+save'")
    changed = config(tmp_path, "service.learn='on+save'", "vehicle.rolling_resistance=0.0061")
    with Rig(monkeypatch, settings, drive, reload=lambda: changed) as rig:
        rig.run(60)
        before = rig.daemon.estimate(rig.now_us)
        rig.daemon._wants_reload = True
        rig.run(5)
        assert rig.daemon.config is changed and rig.daemon.reloads == 1
        assert len(rig.opened) == 1  # same bus: not closed, not deaf for a moment
        assert abs(rig.daemon.estimate(rig.now_us).mass_kg - before.mass_kg) < 0.03 * before.mass_kg


def test_reload_of_what_the_estimate_does_not_depend_on_leaves_it_alone(tmp_path, drive, monkeypatch):
    settings = config(tmp_path, "service.learn='on+save'")
    changed = config(tmp_path, "service.learn='on+save'", "service.save_every_s=77")
    with Rig(monkeypatch, settings, drive, reload=lambda: changed) as rig:
        rig.run(60)
        pipeline, before = rig.daemon.pipeline, rig.daemon.estimate(rig.now_us)
        assert before.status == Status.VALID
        rig.daemon._wants_reload = True
        rig.run(2)
        assert rig.daemon.config is changed and rig.daemon.reloads == 1
        assert rig.daemon.pipeline is pipeline
        assert rig.daemon.estimate(rig.now_us).status == Status.VALID
        assert "mass-restored" not in rig.log.getvalue()
        assert rig.daemon.memory.learned is not None


@pytest.mark.parametrize(
    "error", [ConfigError("unknown key", where="truck.yaml:3"), RecursionError("truck.yaml:3 too deep")]
)
def test_reload_refuses_a_broken_config_and_goes_on(tmp_path, drive, monkeypatch, error):
    def broken():
        raise error

    with Rig(monkeypatch, config(tmp_path), drive, reload=broken) as rig:
        rig.run(40)
        pipeline = rig.daemon.pipeline
        rig.daemon._wants_reload = True
        rig.run(2)
        assert rig.daemon.pipeline is pipeline
        assert "reload-refused" in rig.log.getvalue() and "truck.yaml:3" in rig.log.getvalue()


def test_reload_onto_another_bus_joins_it(tmp_path, drive, monkeypatch):
    other = config(tmp_path, "bus.channel=vcan7")
    with Rig(monkeypatch, config(tmp_path), drive, reload=lambda: other) as rig:
        rig.run(1)
        rig.daemon._wants_reload = True
        rig.run(2)
        assert [bus.channel for bus, _ in rig.opened] == ["vcan0", "vcan7"]


def test_an_interface_opened_anew_means_claiming_anew(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(5)
        rig.script.opened += 1
        rig.script.sent.clear()
        rig.run(0.2)
        assert {j1939.pgn_of(i) for _, i, _ in rig.script.sent} == {CLAIM_PGN}
        rig.run(3)
        assert estimates_sent(rig.script)


def test_listen_only_sends_nothing_whatever_is_asked(tmp_path, data, monkeypatch):
    frames = FrameBlock.concatenate(list(open_log(data / "kenworth" / "address_claim.log.xz")))
    with Rig(monkeypatch, config(tmp_path, "broadcast.listen_only=true"), frames) as rig:
        rig.run_out()
        assert rig.script.sent == [] and rig.opened[0][1] is False


def test_metrics_and_snapshot_tell_the_same_and_are_well_formed(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path, f"service.metrics_file={tmp_path}/m.prom"), drive) as rig:
        rig.run(42)
        rig.daemon._wants_snapshot = True
        rig.run(2)
        assert "counters" in rig.log.getvalue() and "estimate.mass_kg=" in rig.log.getvalue()
        assert wait_for((tmp_path / "m.prom").exists)
    parser = pytest.importorskip("prometheus_client.parser")
    families = {f.name: f for f in parser.text_string_to_metric_families((tmp_path / "m.prom").read_text())}
    assert families["canest_mass_kilograms"].samples[0].value == pytest.approx(21_000, rel=0.1)
    gates = {s.labels["gate"]: s.value for s in families["canest_samples"].samples}
    assert gates["open"] > 100
    assert sum(s.value for s in families["canest_status"].samples) == 1


def test_the_snapshot_is_json_and_stays_small_under_noise(tmp_path, drive, monkeypatch):
    from canest.live.snapshot import snapshot

    rng = np.random.default_rng(1)
    n = 20_000
    wanted = np.unique(drive.can_id)
    ids = (wanted[rng.integers(0, len(wanted), n)] & np.uint32(0xFFFFFF00)) | rng.integers(0, 255, n).astype(
        np.uint32
    )
    noise = FrameBlock(
        drive.t_us[0] + np.arange(n) * 100, ids, np.full(n, 8, np.uint8), np.zeros(n, np.uint64)
    )
    with Rig(monkeypatch, config(tmp_path), noise) as rig:
        rig.run(3)
        text = json.dumps(snapshot(rig.daemon, rig.now_us), allow_nan=False)
        assert len(text) < 60_000
        assert json.loads(text)["other_senders_count"] > 1000


def test_masses_of_other_ecus_stand_beside_ours(tmp_path, drive, monkeypatch):
    from canest.live.snapshot import snapshot

    cvw = [
        (
            int(drive.t_us[0]) + k * 500_000,
            j1939.pack(65136, source),
            b"\xff\xff" + (raw).to_bytes(2, "little") + b"\xff" * 4,
        )
        for k in range(100)
        for source, raw in ((0x0B, 2130), (0x27, 2260))
    ]
    both = FrameBlock.concatenate([drive, FrameBlock.from_frames(cvw)])
    both = both[np.argsort(both.t_us, kind="stable")]
    with Rig(monkeypatch, config(tmp_path), both) as rig:
        rig.run(45)
        told = snapshot(rig.daemon, rig.now_us)
        assert told["masses_of_others_kg"] == {"0x0B": 21_300.0, "0x27": 22_600.0}
        assert told["estimate"]["mass_kg"] == pytest.approx(21_000, rel=0.05)


def test_stopping_takes_no_longer_than_a_second_even_with_a_disk_that_hangs(tmp_path, drive, monkeypatch):
    import threading

    release = threading.Event()
    rig = Rig(monkeypatch, config(tmp_path, "service.learn='on+save'"), drive)
    rig.run(40)
    rig.daemon.background.submit("hang", release.wait)
    begin = time.perf_counter()
    rig.daemon._end()
    assert time.perf_counter() - begin < 1.0
    assert "disk-hangs" in rig.log.getvalue()
    release.set()


def test_an_impossible_bus_is_one_plain_error(tmp_path):
    from canest.live.daemon import Daemon

    with pytest.raises(ConfigError, match="unknown interface"):
        Daemon(config(tmp_path, "bus.interface=no_such_thing"))


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
        assert rig.daemon.late_frames > 100
    from canest.replay import replay

    replay(tmp_path / "seen.log", settings, output=tmp_path / "replayed.csv")
    live, replayed = rows(tmp_path / "est.csv"), rows(tmp_path / "replayed.csv")
    assert len(replayed) > 800
    assert {t: live[t] for t in replayed} == replayed


@pytest.mark.slow
def test_a_quarter_of_an_hour_of_driving_leaves_nothing_behind(tmp_path, drive, monkeypatch):
    import gc
    import os

    def resident_kb():
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024

    ring = tmp_path / "ring"
    settings = config(tmp_path, "service.learn='on+save'", f"service.residual_dir={ring}",
                      f"service.metrics_file={tmp_path}/m.prom", "service.residual_max_mb=2")  # fmt: skip
    with Rig(monkeypatch, settings, drive) as rig:
        before = None
        for minute in range(0, 16, 2):
            rig.script.repeat(rig.now_us)
            rig.run(120)
            rig.daemon.background.flush(10)
            if minute == 6:
                before = resident_kb(), descriptors(ring)
        assert descriptors(ring) <= before[1]
        assert resident_kb() - before[0] < 2048
        assert rig.daemon.failures == 0
