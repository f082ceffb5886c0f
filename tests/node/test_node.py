"""The daemon as a node: listening before it sends, requests, other users of its group, other masses."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from canest.config import load_config
from canest.config.bus import Broadcast
from canest.core.frames import FrameBlock
from canest.core.samples import Status
from canest.decode import j1939
from canest.node import node as node_module
from canest.node.address_claim import CLAIM_PGN, REQUEST_PGN, VETO_US
from canest.node.broadcast import PCC1_PGN, Broadcaster, cvw_payload, pcc1_payload
from canest.node.bus_monitor import CVW_PGN, OTHER_MASS_TIMEOUT_US, BusMonitor
from canest.node.estimate_frame import Estimate, decode
from canest.node.network_management import LISTEN_US, QUIET_US
from canest.node.node import Node

GOOD = Estimate(20_000.0, 200.0, 0.02, 0.002, Status.VALID, 0)
OWN_PGN = 0xFF5A
TICK_US = 20_000


class Wire:
    """A transmitter that keeps what it was given; ``full``: it takes nothing."""

    def __init__(self):
        self.sent, self.full, self.counters = [], False, Counter()

    def send(self, can_id, payload):
        self.counters["dropped_buffer_full" if self.full else "sent"] += 1
        if not self.full:
            self.sent.append((can_id, payload))
        return not self.full

    waiting = 0

    def failed(self):
        return []

    def drop_waiting(self):
        pass

    def groups(self):
        return [j1939.pgn_of(can_id) for can_id, _ in self.sent]


class Bus:
    """A node on a bus, in ticks of 20 ms, with an estimate that is fresh at every tick."""

    def __init__(self, *changes, estimate=GOOD):
        config = load_config("vcan", changes)
        self.now_us, self.estimate, self.wire = 5_000_000, estimate, Wire()
        self.node = Node(config, BusMonitor(config.broadcast.pgn))
        self.node.attach(config, self.wire, self.now_us)

    def run(self, us, frames=()):
        end = self.now_us + us
        block = FrameBlock.from_frames([(self.now_us, i, p) for i, p in frames])
        while self.now_us < end:
            self.node.observe(block, self.now_us)
            block = FrameBlock.empty()
            if self.estimate is not None:
                self.node.set_estimate(self.estimate, self.now_us)
            self.node.send_due(self.now_us)
            self.now_us += TICK_US
        return self

    def estimates(self):
        return [(i, p) for i, p in self.wire.sent if j1939.pgn_of(i) == OWN_PGN]


def request(pgn, source=0x21, destination=0xFF):
    return j1939.pack(REQUEST_PGN, source, destination=destination), pgn.to_bytes(3, "little")


def test_it_claims_waits_and_only_then_broadcasts():
    bus = Bus().run(LISTEN_US - TICK_US)
    assert bus.wire.groups() == [CLAIM_PGN]
    bus.run(500_000)
    assert OWN_PGN in bus.wire.groups()
    assert {j1939.source_of(i) for i, _ in bus.estimates()} == {158}


def test_broadcast_comes_at_the_configured_rate_with_a_counter_that_never_skips():
    bus = Bus("broadcast.rate_hz=10").run(LISTEN_US + 10_000_000)
    counters = [decode(p, i).counter for i, p in bus.estimates()]
    assert 98 <= len(counters) <= 102
    assert all((b - a) % 16 == 1 for a, b in pairwise(counters))
    assert all(decode(p, i).intact for i, p in bus.estimates())


@pytest.mark.parametrize("rate_hz", [1, 3, 20, 50])
def test_any_rate_up_to_the_grid_is_kept_on_average(rate_hz):
    bus = Bus(f"broadcast.rate_hz={rate_hz}").run(LISTEN_US + 10_000_000)
    assert abs(len(bus.estimates()) - 10 * rate_hz) <= 2


@pytest.mark.parametrize("stall_us", [300_000, 900_000, 1_900_000])
def test_beats_missed_while_we_were_stopped_are_not_made_up_for(stall_us):
    bus = Bus("broadcast.rate_hz=5").run(LISTEN_US + 1_000_000)
    bus.wire.sent.clear()
    bus.now_us += stall_us
    bus.run(1_000_000)
    assert 5 <= len(bus.estimates()) <= 6


def test_a_group_somebody_else_uses_ends_our_broadcast_with_a_reason():
    foreign = (j1939.pack(OWN_PGN, 0x44), bytes(8))
    bus = Bus().run(500_000).run(LISTEN_US + 3_000_000, [foreign])
    assert bus.estimates() == []
    assert "0xff5a" in bus.node.silence_reason(bus.now_us) and "0x44" in bus.node.silence_reason(bus.now_us)
    bus.run(QUIET_US)
    assert bus.estimates()


def test_a_forged_frame_in_our_group_after_we_began_does_not_silence_us():
    bus = Bus().run(LISTEN_US + 1_000_000)
    before = len(bus.estimates())
    bus.run(2_000_000, [(j1939.pack(OWN_PGN, 0x44), bytes(8))])
    assert len(bus.estimates()) > before + 7
    assert 0x44 in bus.node.monitor.group_users


def test_losing_the_address_stops_the_broadcast_until_another_is_owned():
    bus = Bus().run(LISTEN_US + 1_000_000)
    bus.wire.sent.clear()
    bus.run(200_000, [(j1939.pack(CLAIM_PGN, 158), (1).to_bytes(8, "little"))])
    assert bus.wire.groups() == [CLAIM_PGN]
    bus.run(1_000_000)
    assert {j1939.source_of(i) for i, _ in bus.estimates()} == {159}


def test_after_the_machine_was_suspended_the_address_is_claimed_again_before_it_is_used(monkeypatch):
    bus = Bus().run(3_000_000)
    suspended_us = 60_000_000  # in which the monotonic clock stands still
    boottime_us = node_module.boottime_us
    monkeypatch.setattr(node_module, "boottime_us", lambda: boottime_us() + suspended_us)
    bus.wire.sent.clear()
    bus.run(200_000)
    assert bus.wire.groups() == [CLAIM_PGN]
    assert bus.run(1_000_000).estimates()


def test_a_stale_estimate_is_sent_as_not_available():
    bus = Bus().run(LISTEN_US + 500_000)
    bus.estimate = None
    bus.run(1_000_000)
    can_id, payload = bus.estimates()[-1]
    assert decode(payload, can_id).estimate.status == 3
    assert payload[:6] == b"\xff" * 6


def test_requests_for_our_group_are_answered_at_once_but_not_in_a_flood():
    bus = Bus("broadcast.rate_hz=1").run(LISTEN_US + 500_000)
    before = len(bus.estimates())
    bus.run(TICK_US, [request(OWN_PGN)])
    assert len(bus.estimates()) == before + 1
    for _ in range(500):
        bus.run(TICK_US, [request(OWN_PGN)] * 10)
    assert len(bus.estimates()) - before <= 10 * 10 + 12


def test_a_request_for_claims_is_answered():
    bus = Bus().run(LISTEN_US)
    bus.run(100_000, [request(CLAIM_PGN)])
    assert bus.wire.groups().count(CLAIM_PGN) == 2


def test_a_personal_request_for_what_we_do_not_send_is_refused_politely():
    bus = Bus().run(LISTEN_US)
    bus.run(200_000, [request(65262, source=0x21, destination=158)])
    [(can_id, payload)] = [(i, p) for i, p in bus.wire.sent if j1939.pgn_of(i) == 0xE800]
    assert payload == bytes([1, 0xFF, 0xFF, 0xFF, 0x21]) + (65262).to_bytes(3, "little")
    assert j1939.source_of(can_id) == 158


def test_a_flood_of_personal_requests_is_answered_ten_times_a_second_at_most():
    bus = Bus().run(LISTEN_US)
    for _ in range(250):
        bus.run(TICK_US, [request(65262, destination=158)] * 20)
    assert bus.wire.groups().count(0xE800) <= 52


def test_requests_to_others_are_none_of_our_business():
    bus = Bus().run(LISTEN_US)
    bus.run(500_000, [request(65262, destination=0x00), request(65262)])
    assert 0xE800 not in bus.wire.groups()


def test_a_full_interface_drops_and_counts_and_never_stops_us():
    bus = Bus().run(LISTEN_US + 500_000)
    bus.wire.full = True
    bus.run(2_000_000)
    bus.wire.full = False
    before = len(bus.estimates())
    bus.run(1_000_000)
    assert bus.node.counters()["dropped_buffer_full"] >= 9
    assert len(bus.estimates()) - before >= 4


def test_standard_places_are_silent_by_default():
    assert set(Bus().run(LISTEN_US + 5_000_000).wire.groups()) == {CLAIM_PGN, OWN_PGN}


def test_standard_places_carry_only_what_is_valid():
    bus = Bus("broadcast.cvw=true", "broadcast.pcc1=true").run(LISTEN_US + 5_000_000)
    cvw = [p for i, p in bus.wire.sent if j1939.pgn_of(i) == CVW_PGN]
    assert 4 <= len(cvw) <= 6
    assert int.from_bytes(cvw[-1][2:4], "little") == 2000
    assert cvw[-1][:2] + cvw[-1][4:] == b"\xff" * 6
    pcc1 = [(i, p) for i, p in bus.wire.sent if j1939.pgn_of(i) == PCC1_PGN]
    assert pcc1[-1][1][3] == round((2 + 16) / 0.125)
    assert pcc1[-1][0] >> 26 & 7 == 3
    bus.wire.sent.clear()
    bus.estimate = Estimate(20_000.0, 4_000.0, 0.02, 0.002, Status.CONVERGING, 0)
    bus.run(3_000_000)
    assert set(bus.wire.groups()) == {OWN_PGN}


def test_the_gross_mass_of_another_ecu_is_not_talked_over():
    bus = Bus("broadcast.cvw=true").run(LISTEN_US)
    theirs = j1939.pack(CVW_PGN, 0x0B), b"\xff\xff" + (2100).to_bytes(2, "little") + b"\xff" * 4
    bus.run(TICK_US, [theirs])
    bus.wire.sent.clear()
    bus.run(OTHER_MASS_TIMEOUT_US - 2_000_000, [request(CVW_PGN)])
    assert set(bus.wire.groups()) == {OWN_PGN}
    assert bus.node.counters()["left_to_other_senders"] > 50
    bus.run(5_000_000)
    assert CVW_PGN in bus.wire.groups()


def test_the_odometer_is_read_from_the_first_sender_that_has_it():
    monitor = BusMonitor(OWN_PGN)
    assert monitor.distance_km is None
    unknown, known = b"\xff" * 8, (200_000).to_bytes(4, "little") + b"\xff" * 4
    for source, payload in ((0x00, unknown), (0x17, known), (0x00, bytes(8))):
        monitor.observe(FrameBlock.from_frames([(0, j1939.pack(65217, source), payload)]), 0)
    assert monitor.distance_km == pytest.approx(1000.0)
    other = BusMonitor(OWN_PGN)
    low = b"\xff" * 4 + (8000).to_bytes(4, "little")
    other.observe(FrameBlock.from_frames([(0, j1939.pack(65248, 0x00), low)]), 0)
    assert other.distance_km == pytest.approx(1000.0)


def odometer_of(senders, driven_km=2.0, speed_mps=20.0):
    """Drive with odometers that each send km of the distance driven so far (km), once a second."""
    monitor = BusMonitor(OWN_PGN)
    for second in range(round(driven_km * 1000 / speed_mps)):
        for source, count in senders.items():
            raw = round(count(second * speed_mps / 1000) / 0.005)
            payload = raw.to_bytes(4, "little") + b"\xff" * 4
            monitor.observe(FrameBlock.from_frames([(0, j1939.pack(65217, source), payload)]), 0)
        monitor.odometer.add_driven(np.full(50, speed_mps))
    return monitor.odometer


def test_an_odometer_that_counts_what_is_driven_is_confirmed_whoever_sent_first():
    noise = np.random.default_rng(1)
    senders = {
        0x00: lambda km: 5_000_000.0,  # stands still
        0x01: lambda km: noise.uniform(0, 9_000_000),
        0x02: lambda km: 18_968_163.0 + km,  # counts, and is beyond every vehicle
        0x03: lambda km: 700_000.0 - km,
        0x04: lambda km: 800_000.0 + 5 * km,
        0x17: lambda km: 123_456.0 + 1.1 * km,  # the wheel radius of the config is wrong by a tenth
    }
    odometer = odometer_of(senders)
    assert odometer.confirmed_km == odometer.reported_km == pytest.approx(123_458.2, abs=0.1)
    del senders[0x17]
    assert odometer_of(senders).confirmed_km is None


def test_an_odometer_is_not_confirmed_before_the_vehicle_has_driven():
    assert odometer_of({0x17: lambda km: 1000.0 + km}, driven_km=0.4).confirmed_km is None
    assert odometer_of({0x17: lambda km: 1000.0 + km}, driven_km=0.6).confirmed_km is not None


def test_an_odometer_that_leaps_is_confirmed_anew():
    odometer = odometer_of({0x17: lambda km: 1000.0 + km + (5000 if km > 1.9 else 0)})
    assert odometer.confirmed_km is None


@pytest.mark.parametrize("mass_kg", [float("nan"), -1.0, 642_600.0])
def test_a_mass_outside_spn_1760_is_not_sent(mass_kg):
    assert cvw_payload(mass_kg) is None


@pytest.mark.parametrize("grade", [float("nan"), -0.17, 0.16])
def test_a_grade_outside_spn_7432_is_not_sent(grade):
    assert pcc1_payload(grade) is None


def test_masses_of_other_ecus_are_kept_per_address():
    def cvw(raw, source):
        return j1939.pack(CVW_PGN, source), b"\xff\xff" + raw.to_bytes(2, "little") + b"\xff" * 4

    bus = Bus().run(TICK_US, [cvw(3750, 0x0B), cvw(3980, 0x27), cvw(0, 0x03), cvw(0xFFFF, 0x05)])
    assert {a: m.mass_kg for a, m in bus.node.monitor.other_masses.items()} == {
        0x0B: 37_500.0,
        0x27: 39_800.0,
    }
    bus.run(TICK_US, [cvw(0, 0x0B)])
    assert bus.node.monitor.other_masses[0x0B].mass_kg == 37_500.0


def test_a_node_without_transmitter_has_nothing_that_could_send():
    config = load_config("vcan", ["broadcast.listen_only=true"])
    node = Node(config, BusMonitor(config.broadcast.pgn))
    node.observe(FrameBlock.from_frames([(0, *request(CLAIM_PGN))]), 0)
    node.set_estimate(GOOD, 0)
    node.send_due(0)
    assert node.network_management is None and node.broadcaster is None and node.transmitter is None
    assert "listen" in node.silence_reason(0)


def test_remote_error_standard_and_short_frames_are_no_messages():
    monitor = BusMonitor(OWN_PGN)
    claim = j1939.pack(CLAIM_PGN, 0x31)
    monitor.observe(
        FrameBlock.from_frames(
            [(0, claim | 0x4000_0000, b""), (0, claim | 0x2000_0000, bytes(8)), (0, 0x123, bytes(8)),
             (0, claim, bytes(3)), (0, j1939.pack(REQUEST_PGN, 1, destination=255), b"\x00")]
        ),
        0,
    )  # fmt: skip
    assert monitor.claims == [] and monitor.requests == []
    assert monitor.counters["wrong_length"] == 1


def test_noise_of_every_identifier_does_not_make_the_monitor_grow():
    monitor = BusMonitor(OWN_PGN)
    for begin in range(0, 50_000, 5000):
        monitor.observe(
            FrameBlock.from_frames([(0, 0x8000_0000 | 7919 * i, b"") for i in range(begin, begin + 5000)]), 0
        )
    assert len(monitor.ignored_ids) <= 4096


def test_the_group_set_of_a_broadcaster_follows_the_config():
    assert Broadcaster(Broadcast()).groups == {OWN_PGN}
    assert Broadcaster(Broadcast(cvw=True, pcc1=True)).groups == {OWN_PGN, CVW_PGN, PCC1_PGN}


class SlowWire(Wire):
    """Takes every frame, and sends it when `finish` is called, or never."""

    def __init__(self):
        super().__init__()
        self.queue, self.lost = [], []

    @property
    def waiting(self):
        return len(self.queue)

    def send(self, can_id, payload):
        self.queue.append((can_id, payload))
        return True

    def failed(self):
        lost, self.lost = self.lost, []
        return lost

    def drop_waiting(self):
        self.lost += [can_id for can_id, _ in self.queue]
        self.queue.clear()

    def finish(self, fails=False):
        if fails:
            self.lost += [can_id for can_id, _ in self.queue]
        else:
            self.sent += self.queue
        self.queue.clear()


def slow_bus():
    bus = Bus()
    bus.wire = bus.node.transmitter = SlowWire()
    return bus


def test_a_claim_stands_only_250_ms_after_it_was_on_the_bus():
    bus = slow_bus().run(2_000_000)  # an adapter that takes its time has the claim
    assert bus.node.address is None and bus.wire.waiting
    bus.wire.finish()
    bus.run(VETO_US - TICK_US)
    assert bus.node.address is None
    bus.run(3 * TICK_US)
    assert bus.node.address == 158


def test_a_claim_that_was_never_sent_is_sent_again():
    bus = slow_bus().run(LISTEN_US)
    bus.wire.finish(fails=True)
    bus.run(2 * TICK_US)
    assert [j1939.pgn_of(i) for i, _ in bus.wire.queue] == [CLAIM_PGN] and not bus.wire.sent
    bus.wire.finish()
    bus.run(VETO_US + 3 * TICK_US)
    assert bus.node.address == 158


def test_no_frame_goes_out_from_an_address_that_was_lost():
    bus = slow_bus().run(TICK_US)
    bus.wire.finish()
    bus.run(VETO_US + 2_000_000)
    assert {j1939.source_of(i) for i, _ in bus.wire.queue} == {158}
    bus.run(TICK_US, [(j1939.pack(CLAIM_PGN, 158), bytes(8))])  # a lower NAME
    bus.run(TICK_US)
    assert 158 not in {j1939.source_of(i) for i, _ in bus.wire.queue}
