"""Our own packing of CanestEstimate against cantools and the shipped DBC."""

from __future__ import annotations

import math

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core.gates import Gate
from canest.decode import j1939
from canest.node.estimate_frame import Estimate, checksum, decode, encode
from canest.system.shipped_files import shipped

CAN_ID = j1939.pack(0xFF5A, 0x9E)
NAN = math.nan


@pytest.fixture(scope="module")
def message():
    return cantools.database.load_file(shipped("dbc") / "canest.dbc").get_message_by_name("CanestEstimate")


estimates = st.builds(
    Estimate,
    mass_kg=st.floats(10, 128_510),
    mass_std_kg=st.floats(0, 20_000),
    grade=st.floats(-3.2, 3.2),
    grade_std=st.floats(0, 0.2),
    status=st.integers(0, 3),
    gate=st.sampled_from([*map(int, Gate), 63]),
)


@given(estimates, st.integers(0, 15), st.integers(0x80, 0xF7))
@settings(max_examples=300, deadline=None)
def test_packing_equals_cantools_encoding(message, estimate, counter, source):
    can_id = j1939.pack(0xFF5A, source)
    ours = encode(estimate, counter, can_id)
    word = int.from_bytes(ours, "little")
    theirs = message.encode(
        {
            "EstimatedMass": estimate.mass_kg,
            "EstimatedMassStd": min(100 * estimate.mass_std_kg / estimate.mass_kg, 100),
            "EstimatedGrade": 100 * estimate.grade,
            "EstimatedGradeStd": min(100 * estimate.grade_std, 10),
            "EstimateStatus": estimate.status,
            "EstimateGate": estimate.gate,
            "MessageCounter": counter,
            "MessageChecksum": checksum(word, can_id),
        },
        strict=False,
    )
    # floats that lie within rounding error of half a step may round either way
    for name, value in message.decode(ours, decode_choices=False).items():
        step = message.get_signal_by_name(name).scale
        assert abs(value - message.decode(theirs, decode_choices=False)[name]) <= step * 1.001, name
    exact = [(0, 16, estimate.mass_kg / 2), (24, 16, (estimate.grade + 3.2) / 0.0001)]
    for start, length, steps in exact:
        if abs(steps % 1 - 0.5) > 1e-6:
            assert word >> start & (1 << length) - 1 == round(steps)


@given(estimates, st.integers(0, 15))
@settings(max_examples=200, deadline=None)
def test_what_is_encoded_is_decoded_within_half_a_step(estimate, counter):
    received = decode(encode(estimate, counter, CAN_ID), CAN_ID)
    assert received is not None and received.intact and received.counter == counter
    assert abs(received.estimate.mass_kg - estimate.mass_kg) <= 1 + 1e-9
    assert abs(received.estimate.grade - estimate.grade) <= 0.00005 + 1e-9
    assert (received.estimate.status, received.estimate.gate) == (estimate.status, estimate.gate)


def test_no_number_is_sent_as_j1939_not_available(message):
    payload = encode(Estimate(), 5, CAN_ID)
    raw = message.decode(payload, scaling=False, decode_choices=False)
    assert raw["EstimatedMass"] == raw["EstimatedGrade"] == 0xFFFF
    assert raw["EstimatedMassStd"] == raw["EstimatedGradeStd"] == 0xFF
    assert message.decode(payload)["EstimateStatus"] == "not available"
    assert message.decode(payload)["EstimateGate"] == "not available"
    assert raw["MessageCounter"] == 5


@pytest.mark.parametrize("mass_kg", [NAN, -5.0, 128_600.0, math.inf, -math.inf])
def test_a_mass_that_does_not_fit_is_not_available_rather_than_wrapped(message, mass_kg):
    payload = encode(Estimate(mass_kg, 100.0, 0.01, 0.001, 2, 0), 0, CAN_ID)
    raw = message.decode(payload, scaling=False, decode_choices=False)
    assert (raw["EstimatedMass"], raw["EstimatedMassStd"]) == (0xFFFF, 0xFF)
    assert raw["EstimatedGrade"] == 32100


@pytest.mark.parametrize("std", [NAN, math.inf])
def test_a_standard_deviation_without_a_number_never_looks_precise(message, std):
    raw = message.decode(
        encode(Estimate(10_000.0, std, 0.0, std, 1, 0), 0, CAN_ID), scaling=False, decode_choices=False
    )
    assert raw["EstimatedMassStd"] in (250, 255)
    assert raw["EstimatedGradeStd"] in (250, 255)


def test_checksum_is_the_documented_sum_of_nibbles():
    payload = encode(Estimate(20_000.0, 200.0, 0.02, 0.002, 2, 0), 7, CAN_ID)
    nibbles = [n for byte in payload for n in (byte & 15, byte >> 4)]
    identifier = [int(c, 16) for c in f"{CAN_ID & 0x1FFFFFFF:08X}"]
    assert nibbles[15] == (sum(nibbles[:15]) + sum(identifier)) % 16


@given(st.integers(0, 63))
def test_any_flipped_bit_is_noticed(bit):
    payload = encode(Estimate(20_000.0, 200.0, 0.02, 0.002, 2, 0), 7, CAN_ID)
    damaged = (int.from_bytes(payload, "little") ^ 1 << bit).to_bytes(8, "little")
    assert not decode(damaged, CAN_ID).intact


def test_a_frame_from_another_address_does_not_pass_as_ours():
    payload = encode(Estimate(20_000.0, 200.0, 0.02, 0.002, 2, 0), 7, CAN_ID)
    assert not decode(payload, j1939.pack(0xFF5A, 0x9F)).intact


@given(st.binary(max_size=12))
def test_any_payload_decodes_without_an_exception(payload):
    received = decode(payload, CAN_ID)
    assert (received is None) == (len(payload) != 8)


def test_a_mass_that_no_frame_holds_is_not_valid():
    heavy = Estimate(300e3, 3e3, 0.03, 0.001, 2, 0)
    received = decode(encode(heavy, 0, 0x18FF5A9E), 0x18FF5A9E).estimate
    assert math.isnan(received.mass_kg) and received.status == 1 and received.grade == pytest.approx(0.03)
