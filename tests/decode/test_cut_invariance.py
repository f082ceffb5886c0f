"""However a stream is cut, and whichever path decodes it, samples and counters are the same to the bit."""

from __future__ import annotations

from unittest import mock

import cantools
from decode_helpers import assert_same_samples, block_of_log, push_cut, shipped_database, wants
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core.frames import ERROR, EXTENDED, REMOTE, FrameBlock
from canest.decode import Decoder
from canest.decode import decoder as decoder_module

OWN = cantools.database.load_string(
    """VERSION ""
BU_: X
BO_ 291 OwnStandard: 4 X
 SG_ Speed : 7|16@0+ (0.01,0) [0|0] "m/s" X
BO_ 2566844926 OwnExtended: 8 X
 SG_ Which M : 0|8@1+ (1,0) [0|0] "" X
 SG_ Torque m1 : 8|16@1- (0.5,0) [0|0] "Nm" X
 SG_ Other m2 : 8|8@1+ (1,0) [0|0] "" X
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_  "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566844926 1;
""",
    "dbc",
)
WANTS = wants(
    ("engine_torque_pct", "EEC1", "ActualEngPercentTorque", 0),
    ("engine_speed", "EEC1", "EngSpeed", None),
    ("vehicle_speed", "CCVS1", "WheelBasedVehicleSpeed", None),
    ("brake_switch", "CCVS1", "BrakeSwitch", None),
    ("parking_brake", "CCVS1", "ParkingBrakeSwitch", 0x31),
    ("gear", "J1587Gateway", "TransRangeAttained", 0xF9, "ascii"),
    ("abs_active", "J1587Gateway", "ServiceBrakeSwitch", None, "full"),
    ("selected_gear", "TC1", "TransRequestedGear", 5, "gear"),
    ("reference_torque", "EC1", "EngReferenceTorque", None),
    ("retarder_reference_torque", "RC", "RetarderReferenceTorque", 0x0F),
    ("gps_speed", "OwnStandard", "Speed", None, "full"),
    ("wheel_torque", "OwnExtended", "Torque", None, "full"),
)
DATABASES = [OWN, *(shipped_database(n) for n in ("j1939", "j1587_gateway"))]

ADDRESSES = [0x00, 0x31, 0x0F, 0x05, 0xF9]
GROUPS = [0xCF00400, 0x18FEF100, 0x18FF8700, 0xC010300, 0x18FEE300, 0x18FEE100, 0x18FF1200]
ids = st.one_of(
    st.builds(lambda group, sa: group | sa | EXTENDED, st.sampled_from(GROUPS), st.sampled_from(ADDRESSES)),
    st.sampled_from([291, 2566844926, 291 | EXTENDED, 0x4, 0x100]),
    st.builds(lambda i, flag: i | flag, st.integers(0, 0x1FFFFFFF), st.sampled_from([0, EXTENDED])),
)
flags = st.sampled_from([0] * 12 + [REMOTE, ERROR])
payload = st.one_of(
    st.binary(min_size=8, max_size=8),
    st.binary(min_size=8, max_size=8),
    st.binary(max_size=12),
    st.builds(
        lambda mid, pid, rest: bytes([mid, pid]) + rest,
        st.sampled_from([1, 2, 3, 0x80]),
        st.sampled_from([65, 163, 84, 7]),
        st.sampled_from([b"6 \xff\xff\xff\xff", b"N \0\0\0\0", b"\1\0\0\0\0\0"]),
    ),
    st.just(b"\xff" * 8),
)
plain = st.builds(lambda i, f, p: [(i | f, p)], ids, flags, payload)


def multi_packet(pgn: int, source: int, body: bytes, mangle: list[int]) -> list[tuple[int, bytes]]:
    """A broadcast of ``body``, its packets reordered, lost or doubled as ``mangle`` says."""
    packets = -(-len(body) // 7)
    head = bytes([32]) + len(body).to_bytes(2, "little") + bytes([packets, 0xFF]) + pgn.to_bytes(3, "little")
    data = [bytes([k + 1]) + body[7 * k : 7 * k + 7].ljust(7, b"\xff") for k in range(packets)]
    frames = [(0x1CECFF00 | source | EXTENDED, head)]
    frames += [(0x1CEBFF00 | source | EXTENDED, p) for p in data]
    for k in mangle:
        frames.insert(k % len(frames), frames.pop((k * 7 + 1) % len(frames)))
        if k % 3 == 0:
            frames.pop(k % len(frames))
            frames = frames or [(0x1CECFF00 | source | EXTENDED, head)]
    return frames


transport = st.builds(
    multi_packet,
    st.sampled_from([0xFEE3, 0xFEE1, 0xFECA]),
    st.sampled_from(ADDRESSES),
    st.binary(min_size=19, max_size=40),
    st.one_of(st.just([]), st.lists(st.integers(0, 50), max_size=3)),
)
steps = st.sampled_from([0, 1, 500, 20_000, 50_000, 800_000, 6_000_000, -3_000, -40_000_000])


@st.composite
def streams(draw) -> FrameBlock:
    frames, now = [], 10_000_000_000
    for group in draw(st.lists(st.one_of(plain, plain, plain, transport), min_size=1, max_size=60)):
        for can_id, data in group:
            now += draw(steps) if draw(st.booleans()) else 1_000
            frames.append((now, can_id, data))
    return FrameBlock.from_frames(frames)


@settings(max_examples=120, deadline=None)
@given(block=streams(), data=st.data())
def test_any_cut_and_either_path(block, data):
    one_by_one = Decoder(WANTS, DATABASES)
    with mock.patch.object(decoder_module, "SHORT_BLOCK", 10**9):
        expected, expected_end = push_cut(one_by_one, block, range(1, len(block)))
    for short in (0, 5, 10**9):
        cuts = data.draw(st.lists(st.integers(0, len(block)), max_size=6))
        fresh = Decoder(WANTS, DATABASES)
        with mock.patch.object(decoder_module, "SHORT_BLOCK", short):
            samples, end = push_cut(fresh, block, cuts)
        assert_same_samples(expected, samples)
        assert end == expected_end
        assert fresh.counters == one_by_one.counters


def test_real_log_in_live_blocks_equals_the_log_at_once():
    block = block_of_log("kenworth/normal.log.xz")
    at_once = Decoder(WANTS, DATABASES)
    expected, end = push_cut(at_once, block, [])
    assert set(expected) >= {
        "engine_torque_pct",
        "engine_speed",
        "vehicle_speed",
        "brake_switch",
        "reference_torque",
    }
    live = Decoder(WANTS, DATABASES)
    samples, live_end = push_cut(live, block, range(13, len(block), 13))
    assert_same_samples(expected, samples)
    assert live_end == end
    assert live.counters == at_once.counters
