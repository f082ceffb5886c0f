"""A passenger car's bus (`dbc/testcar.dbc`): plain 11-bit frames, with instrumented half-shafts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, FrameBlock
from canest.simulate.effects import SwitchedLoad
from canest.simulate.packing import Cyclic, Field, payload, scaled, send, signed
from canest.simulate.scenario import Scenario
from canest.simulate.signals import Signals

ZERO = np.uint64(0)
STRAIN_GAUGE_NOISE_NM = 4.0


def car_frames(
    signals: Signals,
    scenario: Scenario,
    load: SwitchedLoad | None,
    duration_s: float,
    rng: np.random.Generator,
) -> FrameBlock:
    """Return everything that is on the car's bus during a drive."""

    def engine(t: FloatColumn) -> NDArray[np.uint64]:
        net = (signals.indicated_pct(t) - signals.friction_pct(t)) / 100 * signals.vehicle.reference_torque_Nm
        return payload(
            [
                signed(0, 16, net, 0.5),
                scaled(16, 16, signals.engine_rpm(t), 0.25, 0, 65535),
                scaled(32, 8, signals.at("pedal", t) * 100, 0.4, 0, 250),
                Field(40, 1, (signals.at("load_on", t) > 0.5).astype(np.int64)),
            ],
            len(t),
            ZERO,
        )

    def half_shafts(t: FloatColumn) -> NDArray[np.uint64]:
        side = signals.at("wheel_torque_Nm", t) / 2
        sides = [
            signed(start, 16, side + signals.noise(len(t), STRAIN_GAUGE_NOISE_NM), 0.5) for start in (0, 16)
        ]
        return payload(sides, len(t), ZERO)

    def wheels(t: FloatColumn) -> NDArray[np.uint64]:
        return payload(
            [
                scaled(0, 16, signals.road_speed_kmh(t), 0.01, 0, 65535),
                scaled(16, 16, signals.axle_speed_kmh(t), 0.01, 0, 65535),
            ],
            len(t),
            ZERO,
        )

    def gearbox(t: FloatColumn) -> NDArray[np.uint64]:
        gear = signals.held("gear", t).astype(np.int64)
        return payload(
            [
                Field(0, 8, gear + 1),
                scaled(8, 16, np.asarray(signals.vehicle.gear_ratios)[gear], 0.001, 0, 65535),
                scaled(24, 16, signals.output_rpm(t), 0.25, 0, 65535),
                Field(40, 1, signals.shifting(t).astype(np.int64)),
                Field(41, 1, (~signals.disengaged(t)).astype(np.int64)),
            ],
            len(t),
            ZERO,
        )

    def brakes(t: FloatColumn) -> NDArray[np.uint64]:
        brake = signals.at("brake", t)
        return payload(
            [
                Field(0, 1, (brake > 0.003).astype(np.int64)),
                scaled(8, 8, brake * 100, 0.4, 0, 250),
                signed(16, 16, signals.steering_rad(t) * 180 / math.pi, 0.1),
            ],
            len(t),
            ZERO,
        )

    def motion(t: FloatColumn) -> NDArray[np.uint64]:
        return payload(
            [
                signed(0, 16, signals.accelerometer(t), 0.01),
                signed(16, 16, signals.lateral_accel(t), 0.01),
                signed(32, 16, signals.yaw_rate(t), 0.0005),
            ],
            len(t),
            ZERO,
        )

    def position(t: FloatColumn) -> NDArray[np.uint64]:
        return payload([scaled(0, 16, signals.altitude_m(t), 0.125, -1000, 65535)], len(t), ZERO)

    messages = [
        Cyclic(0x120, 0.01, 0.001, engine),
        Cyclic(0x130, 0.01, 0.002, wheels),
        Cyclic(0x140, 0.01, 0.003, half_shafts),
        Cyclic(0x150, 0.01, 0.004, motion),
        Cyclic(0x160, 0.02, 0.005, gearbox),
        Cyclic(0x170, 0.02, 0.006, brakes),
        Cyclic(0x180, 1.0, 0.007, position),
    ]
    if scenario.bus.traffic:
        messages += [
            Cyclic(0x300 + k, 0.02, 0.008 + 0.001 * k, lambda t: rng.integers(0, 2**63, len(t), np.uint64))
            for k in range(8)
        ]
    return send(messages, duration_s, scenario.bus, rng)
