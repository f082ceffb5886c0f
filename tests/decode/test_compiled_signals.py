"""Compiled signals equal cantools on random payloads: every shipped signal, and every odd form of field."""

from __future__ import annotations

import random

import cantools
import numpy as np
import pytest
from decode_helpers import shipped_database

from canest.core.errors import ConfigError
from canest.decode.compile import CompiledSignal, known_selectors
from canest.decode.validity import RULES, first_not_available, gear_of_text, highest_valid

EVERY_SIGNAL = [
    (name, message.name, signal.name)
    for name in ("j1939", "j1587_gateway", "canest")
    for message in shipped_database(name).messages
    for signal in message.signals
]


def payloads(length: int, count: int, seed: int) -> list[bytes]:
    rng = random.Random(seed)
    return [bytes(length), b"\xff" * length, *(rng.randbytes(length) for _ in range(count))]


def select(message, signal, payload: bytes, rng: random.Random) -> bytes:
    """Set the multiplexor so that the payload carries the signal."""
    if not signal.multiplexer_ids:
        return payload
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    assert selector.length == 8
    assert selector.start % 8 == 0
    at = selector.start // 8
    return payload[:at] + bytes([rng.choice(sorted(signal.multiplexer_ids))]) + payload[at + 1 :]


@pytest.mark.parametrize(("database", "message", "signal"), EVERY_SIGNAL)
def test_equals_cantools_on_random_payloads(database, message, signal):
    message = shipped_database(database).get_message_by_name(message)
    signal = message.get_signal_by_name(signal)
    rng = random.Random(7)
    size = max(8, message.length)
    compiled = CompiledSignal(message, signal, validity="full", size=size)
    raws = [select(message, signal, p, rng) for p in payloads(message.length, 40, seed=len(signal.name))]
    multiplexors = [s.name for s in message.signals if s.is_multiplexer and s.name != signal.name]
    if multiplexors and not signal.multiplexer_ids:  # a plain signal beside multiplexed ones
        branch = next(s for s in message.signals if s.multiplexer_ids)
        raws = [select(message, branch, p, rng) for p in raws]
    if signal.is_multiplexer:
        known = sorted(known_selectors(message)[1])
        raws = [p[:1] + bytes([rng.choice(known)]) + p[2:] for p in raws]
    expected = [message.decode(p, decode_choices=False)[signal.name] for p in raws]
    words = [int.from_bytes(p, "little") for p in raws]
    assert [compiled.one(w) for w in words] == expected
    if message.length <= 8:
        rows, values, bad, _ = compiled.columns(np.array(words, np.uint64))
        assert rows is None or np.array_equal(rows, np.arange(len(words)))
        assert bad is None
        assert values.tolist() == expected


ODD = """VERSION ""
BU_: X
BO_ 256 Odd: 8 X
 SG_ Whole : 0|64@1+ (1,0) [0|0] "" X
BO_ 257 OddSigned: 8 X
 SG_ Whole : 0|64@1- (1,0) [0|0] "" X
BO_ 258 Motorola: 8 X
 SG_ Twelve : 3|12@0+ (0.5,-10) [0|0] "" X
 SG_ Nine : 23|9@0- (1,0) [0|0] "" X
 SG_ Thirty : 37|30@0- (0.001,1) [0|0] "" X
BO_ 259 MotorolaWhole: 8 X
 SG_ Whole : 7|64@0- (1,0) [0|0] "" X
BO_ 260 Intel: 8 X
 SG_ One : 0|1@1+ (1,0) [0|0] "" X
 SG_ Three : 1|3@1- (2,1) [0|0] "" X
 SG_ Eleven : 5|11@1- (0.1,0) [0|0] "" X
 SG_ Forty : 17|40@1+ (0.25,-3) [0|0] "" X
BO_ 261 Floats: 8 X
 SG_ Single : 0|32@1- (2,1) [0|0] "" X
BO_ 262 FloatsMotorola: 8 X
 SG_ Double : 7|64@0- (1,0) [0|0] "" X
BO_ 263 Muxed: 8 X
 SG_ Which M : 4|4@1+ (1,0) [0|0] "" X
 SG_ A m1 : 8|8@1- (1,0) [0|0] "" X
 SG_ B m2 : 15|16@0+ (1,0) [0|0] "" X
BO_ 264 Long: 20 X
 SG_ Far : 100|17@1+ (1,0) [0|0] "" X
 SG_ FarMotorola : 71|20@0- (1,0) [0|0] "" X
SIG_VALTYPE_ 261 Single : 1;
SIG_VALTYPE_ 262 Double : 2;
"""
ODD_DATABASE = cantools.database.load_string(ODD, "dbc")
ODD_SIGNALS = [(m.name, s.name) for m in ODD_DATABASE.messages for s in m.signals]


@pytest.mark.parametrize(("message", "signal"), ODD_SIGNALS)
def test_motorola_signed_float_and_wide_signals_equal_cantools(message, signal):
    message = ODD_DATABASE.get_message_by_name(message)
    signal = message.get_signal_by_name(signal)
    compiled = CompiledSignal(message, signal, validity="full", size=message.length)
    raws = payloads(message.length, 200, seed=3)
    if message.name == "Muxed":
        raws = [
            bytes([p[0] & 0x0F | random.Random(i).choice([0x10, 0x20])]) + p[1:] for i, p in enumerate(raws)
        ]
    expected = []
    for payload in raws:
        value = message.decode(payload).get(signal.name)
        finite = value is not None and abs(value) < float("inf")
        expected.append(None if value is None else float(value) if finite else float("nan"))
    one = [compiled.one(int.from_bytes(p, "little")) for p in raws]
    np.testing.assert_array_equal(np.array(one, np.float64), np.array(expected, np.float64))
    if message.length == 8:
        rows, values, _, _ = compiled.columns(
            np.array([int.from_bytes(p, "little") for p in raws], np.uint64)
        )
        kept = [v for v in expected if v is not None]
        np.testing.assert_array_equal(values, np.array(kept, np.float64))
        if rows is not None:
            assert rows.tolist() == [i for i, v in enumerate(expected) if v is not None]
            assert 0 < len(rows) < len(raws)


