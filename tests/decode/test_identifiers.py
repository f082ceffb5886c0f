"""J1939 identifiers against cantools' own packing, and kernel filters against their definition."""

from __future__ import annotations

import random

import cantools.j1939
from decode_helpers import decoder

from canest.core.frames import EXTENDED, ID_MASK, REMOTE
from canest.decode import j1939


def test_group_source_and_destination_equal_cantools():
    rng = random.Random(1)
    for _ in range(2000):
        can_id = rng.getrandbits(29)
        parts = cantools.j1939.frame_id_unpack(can_id)
        assert j1939.pgn_of(can_id | EXTENDED) == cantools.j1939.pgn_from_frame_id(can_id)
        assert j1939.source_of(can_id) == parts.source_address
        specific = cantools.j1939.is_pdu_format_1(parts.pdu_format)
        assert j1939.destination_of(can_id) == (parts.pdu_specific if specific else 0xFF)
        packed = j1939.pack(
            j1939.pgn_of(can_id), parts.source_address, parts.priority, j1939.destination_of(can_id)
        )
        assert packed == can_id | EXTENDED


def passes(can_id: int, filters: list[tuple[int, int]]) -> bool:
    """Linux' rule: received & mask == id & mask, for any filter."""
    return any(can_id & mask == wanted & mask for wanted, mask in filters)


def test_kernel_filters_pass_the_wanted_groups_and_nothing_else():
    d = decoder(
        ("gear", "ETC2", "TransCurrentGear", 3),
        ("reference_torque", "EC1", "EngReferenceTorque", 0),
        ("request", "TC1", "TransRequestedGear", 5),
    )
    assert d.pgns == [0x0100, 0xEB00, 0xEC00, 0xF005, 0xFEE3]
    filters = d.can_filters()
    wanted = [0x18F00503, 0x00F00503, 0x18F00599, 0x18FEE300, 0x1CECFF00, 0x18EB0310, 0x0C010305]
    for can_id in wanted:
        assert passes(can_id | EXTENDED, filters), hex(can_id)
        assert not passes(can_id | EXTENDED | REMOTE, filters), hex(can_id)
    rng = random.Random(2)
    for _ in range(5000):
        can_id = rng.choice([rng.getrandbits(29), rng.choice(wanted) ^ 1 << rng.randrange(29)])
        assert passes(can_id | EXTENDED, filters) == (j1939.pgn_of(can_id) in d.pgns), hex(can_id)
        assert not passes(can_id & 0x7FF, filters)
    assert all(mask & ~(ID_MASK | EXTENDED | REMOTE) == 0 for _, mask in filters)


def test_transport_frames_are_asked_for_only_when_a_long_group_is_wanted():
    assert decoder(("gear", "ETC2", "TransCurrentGear", 3)).pgns == [0xF005]
