"""The truck's bus: which controller sends what, how often, in J1939 coding (SPNs beside the fields)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, FrameBlock
from canest.simulate.constants import STANDING
from canest.simulate.effects import SwitchedLoad
from canest.simulate.packing import Content, Cyclic, Field, constant, payload, scaled, send
from canest.simulate.scenario import Scenario
from canest.simulate.signals import RPM, Signals

TOP8, TOP16 = 250, 64255  #: highest raw values that are numbers
BAM_PERIOD_S, BAM_PHASE_S, BAM_GAP_S = 5.0, 0.5, 0.055
FAN_FULL_RPM = 2000.0  #: engine speed at which the fan turns at 100 %


def j1939_frames(
    signals: Signals,
    scenario: Scenario,
    load: SwitchedLoad | None,
    duration_s: float,
    rng: np.random.Generator,
) -> FrameBlock:
    """Return everything that is on the truck's bus during a drive."""
    gateway = scenario.bus.j1587_gateway
    nothing = Field(0, 0, np.zeros(1, np.int64))

    def bits(start: int, count: int, on: NDArray[np.bool_]) -> Field:
        return Field(start, count, on.astype(np.int64))

    def eec1(t: FloatColumn) -> NDArray[np.uint64]:
        demand = signals.at("demand_Nm", t) / signals.vehicle.reference_torque_Nm * 100
        speed = scaled(24, 16, signals.engine_rpm(t), 0.125, 0.0, TOP16)  # SPN 190
        return payload(
            [
                Field(0, 8, np.full(len(t), 0xF1)),  # SPN 899: accelerator pedal; SPN 4154 not available
                scaled(8, 8, demand, 1, -125, TOP8),  # SPN 512
                scaled(16, 8, signals.indicated_pct(t), 1, -125, TOP8),  # SPN 513
                nothing if gateway else speed,
                Field(40, 8, np.zeros(len(t), np.int64)),  # SPN 1483
            ],
            len(t),
        )

    def eec2(t: FloatColumn) -> NDArray[np.uint64]:
        return payload([scaled(8, 8, signals.at("pedal", t) * 100, 0.4, 0, TOP8)], len(t))  # SPN 91

    def eec3(t: FloatColumn) -> NDArray[np.uint64]:
        return payload([scaled(0, 8, signals.friction_pct(t), 1, -125, TOP8)], len(t))  # SPN 514

    def ccvs(t: FloatColumn) -> NDArray[np.uint64]:
        on = signals.at("load_on", t) > 0.5
        pto = load is not None and load.signal == "pto_state"
        return payload(
            [
                bits(2, 2, np.zeros(len(t), bool)),  # SPN 70
                scaled(8, 16, signals.road_speed_kmh(t), 1 / 256, 0, TOP16),  # SPN 84
                bits(24, 2, np.zeros(len(t), bool)),  # SPN 595
                bits(28, 2, signals.at("brake", t) > 0.003),  # SPN 597
                Field(48, 5, np.where(on, 5, 0)) if pto else nothing,  # SPN 976: 5 is "set"
            ],
            len(t),
        )

    def fan(t: FloatColumn) -> NDArray[np.uint64]:
        share = np.zeros(len(t))
        if load is not None and load.signal == "fan_speed":
            turning = signals.at("engine_radps", t) * RPM / FAN_FULL_RPM if load.law == "cubic" else 1.0
            share = 100 * signals.at("load_on", t) * turning
        return payload([scaled(0, 8, share, 0.4, 0, TOP8)], len(t))  # SPN 975

    def etc1(t: FloatColumn) -> NDArray[np.uint64]:
        engaged = ~signals.disengaged(t)
        slip = np.where(engaged, 0.0, np.where(signals.shifting(t), 1.0, signals.held("clutch_slip", t)))
        shafts = [
            scaled(8, 16, signals.output_rpm(t), 0.125, 0, TOP16),  # SPN 191
            scaled(40, 16, signals.input_rpm(t), 0.125, 0, TOP16),  # SPN 161
        ]
        return payload(
            [
                bits(0, 2, engaged),  # SPN 560
                bits(2, 2, engaged),  # SPN 573
                bits(4, 2, signals.shifting(t)),  # SPN 574
                *([] if gateway else shafts),
                scaled(24, 8, slip * 100, 0.4, 0, TOP8),  # SPN 522
                Field(56, 8, np.full(len(t), 3)),  # SPN 1482
            ],
            len(t),
        )

    def etc2(t: FloatColumn) -> NDArray[np.uint64]:
        gear = signals.held("gear", t).astype(np.int64)
        ratio = np.asarray(signals.vehicle.gear_ratios)[gear]
        drive = np.full(len(t), int.from_bytes(b" D", "little"))
        return payload(
            [
                Field(0, 8, gear + 126),  # SPN 524
                scaled(8, 16, ratio, 0.001, 0, TOP16),  # SPN 526
                Field(24, 8, gear + 126),  # SPN 523
                Field(32, 16, drive),  # SPN 162
                Field(48, 16, drive),  # SPN 163
            ],
            len(t),
        )

    def ebc1(t: FloatColumn) -> NDArray[np.uint64]:
        return payload([scaled(8, 8, signals.at("brake", t) * 100, 0.4, 0, TOP8)], len(t))  # SPN 521

    def ebc2(t: FloatColumn) -> NDArray[np.uint64]:
        level = np.uint64(0x7D7D_7D7D_7D7D_FFFF)  # all wheels as fast as the front axle
        return payload(
            [scaled(0, 16, signals.axle_speed_kmh(t), 1 / 256, 0, TOP16)], len(t), level
        )  # SPN 904

    def vdc2(t: FloatColumn) -> NDArray[np.uint64]:
        return payload(
            [
                scaled(0, 16, signals.steering_rad(t), 1 / 1024, -31.374, TOP16),  # SPN 1807
                scaled(24, 16, signals.yaw_rate(t), 1 / 8192, -3.92, TOP16),  # SPN 1808
                scaled(40, 16, signals.lateral_accel(t), 1 / 2048, -15.687, TOP16),  # SPN 1809
                scaled(56, 8, signals.accelerometer(t), 0.1, -12.5, TOP8),  # SPN 1810
            ],
            len(t),
        )

    def erc1(t: FloatColumn) -> NDArray[np.uint64]:
        share = -100 * signals.at("retarder_Nm", t) / signals.vehicle.retarder_Nm
        torque = [scaled(start, 8, share, 1, -125, TOP8) for start in (8, 16)]  # SPN 520, 1085
        return payload([Field(0, 8, np.full(len(t), 0xF1)), *torque], len(t))

    def vds(t: FloatColumn) -> NDArray[np.uint64]:
        speed = np.maximum(0, signals.at("speed_mps", t - 0.3) + signals.noise(len(t), 0.05)) * 3.6
        return payload(
            [
                scaled(16, 16, speed, 1 / 256, 0, TOP16),  # SPN 517
                scaled(48, 16, signals.altitude_m(t), 0.125, -2500, TOP16),  # SPN 580
            ],
            len(t),
        )

    messages = [
        Cyclic(0x0CF00400, 0.02, 0.001, eec1),
        Cyclic(0x0CF00300, 0.05, 0.007, eec2),
        Cyclic(0x18FEDF00, 0.25, 0.041, eec3),
        Cyclic(0x18FEF500, 1.0, 0.051, constant("CBFFFF4025FFFFFF")),  # AMB: 101.5 kPa, 25 degC
        Cyclic(0x18FEBD00, 1.0, 0.071, fan),
        Cyclic(0x0CF00203, 0.01, 0.003, etc1),
        Cyclic(0x18F0090B, 0.01, 0.006, vdc2),
        Cyclic(0x18F0000F, 0.1, 0.031, erc1),
        Cyclic(0x18FEE81C, 1.0, 0.061, vds),
        *_engine_configuration(scenario),
    ]
    if gateway:
        messages += _j1587(signals)
    else:
        messages += [
            Cyclic(0x18FEF100, 0.1, 0.017, ccvs),
            Cyclic(0x18F00503, 0.1, 0.011, etc2),
            Cyclic(0x18F0010B, 0.1, 0.023, ebc1),
            Cyclic(0x18FEBF0B, 0.1, 0.029, ebc2),
        ]
    if scenario.bus.traffic:
        for k in range(11):
            messages.append(
                Cyclic(
                    0x18FF2027 + 256 * k, 0.02, 0.016 + 0.002 * k, constant(f"{0x20 + k:02X}102700FFFFFFFF")
                )
            )
        messages.append(Cyclic(0x18FEC1EE, 1.0, 0.014, _random(rng)))
    if scenario.bus.cab_controller:
        cab = [(0x0C000031, 0.02), (0x18F00131, 0.1), (0x18FE6C31, 0.05), (0x18FEEE31, 1.0),
               (0x18FEEF31, 0.5), (0x18FEF131, 0.1), (0x18FEF231, 0.1)]  # fmt: skip
        messages += [
            Cyclic(can_id, period, 0.002 * k + 0.001, _random(rng)) for k, (can_id, period) in enumerate(cab)
        ]
    return send(messages, duration_s, scenario.bus, rng)