def compiled(message: str, signal: str, validity: str = "j1939", **more) -> CompiledSignal:
    found = shipped_database().get_message_by_name(message)
    return CompiledSignal(found, found.get_signal_by_name(signal), validity=validity, **more)


@pytest.mark.parametrize(
    ("message", "signal", "validity", "highest", "first_absent"),
    [
        ("EEC1", "ActualEngPercentTorque", "j1939", 0xFA, 0xFF),
        ("EEC1", "EngSpeed", "j1939", 0xFAFF, 0xFF00),
        ("SSI2", "PitchAngleExtRange", "j1939", 0xFAFFFF, 0xFF0000),
        ("VP1", "Latitude", "j1939", 0xFAFFFFFF, 0xFF000000),
        ("CCVS1", "BrakeSwitch", "j1939", 1, 3),
        ("EBC5", "HaltBrakeMode", "j1939", 5, 7),
        ("EEC1", "EngTorqueMode", "j1939", 13, 15),
        ("EEC1", "ActlEngPrcntTorqueFractional", "j1939", 7, 15),
        ("CCVS1", "PTOGovernorState", "j1939", 29, 31),
        ("CCVS1", "CruiseCtrlStates", "j1939", 6, 7),
        ("VDC2", "SteerWheelTurnCounter", "j1939", 61, 63),
        ("EEC1", "SrcAddrCtrlDeviceEngCtrl", "source_address", 253, 255),
        ("ETC2", "TransCurrentGear", "j1939", 250, 255),
        ("ETC2", "TransCurrentGear", "gear", 251, 255),
        ("EEC1", "EngSpeed", "full", 0xFFFF, None),
    ],
)
def test_values_end_and_indicators_begin_where_the_standard_has_it(
    message, signal, validity, highest, first_absent
):
    c = compiled(message, signal, validity)
    for raw in {0, 1, highest - 1, highest, min(highest + 1, c.field.mask), c.field.mask}:
        word = raw << c.field.shift
        value = c.one(word)
        _, (column,), bad, _ = c.columns(np.array([word], np.uint64))
        assert (not np.isnan(value)) == (raw <= highest), raw
        assert (not np.isnan(column)) == (raw <= highest), raw
        assert (bad is None) == (raw <= highest), raw
    if first_absent is not None:
        assert c.first_not_available == first_absent


def test_low_byte_of_an_indicator_may_be_anything():
    c = compiled("EEC1", "EngSpeed")
    assert all(np.isnan(c.one((0xFE00 | low) << 24)) for low in range(256))
    assert c.one(0xFAFF << 24) == 8031.875


def test_park_is_a_gear_only_under_the_gear_rule():
    assert compiled("ETC2", "TransCurrentGear", "gear").one(251 << 24) == 126
    assert np.isnan(compiled("ETC2", "TransCurrentGear").one(251 << 24))
    assert np.isnan(compiled("ETC2", "TransCurrentGear", "gear").one(252 << 24))


@pytest.mark.parametrize(
    ("text", "gear"),
    [
        (b"3 ", 3), (b" 3", 3), (b"03", 3), (b"D3", 3), (b"10", 10), (b"3\0", 3), (b"2C", 2), (b"4L", 4),
        (b"N ", 0), (b" N", 0), (b"R ", -1), (b"R1", -1), (b"R2", -2), (b"P ", 126),
        (b"D ", None), (b"  ", None), (b"\xff\xff", None), (b"3D", None), (b"-1", None), (b"\xc2\xb2", None),
    ],
)  # fmt: skip
def test_gear_in_characters(text, gear):
    expected = float("nan") if gear is None else gear
    np.testing.assert_equal(gear_of_text(text), expected)
    c = compiled("ETC2", "TransCurrentRange", "ascii")
    word = int.from_bytes(b"\0" * 6 + text, "little")
    np.testing.assert_equal(c.one(word), expected)
    np.testing.assert_equal(c.columns(np.array([word, word], np.uint64))[1], [expected, expected])


def test_conversion_to_the_unit_of_the_role():
    c = compiled("CCVS1", "WheelBasedVehicleSpeed", factor=1 / 3.6)
    assert c.one(0x2400 << 8) == pytest.approx(10.0)
    f = CompiledSignal(
        shipped_database("j1587_gateway").messages[0],
        shipped_database("j1587_gateway").messages[0].get_signal_by_name("AmbientAirTemperature"),
        validity="full",
        factor=5 / 9,
        offset=-160 / 9,
    )
    assert f.one(int.from_bytes(bytes.fromhex("80AB5001"), "little")) == pytest.approx((84 - 32) * 5 / 9)


def test_unknown_rule_and_impossible_signals_are_refused():
    with pytest.raises(ConfigError, match=r"unknown validity rule.*j1938.*j1939"):
        compiled("EEC1", "EngSpeed", "j1938")
    with pytest.raises(ConfigError, match="ascii"):
        compiled("CCVS1", "BrakeSwitch", "ascii")
    assert set(RULES) == {"j1939", "full", "source_address", "gear", "ascii"}


def test_single_bits_have_no_indicator_and_narrow_fields_two():
    assert highest_valid(1, "j1939") == 1
    assert highest_valid(12, "j1939") == 0xFAF
    assert first_not_available(4) == 15
