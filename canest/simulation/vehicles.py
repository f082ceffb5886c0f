"""The vehicles that can be simulated: what is built, and what of it an engineer would know."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator


class Strict(BaseModel):
    """Base of every scenario part: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _from_to(span: tuple[float, float]) -> tuple[float, float]:
    if not 0 <= span[0] <= span[1]:
        raise ValueError(f"found {list(span)}, expected two numbers from 0 on, the smaller first")
    return span


def _not_nothing(span: tuple[float, float]) -> tuple[float, float]:
    if span[1] == 0:
        raise ValueError("found [0, 0], expected a second number above 0")
    return span


def _increasing(at: list[float]) -> list[float]:
    if not at or any(b < a for a, b in pairwise(at)):
        raise ValueError(f"found {at}, expected numbers that do not decrease")
    return at


#: what is drawn between the two, uniformly; and what a drive or a road goes on by
Range = Annotated[tuple[float, float], AfterValidator(_from_to)]
Stretch = Annotated[Range, AfterValidator(_not_nothing)]
#: where the points of a curve lie
Increasing = Annotated[list[float], AfterValidator(_increasing)]


def same_length(at: list[float], **columns: list[Any] | None) -> None:
    """Refuse columns that have not one value for each point. Errors: ValueError."""
    for name, column in columns.items():
        if column is not None and len(column) != len(at):
            raise ValueError(f"found {len(column)} values of {name}, expected {len(at)}, one for each point")


class VehicleSpec(Strict):
    """One vehicle. Everything here is declared unless its comment states otherwise."""

    layout: Literal["j1939", "car"]
    electric: bool = False
    engine_inertia_kgm2: float = Field(gt=0)
    reference_torque_Nm: float = Field(gt=0)
    #: (rpm, N m) indicated (combustion) or net (electric), increasing rpm
    full_torque: list[tuple[float, float]] = Field(min_length=2)
    friction_pct: float = Field(0.0, ge=0, le=30)  #: of the reference torque, at standstill
    friction_pct_per_krpm: float = Field(0.0, ge=0)
    regeneration_Nm: float = Field(0.0, ge=0)  #: pedal-up torque of an electric motor
    idle_rpm: float = Field(0.0, ge=0)
    fuelling_s: float = 0.06  #: not declared: torque follows its demand this fast
    boost_s: float = 0.6  #: not declared: turbo lag
    unboosted: float = Field(1.0, gt=0, le=1)  #: not declared: share of the full torque without boost
    gear_ratios: list[Annotated[float, Field(gt=0)]] = Field(min_length=1)
    gear_efficiencies: list[Annotated[float, Field(gt=0, le=1)]]  #: gearbox to wheels
    final_drive: float = Field(gt=0)
    wheel_radius_m: float = Field(gt=0)
    wheel_inertia_kgm2: float = Field(ge=0)  #: all wheels
    cda_m2: float = Field(ge=0)
    air_density_kgpm3: float = 1.184
    crr: float = Field(ge=0)
    stiffness_Nm: float = Field(gt=0)  #: not declared: driveline twist at the wheels, N m per rad
    damping: float = 0.7  #: not declared: damping ratio of that twist
    upshift_rpm: tuple[float, float] = (0.0, 0.0)  #: at no and at full pedal
    downshift_rpm: float = 0.0
    torque_ramp_s: float = 0.2
    neutral_s: float = 0.4  #: shortest time out of gear in a shift
    retarder_Nm: float = Field(300.0, gt=0)  #: engine brake at the crank, and its reference (trucks)
    accel_limit_mps2: float = 2.0  #: launch torque is limited to this
    pitch_rad_per_mps2: float = 0.01
    pitch_hz: float = 1.3  #: not declared
    wheelbase_m: float = 5.0
    steering_ratio: float = 20.0

    @model_validator(mode="after")
    def _gears_agree(self) -> VehicleSpec:
        if len(self.gear_ratios) != len(self.gear_efficiencies):
            raise ValueError("gear_ratios and gear_efficiencies differ in length")
        if any(b[0] <= a[0] for a, b in pairwise(self.full_torque)):
            raise ValueError("full_torque needs increasing speeds")
        return self


