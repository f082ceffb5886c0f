"""A gateway that passes J1587 on: gear, speeds and brake as byte 1 MID, byte 2 PID, then data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.simulation.constants import BRAKE_LIGHT, STANDING
from canest.simulation.packing import Cyclic, Field, Scale, flag, payload
from canest.simulation.sensors import Signals

GATEWAY_ID = 0x18FF87F9
ENGINE, TRANSMISSION, BRAKES = 128, 130, 136  #: message identifiers (MID, SAE J1587)
BRAKE_STATE, ROAD_SPEED, GEAR_ATTAINED, ENGINE_SPEED = 65, 84, 163, 190  #: parameter identifiers (PID)
PID_84 = Scale(16, 8, 0.805, 0, 255)  #: road speed, km/h (half a mile per hour)
PID_190 = Scale(16, 16, 0.25, 0, 65535)  #: engine speed, rpm
GEARS = 99  #: that two characters can name
NEUTRAL_NAME = int.from_bytes(b"N ", "little")


def gateway_schedule(signals: Signals) -> list[Cyclic]:
    """Return what the gateway sends: identifier, period and phase in s (chosen), content."""
    gateway = _Gateway(signals)
    return [
        Cyclic(GATEWAY_ID, 0.5, 0.011, gateway.gear),
        Cyclic(GATEWAY_ID, 0.1, 0.013, gateway.road_speed),
        Cyclic(GATEWAY_ID, 0.1, 0.015, gateway.engine_speed),
        Cyclic(GATEWAY_ID, 0.5, 0.019, gateway.brake),
    ]


@dataclass(frozen=True)
class _Gateway:
    """Each method returns payloads (n,) for times t (n,) in s from the start."""

    signals: Signals

    def gear(self, t: FloatColumn) -> NDArray[np.uint64]:
        names = np.array([int.from_bytes(f"{k + 1:<2d}".encode(), "little") for k in range(GEARS)])
        attained = names[self.signals.held("gear", t).astype(int)]
        shown = np.where(self.signals.phase_in(t, STANDING), NEUTRAL_NAME, attained)
        return _parameter(TRANSMISSION, GEAR_ATTAINED, Field(16, 16, shown), len(t))

    def road_speed(self, t: FloatColumn) -> NDArray[np.uint64]:
        return _parameter(TRANSMISSION, ROAD_SPEED, PID_84.field(self.signals.road_speed_kmh(t)), len(t))

    def engine_speed(self, t: FloatColumn) -> NDArray[np.uint64]:
        return _parameter(ENGINE, ENGINE_SPEED, PID_190.field(self.signals.engine_rpm(t)), len(t))

    def brake(self, t: FloatColumn) -> NDArray[np.uint64]:
        return _parameter(BRAKES, BRAKE_STATE, flag(16, 8, self.signals.at("brake", t) > BRAKE_LIGHT), len(t))


def _parameter(mid: int, pid: int, field: Field, n: int) -> NDArray[np.uint64]:
    return payload([Field(0, 8, np.full(n, mid)), Field(8, 8, np.full(n, pid)), field], n)
