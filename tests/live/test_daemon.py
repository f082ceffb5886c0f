"""The daemon on a scripted bus: what it broadcasts and reports, and faults of bus, clock and senders."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from canest.bus.kernel_drain import Drained
from canest.core.errors import ConfigError
from canest.core.frames import EXTENDED, FrameBlock
from canest.core.samples import Status
from canest.decode import j1939
from canest.logs.format_detection import open_log
from canest.node.address_claim import CLAIM_PGN
from canest.node.estimate_frame import decode
from tests.live.rig import Rig, config, kenworth, wait_for

OWN_PGN = 0xFF5A


def estimates_sent(script):
    return [decode(p, i).estimate for _, i, p in script.sent if j1939.pgn_of(i) == OWN_PGN]


def test_the_broadcast_is_the_newest_estimate_within_the_frames_resolution(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(60)
        reported = rig.daemon.estimate(rig.now_us)
        sent = estimates_sent(rig.script)[-1]
        assert reported.status == Status.VALID
        assert abs(sent.mass_kg - reported.mass_kg) <= 1 and abs(sent.grade - reported.grade) <= 0.00005
        assert (sent.status, sent.gate) == (reported.status, reported.gate)
        assert abs(reported.mass_kg - 21_000) < 1_000


def test_when_the_bus_falls_silent_the_broadcast_is_not_available_and_comes_back(
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
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(79)
        undisturbed = rig.daemon.estimate(rig.now_us)
    assert abs(after.grade - undisturbed.grade) < 0.002
    assert after.grade_std < 2.0 * undisturbed.grade_std


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
        assert rig.daemon.estimation.failures == 0
        assert len(rig.daemon.pipeline.decoder.counters.other_senders) > 50


def test_the_real_attack_logs_are_survived_and_counted(tmp_path, data, monkeypatch):
    from canest.telemetry.snapshot import snapshot
    from canest.telemetry.status_view import rows as rows_of

    shown = {}
    for name in ("tsc1", "address_claim"):
        frames = FrameBlock.concatenate(list(open_log(data / "kenworth" / f"{name}.log.xz")))
        with Rig(monkeypatch, config(tmp_path, "broadcast.enabled=true", name="kenworth"), frames) as rig:
            rig.run_out()
            assert rig.daemon.estimation.failures == 0
            assert rig.daemon.pipeline.decoder.counters.frames > 0
            claims = [s for s in rig.script.sent if j1939.pgn_of(s[1]) == CLAIM_PGN]
            assert len(claims) < 5 * frames.t_us[-1] / 1e6
            shown[name] = snapshot(rig.daemon.view(rig.now_us))
    assert shown["tsc1"]["torque_commands"] == {"0x03": 619, "0x0B": 923}
    assert shown["address_claim"]["claims"] == {"0x00": 1}
    assert shown["address_claim"]["broadcast"]["cannot_claim_received"] == 1
    assert shown["address_claim"]["broadcast"]["cannot_claim_heard"] == 1  # deprecated
    assert ("addresses lost", "1 times an ECU had to give its own up; claims: 0x00 1") in rows_of(
        shown["address_claim"]
    )
    no_claims = shown["address_claim"] | {"claims": {}}
    lost = next(text for name, text in rows_of(no_claims) if name == "addresses lost")
    assert lost == "1 times an ECU had to give its own up; no claim of an address was received"
    assert "addresses-lost-by-others now=1" in rig.log.getvalue()


def test_a_bus_that_cannot_be_opened_logs_its_reason_once(tmp_path, monkeypatch):
    from canest.telemetry.snapshot import snapshot
    from canest.telemetry.status_view import rows as rows_of

    with Rig(monkeypatch, config(tmp_path)) as rig:
        rig.script.state, rig.script.reason = "absent", "No such device"
        rig.run(10)
        shown = snapshot(rig.daemon.view(rig.now_us))
        assert shown["bus"]["reason"] == "No such device"
        assert ("why not valid", "the bus vcan0 is absent: No such device") in rows_of(shown)
        rig.script.state, rig.script.reason = "up", ""
        rig.run(2)
    shown = [line for line in rig.log.getvalue().splitlines() if line[3:].startswith("bus ")]
    assert shown == ['<4>bus now="absent: No such device"', "<5>bus now=up"]


def test_a_mass_that_is_not_valid_yet_says_how_uncertain_it_is(tmp_path, monkeypatch, data):
    from canest.telemetry.status_text import why_not_valid

    changes = ("estimator.valid_std_pct=0.1",)  # never met by a torque known to 5 %
    with Rig(monkeypatch, config(tmp_path, *changes, name="kenworth"), kenworth(data, 90)) as rig:
        rig.run_out()
        text = why_not_valid(rig.daemon.view(rig.now_us))
    assert re.match(r"\+- \d+\.\d %, where 0\.1 % is valid; learned from \d+\.\d s of driving", text)


def test_the_last_state_of_a_bus_that_comes_and_goes_is_logged(tmp_path, monkeypatch):
    """An adapter with a bad plug: five lines at once are enough, but the last one has to be there."""
    with Rig(monkeypatch, config(tmp_path)) as rig:
        for state, reason in [("up", ""), ("absent", "No such device")] * 4:
            rig.script.state, rig.script.reason = state, reason
            rig.run(2)
        rig.run(40)
    shown = [line for line in rig.log.getvalue().splitlines() if line[3:].startswith("bus ")]
    assert len(shown) == 6
    assert shown[-1] == '<4>bus now="absent: No such device" held_back=2'


def test_a_quiet_bus_is_progress_for_the_watchdog(tmp_path, monkeypatch):
    class Supervisor:
        watchdog_s, pings, reported = 10.0, 0, []

        def ping_watchdog(self, now_s):
            self.pings += 1

        def status(self, text):
            self.reported.append(text)

        def stopping(self): ...
        def close(self): ...

    with Rig(monkeypatch, config(tmp_path), notifier=Supervisor()) as rig:
        rig.run(30)
        assert 30 * 4 < rig.daemon.notifier.pings < 30 * 6
        assert "no frame has been received on vcan0" in rig.daemon.notifier.reported[-1]


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


def test_metrics_and_snapshot_agree_and_are_well_formed(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path, f"service.metrics_file={tmp_path}/m.prom"), drive) as rig:
        rig.run(42)
        rig.daemon.request_counters()
        rig.run(2)
        assert "counters" in rig.log.getvalue() and "estimate.mass_kg=" in rig.log.getvalue()
        assert wait_for((tmp_path / "m.prom").exists)
    parser = pytest.importorskip("prometheus_client.parser")
    families = {f.name: f for f in parser.text_string_to_metric_families((tmp_path / "m.prom").read_text())}
    assert families["canest_mass_kilograms"].samples[0].value == pytest.approx(21_000, rel=0.1)
    gates = {s.labels["gate"]: s.value for s in families["canest_samples"].samples}
    assert gates["open"] > 100
    assert sum(s.value for s in families["canest_status"].samples) == 1


def test_the_snapshot_is_whole_while_the_disk_recovers(tmp_path, monkeypatch):
    from canest.telemetry.snapshot import snapshot

    class Failures(dict):
        def items(self):
            for kind, error in super().items():
                yield kind, error
                self.pop(kind, None)  # as the thread does that has just written

    with Rig(monkeypatch, config(tmp_path)) as rig:
        rig.daemon.background.failures = Failures(state="No space left", ring="No space left")
        files = snapshot(rig.daemon.view(rig.now_us))["files"]
        assert files["state_error"] == files["ring_error"] == "No space left"


def test_the_snapshot_is_json_and_stays_small_under_noise(tmp_path, drive, monkeypatch):
    from canest.telemetry.snapshot import snapshot

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
        text = json.dumps(snapshot(rig.daemon.view(rig.now_us)), allow_nan=False)
        assert len(text) < 60_000
        assert json.loads(text)["other_senders_count"] > 1000


def test_masses_of_other_ecus_stand_beside_ours(tmp_path, drive, monkeypatch):
    from canest.telemetry.snapshot import snapshot
    from canest.telemetry.status_view import rows

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
        shown = snapshot(rig.daemon.view(rig.now_us))
        assert shown["masses_of_others_kg"] == {"0x0B": 21_300.0, "0x27": 22_600.0}
        assert shown["estimate"]["mass_kg"] == pytest.approx(21_000, rel=0.05)
        ours = shown["estimate"]["mass_kg"]
        apart = {a: kg / ours * 100 - 100 for a, kg in shown["masses_of_others_kg"].items()}
        assert shown["masses_of_others_pct"] == pytest.approx(apart, abs=0.02)
        assert "% of ours" in dict(rows(shown))["mass by others"]


def test_an_impossible_bus_is_one_plain_error(tmp_path):
    from canest.live.daemon import Daemon

    with pytest.raises(ConfigError, match="unknown interface"):
        Daemon(config(tmp_path, "bus.interface=no_such_thing"))
