"""The bundled real logs: every sample equals cantools where it is a number, and the known facts hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from decode_helpers import block_of_log, decoder, frames_of_log, shipped_database

from canest.decode.j1939 import pgn_of, source_of

KENWORTH = [
    ("engine_torque_pct", "EEC1", "ActualEngPercentTorque", 0x00),
    ("engine_speed", "EEC1", "EngSpeed", 0x00),
    ("engine_friction_pct", "EEC3", "NominalFrictionPercentTorque", 0x00),
    ("accelerator", "EEC2", "AccelPedalPos1", 0x00),
    ("output_shaft_speed", "ETC1", "Trans1OutputShaftSpeed", 0x03),
    ("shift_in_process", "ETC1", "TransShiftInProcess", 0x03),
    ("gear_ratio", "ETC2", "TransActualGearRatio", 0x03),
    ("gear", "ETC2", "TransCurrentGear", 0x03),
    ("vehicle_speed", "CCVS1", "WheelBasedVehicleSpeed", 0x00),
    ("brake_switch", "CCVS1", "BrakeSwitch", 0x31),
    ("undriven_speed", "EBC2", "FrontAxleSpeed", 0x0B),
    ("retarder_torque_pct", "ERC1", "ActualRetarderPercentTorque", 0x29),
    ("ambient_temperature", "AMB", "AmbientAirTemp", 0x00),
    ("barometric_pressure", "AMB", "BarometricPressure", 0x00),
]
BIKE = [
    ("engine_torque_pct", "EEC1", "ActualEngPercentTorque", 0x00),
    ("engine_speed", "EEC1", "EngSpeed", 0x00),
    ("vehicle_speed", "CCVS1", "WheelBasedVehicleSpeed", 0x0B),
    ("undriven_speed", "EBC2", "FrontAxleSpeed", None),
    ("gear_ratio", "ETC2", "TransActualGearRatio", 0x27),
    ("altitude", "VDS", "Altitude", None),
]


def cantools_samples(log: str, message: str, signal: str, source: int | None):
    """Stamps and numbers by cantools' own decoding, all frames of one address."""
    definition = shipped_database().get_message_by_name(message)
    pgn = pgn_of(definition.frame_id)
    samples = []
    for t_us, can_id, payload in frames_of_log(log):
        if pgn_of(can_id) == pgn and (source is None or source_of(can_id) == source):
            samples.append((t_us, float(definition.decode(payload, decode_choices=False)[signal])))
    return samples


@pytest.mark.parametrize(
    ("log", "entries"),
    [
        ("kenworth/normal.log.xz", KENWORTH),
        ("kenworth/tsc1.log.xz", KENWORTH),
        ("kenworth/address_claim.log.xz", KENWORTH),
        ("ip332/bike.log.xz", BIKE),
    ],
)
def test_every_sample_equals_cantools_where_it_is_a_number(log, entries):
    samples = decoder(*entries).push(block_of_log(log)).samples
    compared = 0
    for role, message, signal, source in entries:
        expected = cantools_samples(log, message, signal, source)
        if not expected:
            assert role not in samples
            continue
        t_us, values = samples[role]
        assert t_us.tolist() == [t for t, _ in expected], role
        definition = shipped_database().get_message_by_name(message).get_signal_by_name(signal)
        for value, (_, reference) in zip(values.tolist(), expected, strict=True):
            if not math.isnan(value):
                assert value == reference, role
                compared += 1
            else:  # what is refused is beyond the range that the DBC declares, or a state above 1
                assert reference > (1 if definition.length == 2 else definition.maximum), role
    assert compared > 5000


def test_kenworth_drive():
    d = decoder(*KENWORTH, ("reference_torque", "EC1", "EngReferenceTorque", 0x00))
    samples = d.push(block_of_log("kenworth/normal.log.xz")).samples
    assert set(samples["reference_torque"][1]) == {1109.0}
    assert d.counters.transport["complete"] == len(samples["reference_torque"][1]) == 6
    v_kmh = samples["vehicle_speed"][1]
    assert 22 < v_kmh.min() < v_kmh.max() < 56
    assert set(samples["gear"][1]) == {2, 3, 4}
    # speed over shaft speed is one constant: wheel radius over final drive
    shaft = np.interp(samples["vehicle_speed"][0], *samples["output_shaft_speed"]) * math.pi / 30
    assert np.median(v_kmh / 3.6 / shaft) == pytest.approx(0.0954, rel=0.01)
    assert d.counters.frames == 19_957


def test_kenworth_gear_letters_agree_with_the_gear_number():
    entries = (
        ("gear", "ETC2", "TransCurrentGear", 3),
        ("selected_gear", "ETC2", "TransCurrentRange", 3, "ascii"),
    )
    samples = decoder(*entries).push(block_of_log("kenworth/normal.log.xz")).samples
    assert np.array_equal(samples["gear"][1], samples["selected_gear"][1])


def test_bike_log_has_speed_from_one_of_four_addresses_and_no_torque():
    d = decoder(("vehicle_speed", "CCVS1", "WheelBasedVehicleSpeed"), *BIKE[:2])
    samples = d.push(block_of_log("ip332/bike.log.xz")).samples
    assert np.isnan(samples["engine_torque_pct"][1]).all()
    assert {sa for pgn, sa in d.counters.senders if pgn == 0xFEF1} == {0x00, 0x0B, 0x86, 0x87}
    by_address = d.counters.of_role("vehicle_speed")
    assert [sa for sa, c in by_address.items() if c.valid] == [0x0B]
    speed = samples["vehicle_speed"][1]
    numbers = speed[~np.isnan(speed)]
    assert len(numbers) == by_address[0x0B].valid
    assert 80 < numbers.max() < 85
