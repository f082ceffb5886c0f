"""The shipped DBC files load clean, keep their contracts, and place their bits by hand-computed frames."""

from __future__ import annotations

import logging
import warnings

import cantools
import pytest
from decode_helpers import shipped_database

from canest.core.gates import Gate
from canest.core.samples import Status
from canest.decode.j1939 import is_destination_specific, pgn_of
from canest.system.shipped_files import shipped

NAMES = ["j1939", "j1587_gateway", "canest"]


@pytest.mark.parametrize("name", NAMES)
def test_loads_in_cantools_without_a_warning(name, caplog):
    with caplog.at_level(logging.DEBUG), warnings.catch_warnings():
        warnings.simplefilter("error")
        database = cantools.database.load_file(shipped("dbc") / f"{name}.dbc", strict=True)
    assert not caplog.records
    assert database.messages


@pytest.mark.parametrize("name", NAMES)
def test_every_message_is_a_j1939_parameter_group_of_its_own(name):
    messages = shipped_database(name).messages
    assert all(m.is_extended_frame and m.protocol == "j1939" for m in messages)
    assert len({pgn_of(m.frame_id) for m in messages}) == len(messages)
    assert all(m.comment for m in messages)


def test_every_j1939_signal_names_its_spn_and_its_range_ends_below_the_indicators():
    for message in shipped_database().messages:
        for signal in message.signals:
            where = f"{message.name}.{signal.name}"
            assert signal.spn, where
            assert not signal.is_signed, where
            if signal.length in (8, 16, 24, 32) and signal.maximum is not None and signal.unit:
                highest = (0xFB << (signal.length - 8)) - 1
                assert signal.maximum <= highest * signal.scale + signal.offset + 1e-6, where
            if signal.length == 2 and signal.choices:
                assert {2, 3} <= set(signal.choices), where


def test_fields_of_a_message_do_not_overlap():
    """cantools' strict mode refuses overlaps on loading; here with our own bit sets, per branch."""
    for name in NAMES:
        for message in shipped_database(name).messages:
            branches = {i for s in message.signals for i in s.multiplexer_ids or ()} or {None}
            for branch in branches:
                bits: set[int] = set()
                for s in message.signals:
                    if s.multiplexer_ids and branch not in s.multiplexer_ids:
                        continue
                    mine = set(range(s.start, s.start + s.length))
                    assert not bits & mine, f"{message.name}.{s.name}"
                    bits |= mine
                assert max(bits) < 8 * message.length


def test_priorities_addresses_and_cycle_times():
    database = shipped_database()
    eec1, ec1, tc1 = (database.get_message_by_name(n) for n in ("EEC1", "EC1", "TC1"))
    assert eec1.frame_id == 0x0CF004FE
    assert (ec1.frame_id, ec1.length, ec1.cycle_time) == (0x18FEE3FE, 40, 5000)
    assert is_destination_specific(pgn_of(tc1.frame_id))
    assert pgn_of(tc1.frame_id) == 0x0100
    assert database.get_message_by_name("ETC1").cycle_time == 10
    assert shipped_database("canest").messages[0].frame_id == 0x18FF5AFE
    assert shipped_database("j1587_gateway").messages[0].frame_id == 0x18FF87F9


def test_broadcast_has_the_codes_of_gates_and_status():
    message = shipped_database("canest").get_message_by_name("CanestEstimate")
    gates = {int(k): str(v) for k, v in message.get_signal_by_name("EstimateGate").choices.items()}
    assert gates == {int(g): g.label or "open" for g in Gate} | {63: "not available"}
    status = {int(k): str(v) for k, v in message.get_signal_by_name("EstimateStatus").choices.items()}
    assert status == {int(s): s.name.lower() for s in Status} | {3: "not available"}


