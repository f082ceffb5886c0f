"""Which frames become samples: addresses, lengths, flags, multiplexors, several senders of one group."""

from __future__ import annotations

import math

import cantools
import numpy as np
import pytest
from decode_helpers import decoder, shipped_database, wants

from canest.core.errors import ConfigError
from canest.core.frames import ERROR, EXTENDED, REMOTE, FrameBlock
from canest.decode import Decoder
from canest.decode import decoder as decoder_module

pytestmark = pytest.mark.usefixtures("both_paths")

SPEED = ("vehicle_speed", "CCVS1", "WheelBasedVehicleSpeed")
ABSENT = b"\xff" * 8


def speed(kmh: float) -> bytes:
    return b"\xff" + round(kmh * 256).to_bytes(2, "little") + b"\xff" * 5


def ccvs(source: int, priority: int = 6) -> int:
    return EXTENDED | priority << 26 | 0xFEF100 | source


def push(d: Decoder, frames: list[tuple[int, int, bytes]]):
    return d.push(FrameBlock.from_frames(frames))


def numbers(result, role: str) -> list[float | None]:
    """Values of a role, None for NaN."""
    return [None if math.isnan(v) else v for v in result.samples.get(role, ([], []))[1]]


def test_configured_address_is_decoded_and_others_are_counted():
    d = decoder((*SPEED, 0x00))
    result = push(d, [(1, ccvs(0x00), speed(50)), (2, ccvs(0x31), speed(99)), (3, ccvs(0x00, 3), speed(51))])
    assert numbers(result, "vehicle_speed") == [50, 51]
    assert result.samples["vehicle_speed"][0].tolist() == [1, 3]
    assert d.counters.other_senders == {(0xFEF1, 0x31): 1}
    assert (d.counters.frames, d.counters.wanted) == (3, 3)


def test_two_roles_share_a_message_from_two_addresses():
    d = decoder((*SPEED, 0x00), ("brake_switch", "CCVS1", "BrakeSwitch", 0x31))
    frames = [
        (1, ccvs(0x00), bytes.fromhex("FF341700FF6800CF")),
        (2, ccvs(0x31), bytes.fromhex("F3FFFFD3CCFFFFF0")),
    ]
    result = push(d, frames)
    assert numbers(result, "vehicle_speed") == [0x1734 / 256]
    assert numbers(result, "brake_switch") == [1]


def test_unwanted_frames_leave_no_trace_but_the_count():
    d = decoder((*SPEED, 0x00))
    result = push(d, [(1, EXTENDED | 0x18FEF200, speed(1)), (2, 0x6F1, speed(1)), (3, 0xF1, speed(1))])
    assert (result.samples, result.end_us) == ({}, None)
    assert (d.counters.frames, d.counters.wanted, d.counters.senders) == (3, 0, {})


def test_end_is_the_last_wanted_frame_whoever_sent_it():
    d = decoder((*SPEED, 0x00))
    frames = [(1, ccvs(0x00), speed(1)), (5, ccvs(0x31), b"\0"), (9, EXTENDED | 0x18FEF200, speed(1))]
    assert push(d, frames).end_us == 5


def test_short_long_and_flagged_frames_are_counted_and_ignored():
    d = decoder((*SPEED, 0x00))
    frames = [
        (1, ccvs(0x00), speed(50)[:7]),
        (2, ccvs(0x00), b""),
        (3, ccvs(0x00), speed(50) + b"\0" * 4),
        (4, ccvs(0x00) | REMOTE, b""),
        (5, ccvs(0x00) | ERROR, speed(50)),
        (6, ERROR | 0x4, bytes(8)),
        (7, ccvs(0x00) & ~EXTENDED, speed(50)),
    ]
    result = push(d, frames)
    assert (result.samples, result.end_us) == ({}, 3)
    sender = d.counters.senders[0xFEF1, 0x00]
    assert (sender.frames, sender.wrong_length, sender.remote_frames) == (3, 3, 1)
    assert d.counters.error_frames == 2


def test_not_available_and_error_are_samples_without_a_number():
    d = decoder((*SPEED, 0x00), ("brake_switch", "CCVS1", "BrakeSwitch", 0x00))
    frames = [
        (1, ccvs(0), ABSENT),
        (2, ccvs(0), b"\xff\x12\xfe\xef\xff\xff\xff\xff"),
        (3, ccvs(0), b"\xff\x00\xfb\xdf\xff\xff\xff\xff"),
    ]
    result = push(d, frames)
    assert numbers(result, "vehicle_speed") == [None, None, None]
    assert numbers(result, "brake_switch") == [None, None, 1]
    sender = d.counters.senders[0xFEF1, 0]
    assert (sender.roles["vehicle_speed"].not_available, sender.roles["vehicle_speed"].error_value) == (1, 2)
    assert (sender.roles["brake_switch"].not_available, sender.roles["brake_switch"].error_value) == (1, 1)
    assert (sender.not_available, sender.error_value) == (2, 3)


