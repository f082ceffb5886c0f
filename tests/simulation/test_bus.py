"""What is on the bus: decodes to the truth, reads with python-can, lost and late frames as configured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from canest.core.frames import FrameBlock
from canest.simulation import SimulatedDrive, simulate
from canest.system.shipped_files import find

from .conftest import steady

START_US = 1_700_000_000_000_000


def decoded(drive: SimulatedDrive, dbc: str, can_id: int, signal: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times and cantools' values of one signal of one identifier; NaN where it is text."""
    database: Any = cantools.database.load_file(find("dbc", dbc), strict=False)
    extended = can_id > 0x7FF
    pgn = can_id >> 8 & (0x3FFFF if (can_id >> 16 & 0xFF) >= 240 else 0x3FF00)
    message = next(
        m
        for m in database.messages
        if (m.frame_id >> 8 & 0x3FFFF == pgn and m.is_extended_frame if extended else m.frame_id == can_id)
    )
    frames = drive.frames[(drive.frames.can_id & 0x1FFFFFFF) == can_id]
    values = [
        message.decode(int(data).to_bytes(8, "little"), decode_choices=False)[signal] for data in frames.data
    ]
    return (frames.t_us - START_US) / 1e6, np.array(values, float)


@pytest.mark.parametrize(
    ("can_id", "signal", "column", "factor", "tolerance"),
    [
        (0x0CF00400, "EngSpeed", "engine_radps", 60 / 2 / np.pi, 3.0),
        (0x0CF00400, "ActualEngPercentTorque", "indicated_Nm", 100 / 2100, 1.6),
        (0x0CF00203, "Trans1OutputShaftSpeed", "wheel_radps", 3.73 * 60 / 2 / np.pi, 0.3),
        (0x18FEF100, "WheelBasedVehicleSpeed", "speed_mps", 3.6, 0.1),
        (0x18FEBF0B, "FrontAxleSpeed", "speed_mps", 3.6, 0.02),
        (
            0x18F0090B,
            "LongitudinalAcceleration",
            "accel_mps2",
            1.098,
            0.12,
        ),  # with pitch of 0.01 rad per m/s2
        (0x18FEE81C, "Altitude", "elevation_m", 1.0, 0.2),
    ],
)
def test_frames_decode_to_the_truth_within_resolution(
    can_id: int, signal: str, column: str, factor: float, tolerance: float
):
    drive = steady(throttle=0.7, duration_s=5.0)
    t, values = decoded(drive, "j1939.dbc", can_id, signal)
    later = t > 1.5
    truth = np.interp(t, drive.history["t_s"], drive.history[column]) * factor
    assert later.sum() >= 3
    assert values[later] == pytest.approx(truth[later], abs=tolerance)


def test_gear_and_shift_decode_to_the_truth(pulses: SimulatedDrive):
    t, gear = decoded(pulses, "j1939.dbc", 0x18F00503, "TransCurrentGear")
    index = np.searchsorted(pulses.history["t_s"], t) - 2
    same = pulses.history["gear"][np.maximum(index, 0)] + 1 == gear
    assert same.mean() > 0.98  # a gear may change between the due time and the stamp
    t, shifting = decoded(pulses, "j1939.dbc", 0x0CF00203, "TransShiftInProcess")
    at = np.round(t * 10).astype(int)
    inside = at < len(pulses.truth["shift"])
    assert np.mean(shifting[inside] == pulses.truth["shift"][at[inside]]) > 0.95


def test_indicated_less_friction_is_the_net_torque_at_the_crank():
    drive = steady(throttle=0.7, duration_s=5.0)
    _, indicated = decoded(drive, "j1939.dbc", 0x0CF00400, "ActualEngPercentTorque")
    _, friction = decoded(drive, "j1939.dbc", 0x18FEDF00, "NominalFrictionPercentTorque")
    net_Nm = (indicated[-1] - friction[-1]) / 100 * 2100
    assert net_Nm == pytest.approx(drive.history["crank_Nm"][-20:].mean(), abs=21)  # two roundings of 0.5 %


def test_reference_torque_comes_in_a_broadcast_of_39_bytes(pulses: SimulatedDrive):
    frames = pulses.frames
    announce = frames.data[(frames.can_id & 0x1FFFFFFF) == 0x18ECFF00]
    packets = frames.data[(frames.can_id & 0x1FFFFFFF) == 0x18EBFF00]
    assert int(announce[0]).to_bytes(8, "little") == bytes.fromhex("20270006FFE3FE00")
    by_number = {int(p) & 0xFF: int(p).to_bytes(8, "little")[1:] for p in packets}
    body = b"".join(by_number[k] for k in range(1, 7))[:39]
    assert int.from_bytes(body[19:21], "little") == 2100


