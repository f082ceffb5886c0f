"""What the truck's controllers send, in J1939 coding: payloads by time.

Start bits, resolutions and offsets are those of SAE J1939-71, under the number of each parameter (SPN).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.simulation.constants import BRAKE_LIGHT, KMH, PERCENT, RPM
from canest.simulation.effects import SwitchedLoad
from canest.simulation.packing import Field, Scale, flag, payload
from canest.simulation.sensors import ON, Signals

TOP8, TOP16 = 250, 64255  #: highest raw values that are numbers

SPN_84 = Scale(8, 16, 1 / 256, 0, TOP16)  #: wheel-based vehicle speed, km/h
SPN_91 = Scale(8, 8, 0.4, 0, TOP8)  #: accelerator pedal position, %
SPN_161 = Scale(40, 16, 0.125, 0, TOP16)  #: input shaft speed, rpm
SPN_190 = Scale(24, 16, 0.125, 0, TOP16)  #: engine speed, rpm
SPN_191 = Scale(8, 16, 0.125, 0, TOP16)  #: output shaft speed, rpm
SPN_512 = Scale(8, 8, 1, -125, TOP8)  #: driver's demand torque, %
SPN_513 = Scale(16, 8, 1, -125, TOP8)  #: actual torque, %
SPN_514 = Scale(0, 8, 1, -125, TOP8)  #: nominal friction torque, %
SPN_517 = Scale(16, 16, 1 / 256, 0, TOP16)  #: navigation-based vehicle speed, km/h
SPN_520 = Scale(8, 8, 1, -125, TOP8)  #: actual retarder torque, %
SPN_521 = Scale(8, 8, 0.4, 0, TOP8)  #: brake pedal position, %
SPN_522 = Scale(24, 8, 0.4, 0, TOP8)  #: clutch slip, %
SPN_526 = Scale(8, 16, 0.001, 0, TOP16)  #: actual gear ratio
SPN_580 = Scale(48, 16, 0.125, -2500, TOP16)  #: altitude, m
SPN_904 = Scale(0, 16, 1 / 256, 0, TOP16)  #: front axle speed, km/h
SPN_975 = Scale(0, 8, 0.4, 0, TOP8)  #: fan speed, %
SPN_1085 = Scale(16, 8, 1, -125, TOP8)  #: intended retarder torque, %
SPN_1807 = Scale(0, 16, 1 / 1024, -31.374, TOP16)  #: steering wheel angle, rad
SPN_1808 = Scale(24, 16, 1 / 8192, -3.92, TOP16)  #: yaw rate, rad/s
SPN_1809 = Scale(40, 16, 1 / 2048, -15.687, TOP16)  #: lateral acceleration, m/s2
SPN_1810 = Scale(56, 8, 0.1, -12.5, TOP8)  #: longitudinal acceleration, m/s2

BY_PEDAL = 0xF1  #: SPN 899: accelerator pedal, SPN 4154 not available; SPN 900 alike
TRANSMISSION = 3  #: SPN 1482: source address of the controlling device
FIRST_GEAR = 126  #: raw value of the first gear, less the offset of -125
PTO_SET = 5  #: SPN 976: set
DRIVE_RANGE = int.from_bytes(b" D", "little")  #: SPN 162, 163
LIKE_FRONT_AXLE = np.uint64(0x7D7D_7D7D_7D7D_FFFF)  #: SPN 905 to 910: every wheel as fast as the front axle
FAN_FULL_RPM = 2000.0  #: engine speed at which the fan turns at 100 % (chosen)
NAVIGATION_DELAY_S = 0.3  #: chosen
NAVIGATION_NOISE_MPS = 0.05  #: chosen

Payloads = NDArray[np.uint64]


@dataclass(frozen=True)
class Truck:
    """The truck's controllers. Each method returns payloads (n,) for times t (n,) in s from the start."""

    signals: Signals
    load: SwitchedLoad | None
    gateway: bool  #: speeds and gear only as J1587 parameters

    def eec1(self, t: FloatColumn) -> Payloads:
        """Electronic engine controller 1: torque and speed."""
        signals = self.signals
        demand = signals.at("demand_Nm", t) / signals.vehicle.reference_torque_Nm * PERCENT
        speed = SPN_190.field(signals.engine_rpm(t))
        return payload(
            [
                Field(0, 8, np.full(len(t), BY_PEDAL)),
                SPN_512.field(demand),
                SPN_513.field(signals.indicated_pct(t)),
                *([] if self.gateway else [speed]),
                Field(40, 8, np.zeros(len(t), np.int64)),  # SPN 1483: the engine itself
            ],
            len(t),
        )

    def eec2(self, t: FloatColumn) -> Payloads:
        """Electronic engine controller 2: accelerator pedal."""
        return payload([SPN_91.field(self.signals.at("pedal", t) * PERCENT)], len(t))

    def eec3(self, t: FloatColumn) -> Payloads:
        """Electronic engine controller 3: friction."""
        return payload([SPN_514.field(self.signals.friction_pct(t))], len(t))

    def ccvs(self, t: FloatColumn) -> Payloads:
        """Cruise control and vehicle speed, with switches: no parking brake, no cruise control."""
        off = np.zeros(len(t), bool)
        fields = [
            flag(2, 2, off),  # SPN 70
            SPN_84.field(self.signals.road_speed_kmh(t)),
            flag(24, 2, off),  # SPN 595
            flag(28, 2, self.signals.at("brake", t) > BRAKE_LIGHT),  # SPN 597
        ]
        if self.load is not None and self.load.signal == "pto_state":
            on = self.signals.at("load_on", t) > ON
            fields.append(Field(48, 5, np.where(on, PTO_SET, 0)))  # SPN 976
        return payload(fields, len(t))

    def fan(self, t: FloatColumn) -> Payloads:
        """Fan drive."""
        share = np.zeros(len(t))
        if self.load is not None and self.load.signal == "fan_speed":
            cubic = self.load.law == "cubic"
            turning = self.signals.at("engine_radps", t) * RPM / FAN_FULL_RPM if cubic else 1.0
            share = PERCENT * self.signals.at("load_on", t) * turning
        return payload([SPN_975.field(share)], len(t))

    def etc1(self, t: FloatColumn) -> Payloads:
        """Electronic transmission controller 1: shafts, clutch, shift in process."""
        signals = self.signals
        engaged = ~signals.disengaged(t)
        open_slip = np.where(signals.shifting(t), 1.0, signals.held("clutch_slip", t))
        slip = np.where(engaged, 0.0, open_slip)
        shafts = [SPN_191.field(signals.output_rpm(t)), SPN_161.field(signals.input_rpm(t))]
        return payload(
            [
                flag(0, 2, engaged),  # SPN 560
                flag(2, 2, engaged),  # SPN 573
                flag(4, 2, signals.shifting(t)),  # SPN 574
                *([] if self.gateway else shafts),
                SPN_522.field(slip * PERCENT),
                Field(56, 8, np.full(len(t), TRANSMISSION)),
            ],
            len(t),
        )

    def etc2(self, t: FloatColumn) -> Payloads:
        """Electronic transmission controller 2: gear."""
        gear = self.signals.held("gear", t).astype(np.int64)
        ratio = np.asarray(self.signals.vehicle.gear_ratios)[gear]
        drive = np.full(len(t), DRIVE_RANGE)
        return payload(
            [
                Field(0, 8, gear + FIRST_GEAR),  # SPN 524
                SPN_526.field(ratio),
                Field(24, 8, gear + FIRST_GEAR),  # SPN 523
                Field(32, 16, drive),  # SPN 162
                Field(48, 16, drive),  # SPN 163
            ],
            len(t),
        )

    def ebc1(self, t: FloatColumn) -> Payloads:
        """Electronic brake controller 1: brake pedal."""
        return payload([SPN_521.field(self.signals.at("brake", t) * PERCENT)], len(t))

    def ebc2(self, t: FloatColumn) -> Payloads:
        """Electronic brake controller 2: wheel speeds."""
        return payload([SPN_904.field(self.signals.axle_speed_kmh(t))], len(t), LIKE_FRONT_AXLE)

    def vdc2(self, t: FloatColumn) -> Payloads:
        """Vehicle dynamic stability control 2: steering, yaw rate, accelerations."""
        return payload(
            [
                SPN_1807.field(self.signals.steering_rad(t)),
                SPN_1808.field(self.signals.yaw_rate(t)),
                SPN_1809.field(self.signals.lateral_accel(t)),
                SPN_1810.field(self.signals.accelerometer(t)),
            ],
            len(t),
        )

    def erc1(self, t: FloatColumn) -> Payloads:
        """Electronic retarder controller 1."""
        share = -PERCENT * self.signals.at("retarder_Nm", t) / self.signals.vehicle.retarder_Nm
        mode = Field(0, 8, np.full(len(t), BY_PEDAL))
        return payload([mode, SPN_520.field(share), SPN_1085.field(share)], len(t))

    def vds(self, t: FloatColumn) -> Payloads:
        """Vehicle direction and speed, of satellite navigation."""
        noise = self.signals.noise(len(t), NAVIGATION_NOISE_MPS)
        speed = np.maximum(0, self.signals.at("speed_mps", t - NAVIGATION_DELAY_S) + noise) * KMH
        return payload([SPN_517.field(speed), SPN_580.field(self.signals.altitude_m(t))], len(t))
