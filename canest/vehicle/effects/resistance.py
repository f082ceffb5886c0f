"""What the road and the air take: wind, drag, tyres, brakes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from canest.core.samples import GRAVITY_MPS2
from canest.vehicle.effects.base import Added, Effect, Parameter
from canest.vehicle.effects.trials import DrivenData, Trial
from canest.vehicle.working_columns import ModelColumns


@dataclass(frozen=True)
class Headwind(Added):
    """Air moves against the vehicle."""

    name: ClassVar[str] = "headwind"
    words: ClassVar[str] = "wind"
    text: ClassVar[str] = "steady wind, positive against the motion"
    column: ClassVar[str] = "wind_mps"
    rarity: ClassVar[int] = 20
    cause_quantity: ClassVar[str] = "speed"
    separated_by: ClassVar[str] = "the same road in the other direction"
    parameters: ClassVar[dict[str, Parameter]] = {
        "wind_mps": Parameter("m/s", 0.0, -30.0, 30.0, 1.0, usual=3.0, fault=6.0)
    }
    wind_mps: float = 0.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        if self.wind_mps >= 0:
            return f"a headwind of {self.amount(std)}"
        return f"a tailwind of {-self.wind_mps:.3g} ± {std:.1g} m/s"


@dataclass(frozen=True)
class DragArea(Added):
    """More (or less) drag area than declared."""

    name: ClassVar[str] = "drag_area"
    text: ClassVar[str] = "drag area Cd A beyond the config's"
    column: ClassVar[str] = "drag_area_m2"
    rarity: ClassVar[int] = 90
    cause_quantity: ClassVar[str] = "speed"
    separated_by: ClassVar[str] = "a drive with long stretches at very different speeds"
    parameters: ClassVar[dict[str, Parameter]] = {
        "cda_delta_m2": Parameter("m2", 0.0, -3.0, 20.0, 0.3, "drag_area_m2", fault_share=0.4)
    }
    cda_delta_m2: float = 0.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        size = "larger" if self.cda_delta_m2 >= 0 else "smaller"
        return f"a drag area {abs(self.cda_delta_m2):.3g} ± {std:.1g} m2 {size} than declared"


@dataclass(frozen=True)
class RollingResistance(Added):
    """A higher (or lower) rolling resistance coefficient."""

    name: ClassVar[str] = "rolling_resistance"
    urgency: ClassVar[int] = 1
    text: ClassVar[str] = "rolling resistance coefficient beyond the config's"
    column: ClassVar[str] = "mu"
    rarity: ClassVar[int] = 40
    cause_quantity: ClassVar[str] = "speed"
    separated_by: ClassVar[str] = "the same road with another load"
    parameters: ClassVar[dict[str, Parameter]] = {
        "crr_delta": Parameter(
            "", 0.0, -0.02, 0.1, 0.0005, "rolling_resistance", usual_share=0.15, fault_share=0.5
        )
    }
    crr_delta: float = 0.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"a rolling resistance coefficient {self.crr_delta:+.2g} ± {std:.1g} beside the declared"


@dataclass(frozen=True)
class RollingResistanceSpeed(Effect):
    """Rolling resistance that grows with speed."""

    name: ClassVar[str] = "rolling_resistance_speed"
    words: ClassVar[str] = "speed-dependent rolling resistance"
    text: ClassVar[str] = "rolling resistance coefficient added per m/s"
    rarity: ClassVar[int] = 170
    cause_quantity: ClassVar[str] = "speed"
    separated_by: ClassVar[str] = "the same road in the other direction (wind turns round, tyres do not)"
    parameters: ClassVar[dict[str, Parameter]] = {
        "crr_per_mps": Parameter("s/m", 0.0, -0.002, 0.005, 2e-5, fault=2e-4)
    }
    crr_per_mps: float = 0.0

    def apply(self, c: ModelColumns) -> None:
        """Add to mu in proportion to speed."""
        c.mu = c.mu + self.crr_per_mps * c.speed_mps

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"rolling resistance that grows by {self.amount(std)} with speed"


#: ambient temperature at which a config's rolling resistance holds, degC
ROLLING_REFERENCE_DEGC = 20.0
#: drives must differ so much in temperature before its effect can be seen
MIN_TEMPERATURE_SPAN_K = 5.0
#: warm-up times that the diagnosis tries, s
WARMUP_TAUS_S = (120.0, 300.0, 600.0, 1200.0)


@dataclass(frozen=True)
class RollingResistanceTemperature(Effect):
    """Tyres and oil roll harder in the cold."""

    name: ClassVar[str] = "rolling_resistance_temperature"
    text: ClassVar[str] = "rolling resistance coefficient added per kelvin below 20 degC"
    rarity: ClassVar[int] = 140
    separated_by: ClassVar[str] = "drives in summer and in winter"
    untried_reason: ClassVar[str] = "the ambient temperature is not known, or the same in all drives"
    parameters: ClassVar[dict[str, Parameter]] = {
        "crr_per_K": Parameter("1/K", 0.0, -0.001, 0.001, 1e-5, fault=3e-4)
    }
    crr_per_K: float = 0.0

    @property
    def signal(self) -> str | None:
        """Return the ambient temperature's role."""
        return "ambient_temperature"

    def apply(self, c: ModelColumns) -> None:
        """Add to mu; nothing while the temperature is not known."""
        below = ROLLING_REFERENCE_DEGC - c.signal("ambient_temperature", missing=ROLLING_REFERENCE_DEGC)
        c.mu = c.mu + self.crr_per_K * below

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it where the drives differ enough in temperature."""
        return [Trial(cls.name)] if drives.temperature_span_K > MIN_TEMPERATURE_SPAN_K else []

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"rolling resistance that grows by {self.crr_per_K:.2g} ± {std:.1g} per kelvin below 20 °C"


@dataclass(frozen=True)
class RollingWarmup(Effect):
    """Cold tyres roll harder until they are warm."""

    name: ClassVar[str] = "rolling_warmup"
    words: ClassVar[str] = "cold tyres"
    text: ClassVar[str] = "rolling resistance coefficient added at the start, decaying"
    rarity: ClassVar[int] = 130
    cause_quantity: ClassVar[str] = "time"
    separated_by: ClassVar[str] = "a drive that starts warm"
    parameters: ClassVar[dict[str, Parameter]] = {
        "crr_cold": Parameter("", 0.0, 0.0, 0.05, 0.0005, fault=0.006),
        "tau_s": Parameter("s", 300.0, 10.0, 7200.0, 30.0),
    }
    crr_cold: float = 0.0
    tau_s: float = 300.0

    def apply(self, c: ModelColumns) -> None:
        """Add to mu, decaying with the time since the start."""
        c.mu = c.mu + self.crr_cold * np.exp(-c.elapsed_s / self.tau_s)

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it with some warm-up times."""
        return [Trial(f"{cls.name} tau {tau:g} s", (("tau_s", tau),)) for tau in WARMUP_TAUS_S]

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return (
            f"cold tyres: {self.crr_cold:.2g} ± {std:.1g} more rolling resistance at the start, "
            f"gone with {self.tau_s:.0f} s"
        )


