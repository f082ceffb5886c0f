"""Senders under another ECU's address: two addresses for one signal, or one that sends twice as much."""

from __future__ import annotations

import json

import numpy as np
import pytest

from canest.config import load_config
from canest.core.frames import FrameBlock
from canest.core.samples import Status
from canest.decode.counters import Counters, SenderCounters
from canest.telemetry import metrics
from canest.telemetry.sender_rates import WINDOW_S, SenderRateMonitor
from canest.telemetry.snapshot import snapshot
from canest.telemetry.status_view import rows
from tests.live.rig import Rig

EEC1 = 0x8CF00400
SENDER = 61444, 0x00


class Bus:
    """One sender, counted once a second."""

    def __init__(self):
        self.sender_rates, self.counters, self.now_s = SenderRateMonitor(), Counters(), 1000.0
        self.sender = self.counters.senders[SENDER] = SenderCounters(used=True)

    def send(self, hz, seconds):
        for _ in range(round(seconds)):
            self.now_s += 1.0
            self.sender.frames += round(hz)
            self.sender_rates.update(self.counters, self.now_s)
        return self.sender_rates.faster


def test_an_address_that_sends_twice_as_much_is_reported_while_it_does():
    bus = Bus()
    assert not bus.send(50, 60)
    faster = bus.send(100, 2 * WINDOW_S)
    assert faster[SENDER] == pytest.approx((50, 100), rel=0.05)
    assert not bus.send(50, 2 * WINDOW_S)
    assert bus.sender_rates.faster_s[SENDER] == pytest.approx(2 * WINDOW_S)


@pytest.mark.parametrize(
    "life",
    [
        [(50, 60), (0, 600), (50, 60)],  # ignition off
        [(50, 60), (70, 60), (45, 60)],  # a period that depends on the load
        [(0.2, 300), (3, 30)],  # too slow for a rate
        [(50, 10), (100, 60)],  # not yet known
    ],
)
def test_a_sender_at_its_own_rate_is_not_reported(life):
    bus = Bus()
    for hz, seconds in life:
        assert not bus.send(hz, seconds)


def test_counting_anew_after_a_reload_is_not_reported():
    bus = Bus()
    bus.send(50, 60)
    bus.sender.frames = 0
    assert not bus.send(50, 60)


def test_a_rate_that_has_changed_for_good_is_the_usual_one_after_a_while():
    bus = Bus()
    bus.send(50, 60)
    assert bus.send(100, 60)
    assert not bus.send(100, 3600)


def test_a_group_that_the_config_does_not_use_is_not_watched():
    bus = Bus()
    bus.sender.used = False
    bus.send(50, 60)
    assert not bus.send(500, 60)


def config(tmp_path, *changes):
    base = [f"service.state_dir={tmp_path}", "service.learn='off'", "estimator.name=canest"]
    return load_config("vcan", [*base, *changes])


def forged_torque(drive, can_id, begin_s, end_s):
    """Engine frames with true speeds and half the torque, each a little after the true one."""
    since_s = (drive.t_us - drive.t_us[0]) * 1e-6
    true = drive[(drive.can_id == EEC1) & (since_s >= begin_s) & (since_s < end_s)]
    torque = (true.data >> np.uint64(16)) & np.uint64(0xFF)
    forged = true.data & ~np.uint64(0xFF0000) | (torque // 2 + 62) << np.uint64(16)
    both = FrameBlock.concatenate(
        [drive, FrameBlock(true.t_us + 3000, np.full(len(true), can_id, np.uint32), true.length, forged)]
    )
    return both[np.argsort(both.t_us, kind="stable")]


def test_a_second_sender_of_a_signal_without_a_named_address_is_refused_and_reported(
    tmp_path, drive, monkeypatch
):
    settings = config(tmp_path, "signals.engine_torque_pct.source=null", "signals.engine_speed.source=null")
    with Rig(monkeypatch, settings, forged_torque(drive, EEC1 | 0x31, 50, 80)) as rig:
        rig.run(49)
        before = rig.daemon.estimate(rig.now_us)
        assert before.status == Status.VALID
        rig.run(25)
        after, shown = rig.daemon.estimate(rig.now_us), snapshot(rig.daemon.view(rig.now_us))
    assert abs(after.mass_kg / before.mass_kg - 1) < 0.02
    assert shown["contested_signals"]["engine_torque_pct"]["0x31"] > 500
    assert 'contested-signals now="engine_speed, engine_torque_pct"' in rig.log.getvalue()
    assert any("engine_torque_pct comes from several addresses" in text for _, text in rows(shown))
    labels = 'canest_contested_samples_total{signal="engine_torque_pct",source="0x31"} '
    assert labels in metrics.text(shown)
    json.dumps(shown, allow_nan=False)


def test_a_forger_under_the_right_address_shows_by_the_rate(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), forged_torque(drive, EEC1, 60, 80)) as rig:
        rig.run(59)
        assert snapshot(rig.daemon.view(rig.now_us))["sends_faster"] == {}
        rig.run(18)
        shown = snapshot(rig.daemon.view(rig.now_us))
        usual_hz, now_hz = shown["sends_faster"]["pgn_61444_from_0x00"]
        assert now_hz == pytest.approx(2 * usual_hz, rel=0.1)
        assert 'senders-faster-than-usual now="PGN 61444 from 0x00"' in rig.log.getvalue()
        assert any("Does somebody else send" in text for _, text in rows(shown))
        rig.run(12)
        shown = snapshot(rig.daemon.view(rig.now_us))
        assert shown["sends_faster"] == {} and shown["sent_faster_s"]["pgn_61444_from_0x00"] >= 10
        assert "canest_sender_faster_seconds_total{sender=" in metrics.text(shown)
