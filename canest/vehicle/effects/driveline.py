"""Between crank and road: losses, inertia, rolling radius, slip."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf
from typing import ClassVar

import numpy as np

from canest.vehicle.effects.base import Added, Effect, Parameter, Scaled, Stage
from canest.vehicle.effects.trials import DrivenData, Trial
from canest.vehicle.working_columns import ModelColumns

#: how well satellites show the rolling radius: driven wheels slip by half a percent to one
SATELLITE_RADIUS_STD = 0.01


@dataclass(frozen=True)
class DrivelineLoss(Effect):
    """Traction lost beyond the declared efficiency, in one gear or in all."""

    name: ClassVar[str] = "driveline_loss"
    stage: ClassVar[Stage] = "driveline"
    text: ClassVar[str] = "fraction of traction lost beyond the config's efficiency"
    rarity: ClassVar[int] = 60
    cause_quantity: ClassVar[str] = "torque"
    separated_by: ClassVar[str] = "a drive with much overrun, or a coast-down"
    scales_traction: ClassVar[bool] = True
    several_by: ClassVar[str] = "gear"
    parameters: ClassVar[dict[str, Parameter]] = {"loss": Parameter("", 0.0, -0.03, 0.5, 0.01, fault=0.08)}
    loss: float = 0.0
    gear: int | None = None

    def apply(self, c: ModelColumns) -> None:
        """Scale the efficiency where the gear matches."""
        here = 1.0 if self.gear is None else (c.gear == self.gear)
        c.efficiency = c.efficiency * (1.0 - self.loss * here)

    @property
    def caused_by(self) -> str:
        """Return the gear where it is one gear's."""
        return "gear" if self.gear else self.cause_quantity

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it for all gears, and for each."""
        return [Trial(cls.name), *(Trial(f"{cls.name} gear {g}", (("gear", g),)) for g in drives.gears)]

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        place = f"in gear {self.gear}" if self.gear else "in the driveline"
        return f"{100 * self.loss:.1f} ± {100 * std:.1g} % of traction lost {place}"


@dataclass(frozen=True)
class WheelRadius(Scaled):
    """The rolling radius is not the declared one.

    A controller counts turns of the wheels and multiplies them by a radius. With tyres of another one its
    speed is as wrong as the lever of the torque: that speeds of driven wheels agree is no proof against it.
    """

    name: ClassVar[str] = "wheel_radius"
    stage: ClassVar[Stage] = "geometry"
    text: ClassVar[str] = "true over declared rolling radius"
    column: ClassVar[str] = "radius_m"
    rarity: ClassVar[int] = 70
    cause_quantity: ClassVar[str] = "torque"
    separated_by: ClassVar[str] = "a look at a navigation or undriven-axle speed"
    scales_traction: ClassVar[bool] = True
    parameters: ClassVar[dict[str, Parameter]] = {"factor": Parameter("", 1.0, 0.7, 1.3, 0.005, fault=0.03)}
    factor: float = 1.0

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it, as large as a satellite speed allows where there is one."""
        seen = drives.radius_factor
        return [
            Trial(cls.name, measured_std=inf if seen is None else hypot(seen - 1.0, SATELLITE_RADIUS_STD))
        ]

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"a rolling radius {self.factor:.3f} ± {std:.1g} of the declared"


@dataclass(frozen=True)
class RotatingInertia(Added):
    """More rotating inertia at the crank than declared."""

    name: ClassVar[str] = "rotating_inertia"
    stage: ClassVar[Stage] = "driveline"
    text: ClassVar[str] = "rotating inertia added at the crank"
    column: ClassVar[str] = "crank_inertia_kgm2"
    rarity: ClassVar[int] = 100
    separated_by: ClassVar[str] = "hard acceleration in low gears"
    parameters: ClassVar[dict[str, Parameter]] = {
        "inertia_kgm2": Parameter(
            "kgm2", 0.0, -1.0, 50.0, 0.5, "engine_inertia_kgm2", fault=4.0, fault_share=1.0
        )
    }
    inertia_kgm2: float = 0.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"{self.amount(std)} more rotating inertia at the crank"


@dataclass(frozen=True)
class WheelSlip(Effect):
    """Driven wheels turn faster than the road passes, in proportion to their traction."""

    name: ClassVar[str] = "wheel_slip"
    stage: ClassVar[Stage] = "speed"
    text: ClassVar[str] = "driven-wheel slip per m/s2 of traction"
    rarity: ClassVar[int] = 160
    separated_by: ClassVar[str] = "an undriven-axle speed"
    parameters: ClassVar[dict[str, Parameter]] = {
        "slip_per_mps2": Parameter("s2/m", 0.0, 0.0, 0.2, 0.002, usual=0.006, fault=0.02)
    }
    slip_per_mps2: float = 0.0
    settings: ClassVar[dict[str, Parameter]] = {"mass_kg": Parameter("kg", 0.0, 50.0, 500_000.0, 1000.0)}
    #: mass by which traction becomes an acceleration; None: the geometric mean of the config's bounds
    mass_kg: float | None = None

    def apply(self, c: ModelColumns) -> None:
        """Take the slip off a speed measured at the driven wheels."""
        mass = c.auxiliary["nominal_mass_kg"] if self.mass_kg is None else self.mass_kg
        traction_N = np.nan_to_num(c.auxiliary["traction_N"])  # a speed is known without any torque
        slip = self.slip_per_mps2 * traction_N / mass * c.auxiliary["driven"]
        c.speed_mps = c.speed_mps * (1.0 - slip)

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it with the drives' own mass."""
        return [Trial(cls.name, (("mass_kg", drives.mass_kg),))]

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"driven-wheel slip of {self.amount(std)}"
