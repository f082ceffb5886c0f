"""What a scenario may hold, checked key by key."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from pydantic import Field, ValidationInfo, field_validator

from canest.simulation.drivers import Driver
from canest.simulation.effects import Effect
from canest.simulation.roads import Flat, Road
from canest.simulation.vehicles import Strict, VehicleSpec, vehicle_with


class MassChange(Strict):
    """Mass from the first standstill at or after `t_s`, or from `t_s` itself if it changes in motion.

    Until the next change it grows by `rate_kgps` while the vehicle moves (negative: a spreader loses mass).
    """

    t_s: float = Field(ge=0)
    mass_kg: float = Field(gt=0)
    moving: bool = False  #: changes at `t_s`, whether the vehicle stands or not
    rate_kgps: float = 0.0


class Bus(Strict):
    """How the bus behaves."""

    start_s: int = 1_700_000_000
    loss: float = Field(0.002, ge=0, lt=1)
    jitter_s: float = Field(0.00045, ge=0)  #: mean delay of a frame
    traffic: bool = True  #: frames that concern nobody
    cab_controller: bool = True  #: random bytes in wanted groups, from source address 0x31
    j1587_gateway: bool = False  #: gear and speed only as J1587 parameters


class Sensors(Strict):
    """What the sensors and controllers add; none of it is declared."""

    torque_delay_s: float = Field(0.06, ge=0)
    accelerometer_bias_mps2: float | None = None  #: None: drawn
    accelerometer_noise_mps2: float = Field(0.06, ge=0)
    shaft_noise_rpm: float = Field(0.4, ge=0)
    wheel_noise_kmh: float = Field(0.02, ge=0)
    altitude_noise_m: float = Field(1.0, ge=0)
    yaw_noise_radps: float = Field(0.001, ge=0)


class Positions(Strict):
    """A satellite receiver: where the drive begins, which way, and how well it is received."""

    latitude_deg: float = Field(47.0, ge=-80, le=80)
    longitude_deg: float = Field(8.0, ge=-180, le=180)
    heading_deg: float = 0.0  #: from north, clockwise
    period_s: float = Field(1.0, ge=0.1, le=10)
    noise_m: float = Field(2.0, ge=0)
    jumps_per_hour: float = Field(0.0, ge=0)
    jump_m: float = Field(150.0, ge=0)
    lost_share: float = Field(0.0, ge=0, le=1)  #: reports without a position


class Scenario(Strict):
    """A drive to simulate: vehicle, load, road, driver, bus, and what the config will not know."""

    title: str = ""
    seed: int = Field(0, ge=0)
    duration_s: float = Field(gt=1, le=36_000)
    vehicle: VehicleSpec
    mass_kg: list[MassChange]
    road: Road = Flat(kind="flat")
    driver: Driver
    bus: Bus = Field(default_factory=lambda: Bus.model_validate({}))
    sensors: Sensors = Field(default_factory=lambda: Sensors.model_validate({}))
    positions: Positions | None = None  #: None: no receiver
    undeclared: tuple[Effect, ...] = ()
    small_errors: bool = False

    @field_validator("vehicle", mode="before")
    @classmethod
    def _preset(cls, value: Any) -> Any:
        if isinstance(value, str):
            return vehicle_with(value, {})
        if isinstance(value, dict) and "preset" in value:
            return vehicle_with(value["preset"], {k: v for k, v in value.items() if k != "preset"})
        return value

    @field_validator("mass_kg", mode="before")
    @classmethod
    def _one_mass(cls, value: Any) -> Any:
        return [{"t_s": 0.0, "mass_kg": value}] if isinstance(value, int | float) else value

    @field_validator("mass_kg")
    @classmethod
    def _starts(cls, value: list[MassChange], info: ValidationInfo) -> list[MassChange]:
        if not value or value[0].t_s != 0 or any(b.t_s <= a.t_s for a, b in pairwise(value)):
            raise ValueError("a list of mass changes starts at t_s 0 and goes forward in time")
        lightest = _mass_range(value, info.data.get("duration_s", 0.0))[0]
        if lightest <= 0:
            raise ValueError(f"found a rate_kgps that leaves {lightest:g} kg, expected a mass above 0")
        return value

    @property
    def mass_range_kg(self) -> tuple[float, float]:
        """Return the lightest and the heaviest that the vehicle can become."""
        return _mass_range(self.mass_kg, self.duration_s)


def _mass_range(changes: list[MassChange], duration_s: float) -> tuple[float, float]:
    """Return the lowest and the highest mass (kg) if the vehicle never stands."""
    ends = [
        next((later.t_s for later in changes[k + 1 :] if later.moving), duration_s)
        for k in range(len(changes))
    ]
    masses = [change.mass_kg for change in changes]
    for change, end in zip(changes, ends, strict=True):
        masses.append(change.mass_kg + change.rate_kgps * max(0.0, end - change.t_s))
    return min(masses), max(masses)