@dataclass(frozen=True)
class BrakeDrag(Added):
    """A brake that does not quite release."""

    name: ClassVar[str] = "brake_drag"
    words: ClassVar[str] = "a dragging brake"
    urgency: ClassVar[int] = 2
    text: ClassVar[str] = "constant force against the motion"
    column: ClassVar[str] = "extra_N"
    sign: ClassVar[float] = -1.0
    rarity: ClassVar[int] = 150
    cause_quantity: ClassVar[str] = "speed"
    separated_by: ClassVar[str] = "the same road with another load"
    parameters: ClassVar[dict[str, Parameter]] = {
        "force_N": Parameter("N", 0.0, 0.0, 20000.0, 100.0, fault=1500.0)
    }
    force_N: float = 0.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"a dragging brake of {self.amount(std)}"


@dataclass(frozen=True)
class CorneringDrag(Effect):
    """Tyres that corner also drag."""

    name: ClassVar[str] = "cornering_drag"
    text: ClassVar[str] = "force per kg per (speed x yaw rate) squared"
    rarity: ClassVar[int] = 120
    cause_quantity: ClassVar[str] = "lateral_acceleration"
    separated_by: ClassVar[str] = "a drive with more curves"
    parameters: ClassVar[dict[str, Parameter]] = {
        "coefficient_s2pm": Parameter("s2/m", 0.0, 0.0, 2.0, 0.005, fault=0.06)
    }
    coefficient_s2pm: float = 0.0

    @property
    def signal(self) -> str | None:
        """Return the yaw rate's role."""
        return "yaw_rate"

    def apply(self, c: ModelColumns) -> None:
        """Add to mu: like rolling resistance it is a force in proportion to mass."""
        c.mu = c.mu + self.coefficient_s2pm / GRAVITY_MPS2 * (c.speed_mps * c.signal("yaw_rate")) ** 2