def _random(rng: np.random.Generator) -> Content:
    return lambda t: rng.integers(0, 2**64 - 1, len(t), np.uint64, endpoint=True)


def _engine_configuration(scenario: Scenario) -> list[Cyclic]:
    """EC1 (39 bytes, SPN 544 in bytes 20 and 21, the rest not available) as a broadcast announce message."""
    body = bytearray(b"\xff" * 42)
    body[19:21] = round(scenario.vehicle.reference_torque_Nm).to_bytes(2, "little")
    announce = Cyclic(0x18ECFF00, BAM_PERIOD_S, BAM_PHASE_S, constant("20270006FFE3FE00"))
    return [announce] + [
        Cyclic(
            0x18EBFF00,
            BAM_PERIOD_S,
            BAM_PHASE_S + BAM_GAP_S * (k + 1),
            constant((bytes([k + 1]) + bytes(body[7 * k : 7 * k + 7])).hex()),
        )
        for k in range(6)
    ]


def _j1587(signals: Signals) -> list[Cyclic]:
    """Gear, speeds and brake of a gateway that passes J1587 on: byte 1 MID, byte 2 PID, then data."""

    def parameter(mid: int, pid: int, field: Field, n: int) -> NDArray[np.uint64]:
        return payload([Field(0, 8, np.full(n, mid)), Field(8, 8, np.full(n, pid)), field], n)

    def gear(t: FloatColumn) -> NDArray[np.uint64]:
        names = np.array([int.from_bytes(f"{k + 1:<2d}".encode(), "little") for k in range(99)])
        attained = names[signals.held("gear", t).astype(int)]
        neutral = int.from_bytes(b"N ", "little")
        return parameter(
            130, 163, Field(16, 16, np.where(signals.phase_in(t, STANDING), neutral, attained)), len(t)
        )

    def road_speed(t: FloatColumn) -> NDArray[np.uint64]:
        return parameter(130, 84, scaled(16, 8, signals.road_speed_kmh(t), 0.805, 0, 255), len(t))

    def engine_speed(t: FloatColumn) -> NDArray[np.uint64]:
        return parameter(128, 190, scaled(16, 16, signals.engine_rpm(t), 0.25, 0, 65535), len(t))

    def brake(t: FloatColumn) -> NDArray[np.uint64]:
        return parameter(136, 65, Field(16, 8, (signals.at("brake", t) > 0.003).astype(np.int64)), len(t))

    return [
        Cyclic(0x18FF87F9, 0.5, 0.011, gear),
        Cyclic(0x18FF87F9, 0.1, 0.013, road_speed),
        Cyclic(0x18FF87F9, 0.1, 0.015, engine_speed),
        Cyclic(0x18FF87F9, 0.5, 0.019, brake),
    ]
