"""A passenger car's bus (`dbc/testcar.dbc`): plain 11-bit frames, with instrumented half-shafts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, FrameBlock
from canest.simulation.constants import BRAKE_LIGHT, PERCENT
from canest.simulation.effects import SwitchedLoad
from canest.simulation.packing import (
    Cyclic,
    Field,
    Scale,
    flag,
    payload,
    random_payloads,
    send,
    signed,
)
from canest.simulation.scenario import Scenario
from canest.simulation.sensors import ON, Signals

STRAIN_GAUGE_NOISE_NM = 4.0  #: chosen
NOT_SENT = np.uint64(0)  #: bits that no signal has
HALF_TURN_DEG = 180

# Start bits and resolutions of dbc/testcar.dbc.
TOP8, TOP16 = 250, 65535
ENGINE_SPEED = Scale(16, 16, 0.25, 0, TOP16)
PEDAL = Scale(32, 8, 0.4, 0, TOP8)
FRONT_SPEED, REAR_SPEED = Scale(0, 16, 0.01, 0, TOP16), Scale(16, 16, 0.01, 0, TOP16)
GEAR_RATIO = Scale(8, 16, 0.001, 0, TOP16)
OUTPUT_SPEED = Scale(24, 16, 0.25, 0, TOP16)
BRAKE = Scale(8, 8, 0.4, 0, TOP8)
ALTITUDE = Scale(0, 16, 0.125, -1000, TOP16)
TORQUE_NM, STEERING_DEG, ACCEL_MPS2, YAW_RADPS = 0.5, 0.1, 0.01, 0.0005  #: resolutions of signed values

#: frames that concern nobody
OTHER_ID, OTHERS, OTHER_PERIOD_S, OTHER_PHASE_S, OTHER_SPACING_S = 0x300, 8, 0.02, 0.008, 0.001
OTHER_BELOW = 2**63


def car_frames(
    signals: Signals, scenario: Scenario, load: SwitchedLoad | None, rng: np.random.Generator
) -> FrameBlock:
    """Return everything that is on the car's bus during a drive."""
    car = Car(signals)
    messages = [
        # identifier, period and phase in s (chosen), content
        Cyclic(0x120, 0.01, 0.001, car.engine),
        Cyclic(0x130, 0.01, 0.002, car.wheels),
        Cyclic(0x140, 0.01, 0.003, car.half_shafts),
        Cyclic(0x150, 0.01, 0.004, car.motion),
        Cyclic(0x160, 0.02, 0.005, car.gearbox),
        Cyclic(0x170, 0.02, 0.006, car.brakes),
        Cyclic(0x180, 1.0, 0.007, car.position),
    ]
    if scenario.bus.traffic:
        messages += [
            Cyclic(
                OTHER_ID + k,
                OTHER_PERIOD_S,
                OTHER_PHASE_S + OTHER_SPACING_S * k,
                random_payloads(rng, OTHER_BELOW, endpoint=False),
            )
            for k in range(OTHERS)
        ]
    return send(messages, scenario.duration_s, scenario.bus, rng)


@dataclass(frozen=True)
class Car:
    """The car's controllers. Each method returns payloads (n,) for times t (n,) in s from the start."""

    signals: Signals

    def engine(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Net torque, speed, pedal, and whether the switched load is on."""
        signals = self.signals
        net_pct = signals.indicated_pct(t) - signals.friction_pct(t)
        fields = [
            signed(0, 16, net_pct / PERCENT * signals.vehicle.reference_torque_Nm, TORQUE_NM),
            ENGINE_SPEED.field(signals.engine_rpm(t)),
            PEDAL.field(signals.at("pedal", t) * PERCENT),
            flag(40, 1, signals.at("load_on", t) > ON),
        ]
        return payload(fields, len(t), NOT_SENT)

    def half_shafts(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Torque of the left and the right half-shaft, by strain gauges."""
        signals = self.signals
        side = signals.at("wheel_torque_Nm", t) / 2
        sides = [
            signed(start, 16, side + signals.noise(len(t), STRAIN_GAUGE_NOISE_NM), TORQUE_NM)
            for start in (0, 16)
        ]
        return payload(sides, len(t), NOT_SENT)

    def wheels(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Speeds of the driven and of the undriven axle."""
        driven = FRONT_SPEED.field(self.signals.road_speed_kmh(t))
        return payload([driven, REAR_SPEED.field(self.signals.axle_speed_kmh(t))], len(t), NOT_SENT)

    def gearbox(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Gear, its ratio, output shaft speed, shift in process, clutch closed."""
        signals = self.signals
        gear = signals.held("gear", t).astype(np.int64)
        fields = [
            Field(0, 8, gear + 1),
            GEAR_RATIO.field(np.asarray(signals.vehicle.gear_ratios)[gear]),
            OUTPUT_SPEED.field(signals.output_rpm(t)),
            flag(40, 1, signals.shifting(t)),
            flag(41, 1, ~signals.disengaged(t)),
        ]
        return payload(fields, len(t), NOT_SENT)

    def brakes(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Brake switch, brake pedal, steering wheel angle."""
        brake = self.signals.at("brake", t)
        fields = [
            flag(0, 1, brake > BRAKE_LIGHT),
            BRAKE.field(brake * PERCENT),
            signed(16, 16, self.signals.steering_rad(t) * HALF_TURN_DEG / math.pi, STEERING_DEG),
        ]
        return payload(fields, len(t), NOT_SENT)

    def motion(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Longitudinal and lateral acceleration, yaw rate."""
        fields = [
            signed(0, 16, self.signals.accelerometer(t), ACCEL_MPS2),
            signed(16, 16, self.signals.lateral_accel(t), ACCEL_MPS2),
            signed(32, 16, self.signals.yaw_rate(t), YAW_RADPS),
        ]
        return payload(fields, len(t), NOT_SENT)

    def position(self, t: FloatColumn) -> NDArray[np.uint64]:
        """Altitude of satellite navigation."""
        return payload([ALTITUDE.field(self.signals.altitude_m(t))], len(t), NOT_SENT)
