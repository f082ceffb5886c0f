"""What the truth has and the config does not know: the effects, and the small errors of every vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from canest.core.errors import ConfigError
from canest.simulation.vehicles import Strict


class Headwind(Strict):
    """Steady wind, positive against the motion."""

    effect: Literal["headwind"]
    wind_mps: float


class DragArea(Strict):
    """Added to the declared drag area."""

    effect: Literal["drag_area"]
    cda_delta_m2: float


class RollingResistance(Strict):
    """Added to the declared rolling resistance coefficient."""

    effect: Literal["rolling_resistance"]
    crr_delta: float


class RollingResistanceSpeed(Strict):
    """Rolling resistance coefficient added per m/s."""

    effect: Literal["rolling_resistance_speed"]
    crr_per_mps: float


class RollingWarmup(Strict):
    """Rolling resistance coefficient added at the start, decaying."""

    effect: Literal["rolling_warmup"]
    crr_cold: float
    tau_s: float = Field(gt=0)


class TorqueGain(Strict):
    """True over reported net torque."""

    effect: Literal["torque_gain"]
    gain: float = Field(gt=0)


class TorqueOffset(Strict):
    """Torque lost at the crank."""

    effect: Literal["torque_offset"]
    torque_Nm: float


class TorqueDelay(Strict):
    """Torque is reported this much later than it acts (on top of the sensors' own delay)."""

    effect: Literal["torque_delay"]
    delay_s: float = Field(ge=0)


class DrivelineLoss(Strict):
    """Fraction of traction lost beyond the declared efficiency, in one gear (1 is the lowest) or in all."""

    effect: Literal["driveline_loss"]
    loss: float = Field(ge=0, lt=1)
    gear: int | None = None


class WheelRadius(Strict):
    """True over declared rolling radius."""

    effect: Literal["wheel_radius"]
    factor: float = Field(gt=0)
    #: which axles' reported speed is wrong: an undriven axle may roll on tyres that are as declared
    axles: Literal["driven", "all"] = "driven"


class RotatingInertia(Strict):
    """Inertia added at the crank."""

    effect: Literal["rotating_inertia"]
    inertia_kgm2: float


class BrakeDrag(Strict):
    """A constant force against the motion."""

    effect: Literal["brake_drag"]
    force_N: float


class RetarderUnreported(Strict):
    """Engine brake that acts at the crank while its cause is on and that nobody reports."""

    effect: Literal["retarder_unreported"]
    torque_Nm: float
    cause: Literal["pedal_up", "brake"] = "pedal_up"


class CorneringDrag(Strict):
    """Force per kg per (speed x yaw rate) squared."""

    effect: Literal["cornering_drag"]
    coefficient_s2pm: float


class WheelSlip(Strict):
    """Driven-wheel slip per m/s2 of traction."""

    effect: Literal["wheel_slip"]
    slip_per_mps2: float


class SwitchedLoad(Strict):
    """Power taken at the crank, on for `on_s` of every `period_s` seconds; its cause is on the bus."""

    effect: Literal["switched_load"]
    power_kW: float
    signal: Literal["fan_speed", "pto_state"] = "fan_speed"
    law: Literal["constant", "cubic"] = "constant"  #: cubic: with engine speed, `power_kW` at `at_rpm`
    at_rpm: float = Field(1500.0, gt=0)
    period_s: float = Field(97.0, gt=0)
    on_s: float = Field(41.0, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _from_config_entry(cls, given: Any) -> Any:
        """Take an entry of a config's `effects:` too; its threshold lies between off and on, 0 and 100 %."""
        if not isinstance(given, dict) or "exponent" not in given:
            return given
        entry = {k: v for k, v in given.items() if k not in ("exponent", "reference_rpm", "threshold")}
        laws = {0: "constant", 3: "cubic"}
        if given["exponent"] not in laws:
            raise ValueError(f"found exponent {given['exponent']}, expected 0 or 3")
        return {"law": laws[given["exponent"]], "at_rpm": given.get("reference_rpm", 1500.0)} | entry


class PayloadChange(Strict):
    """Mass added at the first standstill at or after `t_s`."""

    effect: Literal["payload_change"]
    mass_delta_kg: float
    t_s: float


class Drafting(Strict):
    """Drag area reduced by a fraction now and then, behind another vehicle (no effect of the vocabulary)."""

    effect: Literal["drafting"]
    reduction: float = Field(gt=0, lt=1)
    period_s: float = Field(60.0, gt=0)  #: mean length of a stretch, behind a vehicle or alone


Effect = Annotated[
    Headwind | DragArea | RollingResistance | RollingResistanceSpeed | RollingWarmup | TorqueGain
    | TorqueOffset | TorqueDelay | DrivelineLoss | WheelRadius | RotatingInertia | BrakeDrag
    | RetarderUnreported | CorneringDrag | WheelSlip | SwitchedLoad | PayloadChange | Drafting,
    Field(discriminator="effect"),
]  # fmt: skip


class Hidden:
    """All hidden effects of one drive, combined; the neutral values first."""

    def __init__(self, gears: int) -> None:
        self.wind_mps = 0.0
        self.cda_delta_m2 = 0.0
        self.crr_delta = 0.0
        self.crr_per_mps = 0.0
        self.warmups: list[tuple[float, float]] = []
        self.gain = 1.0
        self.torque_loss_Nm = 0.0
        self.delay_s = 0.0
        self.kept = [1.0] * gears
        self.radius_factor = 1.0
        self.undriven_factor = 1.0
        self.inertia_kgm2 = 0.0
        self.drag_N = 0.0
        self.retarder_Nm = {"pedal_up": 0.0, "brake": 0.0}
        self.cornering_s2pm = 0.0
        self.slip_per_mps2 = 0.0
        self.load: SwitchedLoad | None = None
        self.payloads: list[tuple[float, float]] = []
        self.drafting: Drafting | None = None
        self.damping: float | None = None

    def add(self, effect: Any) -> None:
        """Combine one more effect (an `Effect`) into the whole."""
        match effect:
            case Headwind():
                self.wind_mps += effect.wind_mps
            case DragArea():
                self.cda_delta_m2 += effect.cda_delta_m2
            case RollingResistance():
                self.crr_delta += effect.crr_delta
            case RollingResistanceSpeed():
                self.crr_per_mps += effect.crr_per_mps
            case RollingWarmup():
                self.warmups.append((effect.crr_cold, effect.tau_s))
            case TorqueGain():
                self.gain *= effect.gain
            case TorqueOffset():
                self.torque_loss_Nm += effect.torque_Nm
            case TorqueDelay():
                self.delay_s += effect.delay_s
            case DrivelineLoss():
                if effect.gear is not None and not 1 <= effect.gear <= len(self.kept):
                    raise ConfigError(
                        "no such gear", where="undeclared", found=effect.gear,
                        expected=f"1 to {len(self.kept)}",
                    )  # fmt: skip
                self.kept = [
                    kept * (1 - effect.loss) if effect.gear in (None, index + 1) else kept
                    for index, kept in enumerate(self.kept)
                ]
            case WheelRadius():
                self.radius_factor *= effect.factor
                self.undriven_factor *= effect.factor if effect.axles == "all" else 1.0
            case RotatingInertia():
                self.inertia_kgm2 += effect.inertia_kgm2
            case BrakeDrag():
                self.drag_N += effect.force_N
            case RetarderUnreported():
                self.retarder_Nm[effect.cause] += effect.torque_Nm
            case CorneringDrag():
                self.cornering_s2pm += effect.coefficient_s2pm
            case WheelSlip():
                self.slip_per_mps2 += effect.slip_per_mps2
            case SwitchedLoad():
                self.load = effect
            case PayloadChange():
                self.payloads.append((effect.t_s, effect.mass_delta_kg))
            case Drafting():
                self.drafting = effect


#: What every vehicle has and nobody declares; half-widths of uniform draws (chosen)
SMALL_TORQUE = 0.02
SMALL_WIND_MPS = 3.0
SMALL_ROLLING = 0.15
SMALL_DELAY_S = 0.04
SMALL_SLIP_PER_MPS2 = 0.006
LEAST_SLIP = 0.2  #: share of the highest
OSCILLATING_DAMPING = 0.12


def small_errors(crr: float, rng: np.random.Generator) -> tuple[list[Any], float]:
    """Draw the small errors of one vehicle on one day: the effects, and its driveline's damping ratio."""
    return [
        TorqueGain(effect="torque_gain", gain=1 + rng.uniform(-SMALL_TORQUE, SMALL_TORQUE)),
        Headwind(effect="headwind", wind_mps=rng.uniform(-SMALL_WIND_MPS, SMALL_WIND_MPS)),
        RollingResistance(
            effect="rolling_resistance", crr_delta=crr * rng.uniform(-SMALL_ROLLING, SMALL_ROLLING)
        ),
        TorqueDelay(effect="torque_delay", delay_s=rng.uniform(0, SMALL_DELAY_S)),
        WheelSlip(
            effect="wheel_slip",
            slip_per_mps2=rng.uniform(LEAST_SLIP * SMALL_SLIP_PER_MPS2, SMALL_SLIP_PER_MPS2),
        ),
    ], OSCILLATING_DAMPING


def combine(effects: Sequence[Any], gears: int, damping: float | None = None) -> Hidden:
    """Combine effects into what the truth needs."""
    hidden = Hidden(gears)
    for effect in effects:
        hidden.add(effect)
    hidden.damping = damping
    return hidden
