"""Two minutes of a van's bus of 11-bit identifiers, with two motors, and configs that map some of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from canest.config import Config, parse_config, read_databases
from canest.core.frames import FloatColumn, FrameBlock
from canest.doctor.check import Doctor, Report

DBC = """VERSION ""
BU_: X
BO_ 161 MCU_F: 8 X
 SG_ MotF_Torque : 7|16@0- (0.1,0) [-500|500] "Nm" X
 SG_ MotF_Speed : 23|16@0- (1,0) [-20000|20000] "rpm" X
BO_ 162 MCU_R: 8 X
 SG_ MotR_Torque : 7|16@0- (0.1,0) [-500|500] "Nm" X
 SG_ MotR_Speed : 23|16@0- (1,0) [-20000|20000] "rpm" X
BO_ 529 VCU: 8 X
 SG_ Speed : 7|16@0+ (0.01,0) [0|250] "km/h" X
 SG_ TorqueDemand : 23|16@0- (0.1,0) [-500|500] "Nm" X
 SG_ BrakePressed : 39|1@0+ (1,0) [0|1] "" X
"""
CONFIG = """
vehicle: {{mass_min_kg: 2000, mass_max_kg: 4300, wheel_radius_m: 0.358, final_drive: 1,
  gear_ratios: {{1: 10.6}}, drag_area_m2: 1.75, rolling_resistance: 0.0105, reference_torque_Nm: 400}}
dbc: [{dbc}]
signals:
  brake_switch: {{message: VCU, signal: BrakePressed}}
  vehicle_speed: {{message: VCU, signal: Speed}}
"""
REAR = """  engine_torque: {message: MCU_R, signal: MotR_Torque}
  engine_speed: {message: MCU_R, signal: MotR_Speed}
"""
BOTH = """  half_shaft_torque_left: {message: MCU_F, signal: MotF_Torque, scale: 9}
  half_shaft_torque_right: {message: MCU_R, signal: MotR_Torque, scale: 10}
"""
T_S = np.arange(0, 120, 0.02)
SPEED_MPS = 12.0 + 6.0 * np.sin(T_S / 5)
TORQUE_NM = 60.0 + 120.0 * np.cos(T_S / 5)


def config_of(folder: Path, signals: str, dbc: str = DBC) -> Config:
    """Return a config with these signals beside the speed and the brake. Its DBC goes into the folder."""
    (folder / "van.dbc").write_text(dbc)
    return read_databases(parse_config(CONFIG.format(dbc=folder / "van.dbc") + signals))


def bus(front_Nm: FloatColumn | None = 0.7 * TORQUE_NM, radius_m: float = 0.358) -> FrameBlock:
    """Return its frames. front_Nm: torque of the front motor, None for a van that has none."""
    wheel_rpm = SPEED_MPS / radius_m * 30.0 / np.pi
    messages = {
        162: (10.0 * TORQUE_NM, 10.6 * wheel_rpm),
        529: (360.0 * SPEED_MPS, 10.0 * (TORQUE_NM + 3.0)),
    }
    if front_Nm is not None:
        messages[161] = 10.0 * front_Nm, 9.2 * wheel_rpm
    frames = []
    for number, columns in messages.items():
        raw = np.round(np.stack(columns, axis=1)).astype(">i2")
        for t_s, row in zip(T_S, raw, strict=True):
            frames.append((round(1e6 * t_s) + number, number, row.tobytes() + bytes(4)))
    return FrameBlock.from_frames(sorted(frames))


def report(config: Config, frames: FrameBlock) -> Report:
    """Return what the doctor says of them."""
    doctor = Doctor(config)
    doctor.push(frames)
    return doctor.report()