def test_rates_losses_and_traffic_are_those_of_a_busy_truck(pulses: SimulatedDrive):
    frames = pulses.frames
    assert 900 < len(frames) / 300 < 1100
    assert np.all(np.diff(frames.t_us) >= 0)
    etc1 = frames.t_us[(frames.can_id & 0x1FFFFFFF) == 0x0CF00203]
    assert np.median(np.diff(etc1)) == pytest.approx(10_000, abs=100)
    assert 1 - len(etc1) / 30_000 == pytest.approx(0.002, abs=0.001)
    sources = frames.can_id & np.uint32(0xFF)
    cab = frames.data[sources == 0x31]
    assert len(np.unique(cab)) > 0.99 * len(cab)
    assert 0.4 < np.mean(np.isin(sources, [0x27, 0xEE, 0x31])) < 0.75


def test_log_is_read_by_python_can(pulses: SimulatedDrive, tmp_path: Path):
    short = SimulatedDrive("short", pulses.frames[:2000], pulses.truth, pulses.config, [], {})
    log, truth, config = short.write(tmp_path)
    read = FrameBlock.from_frames(
        [
            (
                round(m.timestamp * 1e6),
                m.arbitration_id | (0x80000000 if m.is_extended_id else 0),
                bytes(m.data),
            )
            for m in can.LogReader(log)
        ]
    )
    assert np.array_equal(read.data, short.frames.data)
    assert np.array_equal(read.can_id, short.frames.can_id)
    assert np.abs(read.t_us - short.frames.t_us).max() <= 1
    assert truth.read_text().startswith(
        "t_s,distance_m,speed_mps,accel_mps2,grade,mass_kg,elevation_m,shift,brake\n"
    )
    lines = [line for line in config.read_text().splitlines() if not line.startswith("#")]
    assert lines[0] == "vehicle:"


def test_same_seed_gives_the_same_bits_and_another_seed_does_not():
    scenario = {
        "duration_s": 10,
        "vehicle": "class8",
        "mass_kg": 20000,
        "driver": {"kind": "mixed"},
        "small_errors": True,
    }
    first, again, other = simulate(scenario, 3), simulate(scenario, 3), simulate(scenario, 4)
    assert np.array_equal(first.frames.t_us, again.frames.t_us)
    assert np.array_equal(first.frames.data, again.frames.data)
    assert not np.array_equal(first.frames.data[: len(other.frames)], other.frames.data[: len(first.frames)])


def test_at_rest_on_a_slope_the_accelerometer_shows_gravity():
    drive = simulate(
        {
            "duration_s": 5,
            "vehicle": "class8",
            "mass_kg": 20000,
            "road": {"kind": "flat", "grade": 0.05},
            "driver": {"kind": "given", "at_s": [0], "speed_mps": [0]},
            "sensors": {"accelerometer_bias_mps2": 0.0},
        }
    )
    _, accel = decoded(drive, "j1939.dbc", 0x18F0090B, "LongitudinalAcceleration")
    assert accel.mean() == pytest.approx(9.80665 * np.sin(np.arctan(0.05)), abs=0.02)


def test_gateway_sends_gear_and_speed_only_as_j1587(pulses: SimulatedDrive):
    drive = simulate(
        {
            "duration_s": 20,
            "vehicle": "class8",
            "mass_kg": 21250,
            "driver": {"kind": "pulses", "start_mps": 15},
            "bus": {"j1587_gateway": True},
        }
    )
    ids = set((drive.frames.can_id & 0x1FFFFFFF).tolist())
    assert 0x18FF87F9 in ids
    assert not ids & {0x18FEF100, 0x18F00503, 0x18F0010B, 0x18FEBF0B}
    payloads = [int(d).to_bytes(8, "little") for d in drive.frames.data[drive.frames.can_id == 0x98FF87F9]]
    speeds = [p[2] * 0.805 / 3.6 for p in payloads if p[:2] == bytes([130, 84])]
    assert speeds[-1] == pytest.approx(drive.truth["speed_mps"][-1], abs=0.4)
    gears = {p[2:4] for p in payloads if p[:2] == bytes([130, 163])}
    assert gears and gears <= {f"{k:<2d}".encode() for k in range(1, 11)} | {b"N "}
    engine = [int.from_bytes(p[2:4], "little") * 0.25 for p in payloads if p[:2] == bytes([128, 190])]
    assert 500 < engine[-1] < 2300
    eec1 = drive.frames.data[drive.frames.can_id == 0x8CF00400]
    assert np.all((eec1 >> np.uint64(24)) & np.uint64(0xFFFF) == 0xFFFF)


def test_car_reports_half_shaft_torques_and_accelerometer():
    drive = simulate("hill-11.8-percent")
    for can_id, signal, column, factor, tolerance in [
        (0x140, "HalfShaftTorqueLeft", "wheel_torque_Nm", 0.5, 25.0),
        (0x130, "RearAxleSpeed", "speed_mps", 3.6, 0.12),
        (0x160, "Gear", "gear", 1.0, 1.01),
    ]:
        t, values = decoded(drive, "testcar.dbc", can_id, signal)
        steady_part = t > 60
        truth = np.interp(t, drive.history["t_s"], drive.history[column]) * factor
        assert values[steady_part] == pytest.approx(truth[steady_part], abs=tolerance)
    t, accel = decoded(drive, "testcar.dbc", 0x150, "LongitudinalAccel")
    assert accel[t > 75].mean() == pytest.approx(9.80665 * np.sin(np.arctan(0.118)), abs=0.15)
