"""Multi-packet groups: what arrives whole is delivered, anything else is dropped and counted."""

from __future__ import annotations

import random

import pytest
from decode_helpers import decoder

from canest.core.frames import EXTENDED, FrameBlock
from canest.decode.transport_protocol import MAX_SESSIONS, Transport

pytestmark = pytest.mark.usefixtures("both_paths")

EC1, ANY = 0xFEE3, 0xFF
MS = 1000


class Bus:
    """Collects frames with their stamps; 50 ms between packets, as real engines send."""

    def __init__(self) -> None:
        self.now_us = 1_000_000
        self.frames: list[tuple[int, int, bytes]] = []

    def send(
        self, pgn: int, source: int, payload: bytes, destination: int = ANY, gap_us: int = 50 * MS
    ) -> None:
        self.now_us += gap_us
        self.frames.append(
            (self.now_us, 0x1C000000 | pgn << 8 | destination << 8 | source | EXTENDED, payload)
        )

    def manage(
        self, control: int, *rest: int, pgn: int = EC1, source: int = 0, destination: int = ANY
    ) -> None:
        head = bytes([control, *rest, *([0xFF] * (4 - len(rest)))])
        self.send(0xEC00, source, head + pgn.to_bytes(3, "little"), destination)

    def announce(self, body: bytes, source: int = 0, pgn: int = EC1) -> None:
        self.manage(32, len(body) & 0xFF, len(body) >> 8, -(-len(body) // 7), pgn=pgn, source=source)

    def packet(self, body: bytes, number: int, source: int = 0, **more: int) -> None:
        chunk = body[7 * (number - 1) : 7 * number].ljust(7, b"\xff")
        self.send(0xEB00, source, bytes([number]) + chunk, **more)

    def broadcast(self, body: bytes, source: int = 0, pgn: int = EC1) -> None:
        self.announce(body, source, pgn)
        for number in range(1, -(-len(body) // 7) + 1):
            self.packet(body, number, source)


def engine_configuration(torque_Nm: int, length: int = 28) -> bytes:
    body = bytearray(random.Random(torque_Nm).randbytes(length))
    body[19:21] = torque_Nm.to_bytes(2, "little")
    return bytes(body)


def received(bus: Bus, source: int | None = 0):
    d = decoder(("reference_torque", "EC1", "EngReferenceTorque", source))
    samples = d.push(FrameBlock.from_frames(bus.frames)).samples
    t_us, values = samples.get("reference_torque", ([], []))
    return list(t_us), list(values), d.counters


@pytest.mark.parametrize("length", [28, 34, 39, 40, 60])
def test_every_edition_gives_the_reference_torque_at_the_stamp_of_its_last_packet(length):
    bus = Bus()
    bus.broadcast(engine_configuration(2450, length))
    t_us, values, counters = received(bus)
    assert (t_us, values) == ([bus.now_us], [2450])
    assert counters.transport == {"complete": 1}


def test_edition_too_short_for_the_signal_gives_no_sample():
    bus = Bus()
    bus.broadcast(engine_configuration(2450)[:20])
    assert received(bus)[1] == []


def test_not_available_is_a_sample_without_a_number():
    bus = Bus()
    bus.broadcast(b"\xff" * 28)
    _, (value,), counters = received(bus)
    assert value != value  # noqa: PLR0124
    assert counters.senders[EC1, 0].not_available == 1


def faulty(how: str) -> Bus:
    """Send one broadcast with the fault, then a good one."""
    bus = Bus()
    body = engine_configuration(1111)
    bus.announce(body)
    order = {
        "lost": [1, 2, 4],
        "other content": [1, 2, 2, 3, 4],
        "swapped": [1, 3, 2, 4],
        "starts late": [2, 3, 4],
        "unknown number": [1, 2, 9, 3, 4],
        "number zero": [0, 1, 2, 3, 4],
        "cut short": [1, 2, 3],
    }[how]
    for number in order:
        bus.packet(body, max(number, 1))
        t_us, can_id, payload = bus.frames[-1]
        if number in (0, 9):
            bus.frames[-1] = (t_us, can_id, bytes([number]) + payload[1:])
        if how == "other content":
            bus.frames[-1] = (t_us, can_id, payload[:7] + bytes([len(bus.frames)]))
    bus.broadcast(engine_configuration(2222))
    return bus


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("lost", "sequence"),
        ("other content", "duplicate"),
        ("swapped", "sequence"),
        ("starts late", "sequence"),
        ("unknown number", "sequence"),
        ("number zero", "sequence"),
        ("cut short", "superseded"),
    ],
)
def test_faulty_broadcast_is_dropped_and_the_next_one_is_good(how, reason):
    _, values, counters = received(faulty(how))
    assert values == [2222]
    assert counters.transport == {reason: 1, "complete": 1}
    assert counters.senders[EC1, 0].transport_errors == 1


@pytest.mark.parametrize("later_us", [0, 3 * MS])
def test_a_log_of_two_interfaces_on_the_same_bus(later_us):
    bus = Bus()
    bus.broadcast(engine_configuration(2450))
    bus.frames = [(t_us + k * later_us, *rest) for t_us, *rest in bus.frames for k in (0, 1)]
    _, values, counters = received(bus)
    assert values == [2450]
    assert counters.transport == {"complete": 1, "repeated": 4}
    assert counters.senders[EC1, 0].transport_errors == 0


def test_head_of_one_after_the_tail_of_another():
    bus, first, second = Bus(), engine_configuration(1111), engine_configuration(2222)
    bus.announce(first)
    for number in (1, 2):
        bus.packet(first, number)
    bus.announce(second)
    for number in (3, 4):
        bus.packet(first, number)
    for number in (1, 2, 3, 4):
        bus.packet(second, number)
    _, values, counters = received(bus)
    assert values == []
    assert counters.transport == {"superseded": 1, "sequence": 1}


def test_tail_of_a_later_broadcast_never_completes_an_earlier_one():
    bus, first, second = Bus(), engine_configuration(1111), engine_configuration(2222)
    bus.announce(first)
    for number in (1, 2):
        bus.packet(first, number)
    bus.packet(second, 3, gap_us=900 * MS)  # all between the two was lost
    bus.packet(second, 4)
    _, values, counters = received(bus)
    assert values == []
    assert counters.transport == {"timeout": 1}


def test_interleaved_senders_do_not_mix():
    bus = Bus()
    bodies = {0: engine_configuration(1000), 1: engine_configuration(3000), 2: bytes(range(28))}
    bus.announce(bodies[0], 0)
    bus.announce(bodies[1], 1)
    bus.announce(bodies[2], 2, pgn=0xFECA)
    for number in (1, 2, 3, 4):
        for source in (2, 0, 1):
            bus.packet(bodies[source], number, source)
    assert received(bus, 0)[1] == [1000]
    assert received(bus, 1)[1] == [3000]


def test_announcement_that_contradicts_itself_is_counted():
    bus = Bus()
    bus.manage(32, 28, 0, 5)  # 28 bytes are four packets
    bus.manage(32, 8, 0, 2)  # eight bytes need no transport
    bus.manage(32, 0xFA, 0x06, 255)  # 1786 bytes are one too many
    assert received(bus)[2].transport == {"size": 3}


def test_short_packet_drops_the_session():
    bus, body = Bus(), engine_configuration(1111)
    bus.announce(body)
    bus.packet(body, 1)
    bus.send(0xEB00, 0, b"\x02\x01\x02")
    for number in (2, 3, 4):
        bus.packet(body, number)
    assert received(bus)[1:2] == ([],)


def destination_specific(bus: Bus, body: bytes) -> None:
    bus.manage(16, len(body), 0, 4, 4, source=0, destination=3)


def test_session_of_others_with_a_repeated_request():
    bus, body = Bus(), engine_configuration(1900)
    destination_specific(bus, body)
    bus.manage(17, 2, 1, source=3, destination=0)
    for number in (1, 2):
        bus.packet(body, number, destination=3)
    bus.manage(17, 3, 2, source=3, destination=0)  # the receiver wants packet 2 again
    for number in (2, 3, 4):
        bus.packet(body, number, destination=3)
    bus.manage(19, 28, 0, 4, source=3, destination=0)
    assert received(bus)[1] == [1900]


@pytest.mark.parametrize("by", [0, 3])
def test_session_of_others_aborted_by_either_side(by):
    bus, body = Bus(), engine_configuration(1900)
    destination_specific(bus, body)
    bus.packet(body, 1, destination=3)
    bus.manage(255, 2, source=by, destination=3 - by)
    for number in (2, 3, 4):
        bus.packet(body, number, destination=3)
    _, values, counters = received(bus)
    assert values == []
    assert counters.transport == {"aborted": 1}


def test_broadcast_and_session_of_one_sender_run_side_by_side():
    bus, one, other = Bus(), engine_configuration(1000), engine_configuration(2000)
    destination_specific(bus, one)
    bus.announce(other)
    for number in (1, 2, 3, 4):
        bus.packet(one, number, destination=3)
        bus.packet(other, number)
    assert received(bus)[1] == [1000, 2000]


def test_noise_never_raises_and_memory_is_bounded():
    rng = random.Random(5)
    dropped: list[tuple[int, int]] = []
    transport = Transport(lambda pgn, source: True, lambda pgn, source: dropped.append((pgn, source)))
    for t_us in range(20_000):
        source, destination = rng.randrange(256), rng.choice([3, 255, rng.randrange(256)])
        if rng.random() < 0.7:
            control = rng.choice([16, 17, 19, 32, 32, 255, rng.randrange(256)])
            size = rng.randrange(9, 1786)
            head = bytes([control]) + size.to_bytes(2, "little") + bytes([-(-size // 7), 255, 0xE3, 0xFE, 0])
            transport.manage(
                t_us, source, destination, rng.choice([8, 8, 8, 3]), int.from_bytes(head, "little")
            )
        else:
            transport.packet(t_us, source, destination, 8, rng.getrandbits(64))
        assert transport.open_sessions <= MAX_SESSIONS
    assert transport.counts["evicted"] > 0
