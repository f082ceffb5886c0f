"""Directed requests that cannot be met are refused with a NACK (SAE J1939-21), global ones never."""

from __future__ import annotations

from canest.core.samples import Status
from canest.decode import j1939
from canest.node.address_claim import CLAIM_PGN
from canest.node.bus_monitor import CVW_PGN
from canest.node.estimate_frame import Estimate
from canest.node.network_management import LISTEN_US
from tests.node.test_node import OWN_PGN, TICK_US, Bus, request

CONVERGING = Estimate(20_000.0, 4_000.0, 0.02, 0.002, Status.CONVERGING, 0)


def refusals(bus):
    return [p for i, p in bus.wire.sent if j1939.pgn_of(i) == 0xE800 and j1939.source_of(i) == 158]


def nack(pgn, requester):
    return bytes([1, 0xFF, 0xFF, 0xFF, requester]) + pgn.to_bytes(3, "little")


def test_a_directed_request_for_the_gross_mass_is_refused_while_it_is_not_valid():
    bus = Bus("broadcast.cvw=true", estimate=CONVERGING).run(LISTEN_US)
    bus.run(200_000, [request(CVW_PGN, destination=158)])
    assert refusals(bus) == [nack(CVW_PGN, 0x21)]
    assert CVW_PGN not in bus.wire.groups()
    assert bus.node.counters()["requests_refused"] == 1


def test_a_directed_request_for_the_gross_mass_is_answered_with_it_once_valid():
    bus = Bus("broadcast.cvw=true").run(LISTEN_US + 200_000)
    before = bus.wire.groups().count(CVW_PGN)
    bus.run(TICK_US, [request(CVW_PGN, destination=158)])
    assert bus.wire.groups().count(CVW_PGN) == before + 1
    assert refusals(bus.run(300_000)) == []


def test_a_global_request_for_the_gross_mass_is_never_refused():
    bus = Bus("broadcast.cvw=true", estimate=CONVERGING).run(LISTEN_US)
    assert refusals(bus.run(500_000, [request(CVW_PGN)])) == []


def test_a_directed_request_for_a_group_left_to_another_sender_is_refused():
    bus = Bus("broadcast.cvw=true").run(LISTEN_US)
    theirs = j1939.pack(CVW_PGN, 0x0B), b"\xff\xff" + (2100).to_bytes(2, "little") + b"\xff" * 4
    bus.run(200_000, [theirs, request(CVW_PGN, destination=158)])
    assert refusals(bus) == [nack(CVW_PGN, 0x21)]


def test_a_directed_request_for_our_own_group_is_refused_while_we_are_silent():
    bus = Bus().run(500_000)  # the address is owned, but it still listens
    bus.run(200_000, [request(OWN_PGN, destination=158)])
    assert refusals(bus) == [nack(OWN_PGN, 0x21)]


def test_requesters_that_are_refused_at_once_get_one_answer_each():
    bus = Bus("broadcast.cvw=true", estimate=CONVERGING).run(LISTEN_US)
    bus.run(500_000, [request(CVW_PGN, source, 158) for source in (0x21, 0x21, 0x31, 0x41)])
    assert refusals(bus) == [nack(CVW_PGN, requester) for requester in (0x21, 0x31, 0x41)]


def test_a_flood_of_directed_requests_for_the_gross_mass_is_refused_ten_times_a_second_at_most():
    bus = Bus("broadcast.cvw=true", estimate=CONVERGING).run(LISTEN_US)
    for n in range(250):
        bus.run(TICK_US, [request(CVW_PGN, (20 * n + k) % 128, 158) for k in range(20)])
    assert 40 <= len(refusals(bus)) <= 52
    assert bus.node.counters()["requests_unanswered"] > 4000


def test_a_refusal_that_the_interface_did_not_take_repeats_no_claim():
    bus = Bus().run(LISTEN_US)
    bus.wire.full = True
    bus.run(TICK_US, [request(65262, destination=158)])
    bus.wire.full = False
    bus.wire.sent.clear()
    assert CLAIM_PGN not in bus.run(200_000).wire.groups()