def test_destination_specific_group_from_any_destination():
    d = decoder(("selected_gear", "TC1", "TransRequestedGear", 5))
    frames = [(k, EXTENDED | 0x0C010005 | k << 8, b"\0\0\x80" + ABSENT[3:]) for k in (3, 9, 255)]
    assert numbers(push(d, frames), "selected_gear") == [3, 3, 3]


def test_gateway_frames_are_distinguished_by_their_parameter():
    d = decoder(
        ("engine_speed", "J1587Gateway", "EngineSpeed", 0xF9, "full"),
        ("gear", "J1587Gateway", "TransRangeAttained", 0xF9, "ascii"),
        ("vehicle_speed", "J1587Gateway", "RoadSpeed", None, "full"),
        database="j1587_gateway",
    )
    gateway = EXTENDED | 0x18FF87F9
    frames = ["80BEFFFF", "82A33620", "82A34420", "805464FF", "80070000", "80F10000", "80BE0000"]
    result = push(d, [(k, gateway, bytes.fromhex(f) + ABSENT[4:]) for k, f in enumerate(frames)])
    assert numbers(result, "engine_speed") == [0xFFFF / 4, 0]  # J1587 has no indicator range
    assert result.samples["engine_speed"][0].tolist() == [0, 6]
    assert numbers(result, "gear") == [6, None]
    assert numbers(result, "vehicle_speed") == [80.5]
    sender = d.counters.senders[0xFF87, 0xF9]
    assert (sender.unknown_mux, sender.frames) == (2, 7)
    assert d.counters.lost() == {"frames of unknown multiplexor": 2}
    assert sender.roles["gear"].error_value == 1


def test_first_address_with_a_number_owns_the_role():
    d = decoder(SPEED)
    frames = [(1, ccvs(7), ABSENT), (2, ccvs(9), speed(30)), (3, ccvs(7), speed(70)), (4, ccvs(9), ABSENT)]
    result = push(d, [*frames, (5, ccvs(7), speed(71)), (6, ccvs(9), speed(31))])
    assert numbers(result, "vehicle_speed") == [None, 30, None, 31]
    assert d.counters.of_role("vehicle_speed")[7].not_owner == 2
    assert d.counters.of_role("vehicle_speed")[7].valid == 2
    assert d.counters.of_role("vehicle_speed")[9].not_owner == 0


def test_owner_is_replaced_after_five_seconds_without_a_number():
    d = decoder(SPEED)
    s = 1_000_000
    frames = [
        (0, ccvs(9), speed(30)),
        (4 * s, ccvs(9), ABSENT),
        (5 * s, ccvs(7), speed(70)),
        (5 * s + 1, ccvs(7), speed(71)),
        (6 * s, ccvs(9), speed(32)),
    ]
    assert numbers(push(d, frames), "vehicle_speed") == [30, None, 71]


def test_owner_that_sends_no_number_any_more_is_replaced_in_a_later_block():
    d = decoder(SPEED)
    s = 1_000_000
    push(d, [(0, ccvs(9), speed(30)), (4 * s, ccvs(9), ABSENT)])
    assert numbers(push(d, [(5 * s + 1, ccvs(7), speed(70))]), "vehicle_speed") == [70]


def test_owner_is_replaced_after_the_clock_was_set_back():
    d = decoder(SPEED)
    assert numbers(push(d, [(10**12, ccvs(9), speed(30)), (0, ccvs(7), speed(70))]), "vehicle_speed") == [
        30,
        70,
    ]


def test_ownership_lasts_over_blocks():
    d = decoder(SPEED)
    push(d, [(1, ccvs(9), speed(30))])
    assert numbers(push(d, [(2, ccvs(7), speed(70))]), "vehicle_speed") == []
    assert numbers(push(d, [(3, ccvs(7), speed(70)), (4, ccvs(9), speed(31))]), "vehicle_speed") == [31]


def test_rate_and_span_of_a_sender():
    d = decoder((*SPEED, 0))
    push(d, [(100_000 * k, ccvs(0), speed(5)) for k in range(11)])
    sender = d.counters.senders[0xFEF1, 0]
    assert (sender.first_us, sender.last_us, sender.rate_Hz) == (0, 1_000_000, 10.0)


HOUR_US = 3_600_000_000