# message, signal, payload, value: each worked out by hand from byte, bit, scale and offset
HAND = [
    # EEC1: byte 3 = 0x9B = 155 - 125 = 30 %; bytes 4-5 = 0x2FE0 = 12256 / 8 rpm
    ("j1939", "EEC1", "ActualEngPercentTorque", "FF FF 9B E0 2F FF FF FF", 30),
    ("j1939", "EEC1", "EngSpeed", "FF FF 9B E0 2F FF FF FF", 1532.0),
    ("j1939", "EEC1", "ActlEngPrcntTorqueFractional", "31 00 00 00 00 00 00 00", 0.375),
    ("j1939", "EEC1", "EngTorqueMode", "31 00 00 00 00 00 00 00", 1),
    ("j1939", "EEC1", "DriversDemandEngPercentTorque", "00 7D 00 00 00 00 00 00", 0),
    ("j1939", "EEC2", "AccelPedalPos1", "00 64 00 00 00 00 00 00", 40.0),
    ("j1939", "EEC2", "EngPercentLoadAtCurrentSpeed", "00 00 63 00 00 00 00 00", 99),
    ("j1939", "EEC3", "NominalFrictionPercentTorque", "8A A0 28 7D 7D FF FF F5", 13),
    ("j1939", "EEC3", "EngDesiredOperatingSpeed", "8A A0 28 7D 7D FF FF F5", 1300.0),
    # ETC1 bits: 0b01_00_01 = driveline 1, lock-up 0, shift 1
    ("j1939", "ETC1", "TransDrivelineEngaged", "11 00 00 00 00 00 00 00", 1),
    ("j1939", "ETC1", "TransTorqueConverterLockupEngaged", "11 00 00 00 00 00 00 00", 0),
    ("j1939", "ETC1", "TransShiftInProcess", "11 00 00 00 00 00 00 00", 1),
    ("j1939", "ETC1", "Trans1OutputShaftSpeed", "00 40 1F 00 00 00 00 00", 1000.0),
    ("j1939", "ETC1", "PercentClutchSlip", "00 00 00 FA 00 00 00 00", 100.0),
    ("j1939", "ETC1", "Trans1InputShaftSpeed", "00 00 00 00 00 80 25 00", 1200.0),
    ("j1939", "ETC2", "TransSelectedGear", "7C 00 00 00 00 00 00 00", -1),
    ("j1939", "ETC2", "TransActualGearRatio", "00 12 07 00 00 00 00 00", 1.810),
    ("j1939", "ETC2", "TransCurrentGear", "00 00 00 7F 00 00 00 00", 2),
    ("j1939", "ERC1", "ActualRetarderPercentTorque", "00 4B 00 00 00 00 00 00", -50),
    ("j1939", "EBC1", "AntiLockBrakingActive", "10 00 00 00 00 00 00 00", 1),
    ("j1939", "EBC1", "BrakePedalPos", "00 19 00 00 00 00 00 00", 10.0),
    ("j1939", "EBC2", "FrontAxleSpeed", "00 32 00 00 00 00 00 00", 50.0),
    ("j1939", "EBC2", "RelSpeedRearAxle2Right", "00 00 00 00 00 00 00 7D", 0.0),
    ("j1939", "CCVS1", "WheelBasedVehicleSpeed", "FF 34 17 FC FF 68 00 CF", 0x1734 / 256),
    ("j1939", "CCVS1", "BrakeSwitch", "00 00 00 10 00 00 00 00", 1),
    ("j1939", "CCVS1", "ClutchSwitch", "00 00 00 40 00 00 00 00", 1),
    ("j1939", "CCVS1", "ParkingBrakeSwitch", "04 00 00 00 00 00 00 00", 1),
    ("j1939", "CCVS1", "PTOGovernorState", "00 00 00 00 00 00 05 00", 5),
    ("j1939", "CCVS1", "CruiseCtrlStates", "00 00 00 00 00 00 A5 00", 5),
    ("j1939", "TCO1", "TachographVehicleSpeed", "00 00 00 00 00 00 80 50", 80.5),
    ("j1939", "TCO1", "DirectionIndicator", "00 00 00 40 00 00 00 00", 1),
    ("j1939", "VDC2", "SteerWheelAngle", "00 80 00 00 00 00 00 00", 0x8000 / 1024 - 31.374),
    ("j1939", "VDC2", "YawRate", "00 00 00 00 7D 00 00 00", 0x7D00 / 8192 - 3.92),
    ("j1939", "VDC2", "LateralAcceleration", "00 00 00 00 00 00 80 00", 0x8000 / 2048 - 15.687),
    ("j1939", "VDC2", "LongitudinalAcceleration", "00 00 00 00 00 00 00 87", 1.0),
    ("j1939", "VDC2", "SteerWheelTurnCounter", "00 00 21 00 00 00 00 00", 1),
    ("j1939", "VDS", "Altitude", "00 00 00 00 00 00 20 5D", 0x5D20 / 8 - 2500),
    ("j1939", "VDS", "Pitch", "00 00 00 00 80 64 00 00", 1.0),
    ("j1939", "SSI", "PitchAngle", "E8 80 00 00 00 00 00 00", 2.0),
    ("j1939", "SSI2", "PitchAngleExtRange", "00 00 7E 00 00 00 00 00", 0x7E0000 / 32768 - 250),
    ("j1939", "PCC1", "RoadwayPresentGrade", "00 00 00 98 00 00 00 00", 3.0),
    ("j1939", "AMB", "BarometricPressure", "C8 00 00 00 00 00 00 00", 100.0),
    ("j1939", "AMB", "AmbientAirTemp", "00 00 00 A0 24 00 00 00", 20.0),
    ("j1939", "CVW", "GrossCombinationVehicleWeight", "FF FF 46 0F FF FF FF FF", 39100),
    ("j1939", "GCVW", "GrossCombinationWeight", "10 27 00 00 00 00 00 00", 20000),
    ("j1939", "FD", "EstPercentFanSpeed", "7D 00 00 00 00 00 00 00", 50.0),
    ("j1939", "LFE1", "EngFuelRate", "70 05 00 00 00 00 00 00", 69.6),
    ("j1939", "VP1", "Latitude", "00 E9 A4 35 00 00 00 00", -120.0),
    ("j1939", "VDHR", "TotalVehicleDistanceHiRes", "01 00 00 00 00 00 00 00", 5),
    ("j1587_gateway", "J1587Gateway", "EngineSpeed", "80 BE C0 12 FF FF FF FF", 1200.0),
    ("j1587_gateway", "J1587Gateway", "RoadSpeed", "80 54 64 FF FF FF FF FF", 80.5),
    ("j1587_gateway", "J1587Gateway", "ServiceBrakeSwitch", "80 41 01 FF FF FF FF FF", 1),
    ("j1587_gateway", "J1587Gateway", "ParkingBrakeSwitch", "80 46 80 FF FF FF FF FF", 1),
    ("j1587_gateway", "J1587Gateway", "OutputTorque", "80 5D F6 FF FF FF FF FF", -271.0),
    ("j1587_gateway", "J1587Gateway", "EngineRetarderPercent", "80 7A C8 FF FF FF FF FF", 100.0),
    ("j1587_gateway", "J1587Gateway", "AmbientAirTemperature", "80 AB F0 FF FF FF FF FF", -4.0),
    ("j1587_gateway", "J1587Gateway", "TransRangeAttained", "82 A3 36 20 FF FF FF FF", 0x2036),
    ("canest", "CanestEstimate", "EstimatedMass", "9A 29 00 00 00 00 00 00", 21300),
    ("canest", "CanestEstimate", "EstimatedMassStd", "00 00 05 00 00 00 00 00", 2.0),
    ("canest", "CanestEstimate", "EstimatedGrade", "00 00 00 2C 7E 00 00 00", 3.0),
    ("canest", "CanestEstimate", "EstimatedGradeStd", "00 00 00 00 00 19 00 00", 1.0),
    ("canest", "CanestEstimate", "EstimateStatus", "00 00 00 00 00 00 1A 00", 2),
    ("canest", "CanestEstimate", "EstimateGate", "00 00 00 00 00 00 1A 00", 6),
    ("canest", "CanestEstimate", "MessageCounter", "00 00 00 00 00 00 00 A7", 7),
    ("canest", "CanestEstimate", "MessageChecksum", "00 00 00 00 00 00 00 A7", 10),
]


@pytest.mark.parametrize(("database", "message", "signal", "payload", "value"), HAND)
def test_hand_computed_frame(database, message, signal, payload, value):
    found = shipped_database(database).get_message_by_name(message)
    decoded = found.decode(bytes.fromhex(payload), decode_choices=False)
    assert decoded[signal] == pytest.approx(value, abs=1e-9)


def test_reference_torque_is_bytes_20_and_21_of_the_engine_configuration():
    payload = bytearray(40)
    payload[19:21] = (2450).to_bytes(2, "little")
    assert shipped_database().get_message_by_name("EC1").decode(bytes(payload))["EngReferenceTorque"] == 2450