_CLASS8: dict[str, Any] = {
    "layout": "j1939",
    "engine_inertia_kgm2": 3.2,
    "reference_torque_Nm": 2100.0,
    "full_torque": [(500, 1000), (800, 1450), (1050, 2100), (1400, 2100), (1700, 1850), (1900, 1600),
                    (2100, 900), (2250, 0)],
    "friction_pct": 6.5,
    "friction_pct_per_krpm": 1.8,
    "idle_rpm": 620.0,
    "unboosted": 0.45,
    "gear_ratios": [12.69, 9.29, 6.75, 4.90, 3.62, 2.59, 1.90, 1.38, 1.00, 0.74],
    "gear_efficiencies": [0.96] * 8 + [0.98, 0.96],
    "final_drive": 3.73,
    "wheel_radius_m": 0.5,
    "wheel_inertia_kgm2": 130.0,
    "cda_m2": 6.4,
    "crr": 0.006,
    "stiffness_Nm": 160e3,
    "upshift_rpm": (1350.0, 1750.0),
    "downshift_rpm": 1000.0,
    "retarder_Nm": 1500.0,
}  # fmt: skip

_LIGHT_TRUCK: dict[str, Any] = _CLASS8 | {
    "engine_inertia_kgm2": 1.1,
    "reference_torque_Nm": 850.0,
    "full_torque": [(550, 380), (900, 600), (1250, 850), (1700, 850), (2200, 720), (2600, 480), (2800, 0)],
    "friction_pct": 7.0,
    "friction_pct_per_krpm": 2.0,
    "idle_rpm": 700.0,
    "gear_ratios": [6.70, 3.81, 2.29, 1.48, 1.00, 0.73],
    "gear_efficiencies": [0.95, 0.95, 0.95, 0.95, 0.97, 0.95],
    "final_drive": 4.10,
    "wheel_radius_m": 0.40,
    "wheel_inertia_kgm2": 32.0,
    "cda_m2": 4.9,
    "crr": 0.0075,
    "stiffness_Nm": 45e3,
    "upshift_rpm": (1700.0, 2300.0),
    "downshift_rpm": 1150.0,
    "retarder_Nm": 300.0,
    "wheelbase_m": 3.9,
}

_CAR: dict[str, Any] = {
    "layout": "car",
    "engine_inertia_kgm2": 0.18,
    "reference_torque_Nm": 400.0,
    "full_torque": [(600, 150), (1200, 260), (1800, 400), (4500, 400), (5800, 330), (6500, 0)],
    "friction_pct": 5.0,
    "friction_pct_per_krpm": 1.2,
    "idle_rpm": 750.0,
    "boost_s": 0.35,
    "unboosted": 0.6,
    "gear_ratios": [4.17, 2.34, 1.52, 1.14, 0.87, 0.69],
    "gear_efficiencies": [0.94] * 6,
    "final_drive": 3.55,
    "wheel_radius_m": 0.33,
    "wheel_inertia_kgm2": 4.8,
    "cda_m2": 0.72,
    "crr": 0.011,
    "stiffness_Nm": 12e3,
    "upshift_rpm": (2000.0, 5200.0),
    "downshift_rpm": 1300.0,
    "torque_ramp_s": 0.12,
    "neutral_s": 0.2,
    "accel_limit_mps2": 4.0,
    "pitch_rad_per_mps2": 0.006,
    "pitch_hz": 1.6,
    "wheelbase_m": 2.9,
    "steering_ratio": 16.0,
}

_ELECTRIC_CAR: dict[str, Any] = _CAR | {
    "electric": True,
    "engine_inertia_kgm2": 0.045,
    "reference_torque_Nm": 250.0,
    "full_torque": [(0, 250), (4700, 250), (7000, 168), (9500, 118), (11500, 60), (12000, 0)],
    "friction_pct": 0.0,
    "friction_pct_per_krpm": 0.0,
    "regeneration_Nm": 90.0,
    "idle_rpm": 0.0,
    "fuelling_s": 0.03,
    "unboosted": 1.0,
    "gear_ratios": [9.70],
    "gear_efficiencies": [0.97],
    "final_drive": 1.0,
    "wheel_radius_m": 0.345,
    "wheel_inertia_kgm2": 4.0,
    "cda_m2": 0.69,
    "crr": 0.009,
    "stiffness_Nm": 8e3,
    "wheelbase_m": 2.57,
}

PRESETS: dict[str, dict[str, Any]] = {
    "class8": _CLASS8,
    "light-truck": _LIGHT_TRUCK,
    "car": _CAR,
    "electric-car": _ELECTRIC_CAR,
}


def vehicle_with(preset: str, overrides: dict[str, Any]) -> VehicleSpec:
    """Return a preset with some of its values replaced (validated; ValueError names a wrong key)."""
    if preset not in PRESETS:
        raise ValueError(f"no vehicle preset {preset!r}, expected one of {', '.join(PRESETS)}")
    return VehicleSpec.model_validate(PRESETS[preset] | overrides)
