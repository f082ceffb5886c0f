"""The section `vehicle`: its facts, with units in the names and bounds on every number."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from canest.core.masses import LEAST_MASS_KG
from canest.core.roles import RADPS_PER_RPM
from canest.core.section import MisplacedError, Number, Section, empty_section
from canest.decode.validity import GEAR_PARK

#: numbers that a gear signal has while no gear is in: neutral and park
NOTHING_ENGAGED = (0.0, GEAR_PARK)
#: torque that no signal reports, by default at most: what bearings take, and for every tonne of gross mass
#: what an engine's accessories and the oil of its gearbox take, N m
_LEAST_NM, _PER_TONNE_NM = 6.0, 3.0


class Retarder(Section):
    """A retarder that reports its torque (ERC1)."""

    reference_torque_Nm: Number = Field(gt=0, le=10_000)
    #: where its torque acts: at the crank (through the gear) or at the transmission output shaft
    location: Literal["crank", "output_shaft"] = "crank"


class Accelerometer(Section):
    """Facts of the longitudinal accelerometer, where known."""

    pitch_rad_per_mps2: Number | None = Field(None, ge=0, le=0.1)


class Vehicle(Section):
    """Facts of the vehicle that an engineer would know.

    An accuracy is two standard deviations in percent of the fact: 19 in 20 such vehicles are within it.
    unreported_torque_Nm is the most that is usual, and half of it the mean and the standard deviation. The
    sources of the defaults are in docs/config.md.
    """

    name: str = "vehicle"
    key: str = ""
    mass_min_kg: Number = Field(gt=LEAST_MASS_KG, le=1_000_000)
    mass_max_kg: Number = Field(gt=LEAST_MASS_KG, le=1_000_000)
    wheel_radius_m: Number = Field(gt=0.1, lt=2.0)
    wheel_radius_accuracy_pct: Number = Field(2.0, gt=0, le=20)
    wheel_inertia_kgm2: Number = Field(0.0, ge=0, le=100_000)
    final_drive: Number = Field(gt=0.1, lt=30)
    gear_ratios: dict[int, Number] = Field(default_factory=dict)
    driveline_efficiency: Number = Field(0.96, gt=0.5, le=1.0)
    gear_efficiency: dict[int, Number] = Field(default_factory=dict)
    engine_inertia_kgm2: Number = Field(0.0, ge=0, le=500)
    reference_torque_Nm: Number | None = Field(None, gt=1, le=65_000)
    friction_torque_pct: Number = Field(0.0, ge=-125, le=125)
    torque_accuracy_pct: Number = Field(5.0, gt=0, le=50)
    unreported_torque_Nm: Number | None = Field(None, ge=0, le=1_000)
    retarder: Retarder | None = None
    drag_area_m2: Number = Field(gt=0, lt=200)
    drag_area_accuracy_pct: Number = Field(20.0, gt=0, le=100)
    air_density_kgpm3: Number = Field(1.2, gt=0.5, lt=1.6)
    rolling_resistance: Number = Field(gt=0, lt=0.1)
    rolling_resistance_accuracy_pct: Number = Field(30.0, gt=0, le=100)
    accelerometer: Accelerometer = empty_section()

    @property
    def has_one_gear(self) -> bool:
        """Return whether there is no gear to choose, and so no clutch between engine and wheels."""
        return len(self.gear_ratios) < 2

    @property
    def mps_per_shaft_rpm(self) -> float:
        """Return how fast the road passes under the wheels per revolution a minute of the output shaft."""
        return RADPS_PER_RPM / self.final_drive * self.wheel_radius_m

    def lacking_torque_Nm(self, has_accessories: bool) -> float:
        """Return `unreported_torque_Nm`, or what accessories and the gearbox of such a vehicle take at most.

        has_accessories: whether those of an engine, and several gears, are between the torque and the wheels.
        """
        if self.unreported_torque_Nm is not None:
            return self.unreported_torque_Nm
        return _LEAST_NM + (_PER_TONNE_NM * self.mass_max_kg / 1000.0 if has_accessories else 0.0)

    @model_validator(mode="after")
    def _consistent(self) -> Vehicle:
        if self.mass_min_kg >= self.mass_max_kg:
            raise MisplacedError(
                f"found {self.mass_min_kg:g}, expected less than mass_max_kg, {self.mass_max_kg:g}",
                "mass_min_kg",
            )
        for gear, ratio in self.gear_ratios.items():
            if gear in NOTHING_ENGAGED:
                raise MisplacedError(
                    f"{'park' if gear else 'neutral'} has no ratio, found {ratio:g}, expected no such entry: "
                    "gears count from 1, reverse ones from -1 down",
                    "gear_ratios",
                    gear,
                )
            if not 0.1 < ratio < 50:
                raise MisplacedError(f"found {ratio:g}, expected between 0.1 and 50", "gear_ratios", gear)
        for gear, efficiency in self.gear_efficiency.items():
            if not 0.5 < efficiency <= 1:
                raise MisplacedError(
                    f"found {efficiency:g}, expected above 0.5 and up to 1", "gear_efficiency", gear
                )
        return self