@pytest.mark.parametrize("short_block", [0, 10_000])
@pytest.mark.parametrize("step_us", [-HOUR_US, -2_000_000, 300_000_000, HOUR_US])
def test_the_rate_is_that_of_sending_whatever_the_clock_is_set_to(monkeypatch, short_block, step_us):
    monkeypatch.setattr(decoder_module, "SHORT_BLOCK", short_block)
    for cut in (50, 77, 300):  # a clock that is set back begins a new block
        d = decoder((*SPEED, 0))
        stamps = [2 * HOUR_US + 100_000 * k + (step_us if k >= 50 else 0) for k in range(300)]
        frames = [(t, ccvs(0), speed(5)) for t in stamps]
        for begin, end in ((0, 50), (50, cut), (cut, 300)) if step_us < 0 else ((0, cut), (cut, 300)):
            push(d, frames[begin:end])
        assert d.counters.senders[0xFEF1, 0].rate_Hz == pytest.approx(10.0, rel=0.01)


OWN = """VERSION ""
BU_: X
BO_ 291 Own: 4 X
 SG_ Speed : 7|16@0+ (0.01,0) [0|0] "m/s" X
BO_ 292 Long: 64 X
 SG_ Near : 0|8@1+ (1,0) [0|0] "" X
 SG_ Far : 100|8@1+ (1,0) [0|0] "" X
"""


def test_message_that_is_not_j1939_is_matched_by_its_exact_identifier():
    d = Decoder(
        wants(("vehicle_speed", "Own", "Speed", None, "full")), [cantools.database.load_string(OWN, "dbc")]
    )
    payload = bytes.fromhex("FFFE0000")
    frames = [(1, 291, payload), (2, 291 | EXTENDED, payload), (3, 292, payload), (4, 291, payload + b"\0")]
    result = push(d, [*frames, (5, 291 | REMOTE, b"")])
    assert numbers(result, "vehicle_speed") == [655.34]
    sender = d.counters.senders[291, None]
    assert (sender.frames, sender.wrong_length, sender.remote_frames) == (2, 1, 1)
    assert d.can_filters() == [(291, 0xC0000000 | 0x1FFFFFFF)]


def test_signal_that_no_frame_can_carry_is_refused():
    database = cantools.database.load_string(OWN, "dbc")
    with pytest.raises(ConfigError, match="eighth byte"):
        Decoder(wants(("vehicle_speed", "Long", "Far")), [database])
    Decoder(wants(("vehicle_speed", "Long", "Near")), [database])


def test_long_group_in_a_single_frame_gives_what_is_inside():
    d = decoder(
        ("reference_torque", "EC1", "EngReferenceTorque", 0), ("engine_speed", "EC1", "EngSpeedPoint1", 0)
    )
    result = push(
        d, [(1, EXTENDED | 0x18FEE300, bytes([0x40, 0x1F, 0, 0])), (2, EXTENDED | 0x18FEE300, b"\0" * 40)]
    )
    assert numbers(result, "engine_speed") == [1000]
    assert numbers(result, "reference_torque") == []
    assert d.counters.senders[0xFEE3, 0].wrong_length == 1  # forty bytes are no frame of classic CAN


def test_weights_of_two_controllers_stay_apart():
    """Two controllers send different estimates of one mass; a source says whose is meant."""
    of_brakes = decoder(("reported_mass", "CVW", "GrossCombinationVehicleWeight", 0x0B))
    frames = [(1, EXTENDED | 0x18FE700B, bytes.fromhex("FFFF460FFFFFFFFF"))]
    frames += [(2, EXTENDED | 0x18FE7027, bytes.fromhex("FFFF6F0EFFFFFF0D"))]
    assert numbers(push(of_brakes, frames), "reported_mass") == [39_100]
    assert of_brakes.counters.other_senders == {(0xFE70, 0x27): 1}


def test_columns_of_an_empty_block():
    d = decoder(SPEED)
    result = d.push(FrameBlock.empty())
    assert (result.samples, result.end_us) == ({}, None)


def test_types_of_columns():
    (t_us, values) = push(decoder(SPEED), [(1, ccvs(0), speed(1))]).samples["vehicle_speed"]
    assert (t_us.dtype, values.dtype) == (np.int64, np.float64)


def test_identifiers_beyond_the_size_of_the_cache():
    d = Decoder(wants(("selected_gear", "TC1", "TransRequestedGear", None, "gear")), [shipped_database()])
    frames = [(k, EXTENDED | 0x0C010000 | k, b"\0\0\x80" + ABSENT[3:]) for k in range(6000)]
    d.push(FrameBlock.from_frames(frames))
    assert len(d._routes) <= decoder_module.IDS_KEPT
    assert sum(s.frames for s in d.counters.senders.values()) == 6000
