"""Effects: each thing a vehicle may have that the plain model lacks, as one small class.

A config lists them, live, replay and diagnosis read the same list. An effect changes the model's working
columns; its regressor (what the diagnosis fits) is the change of the model's output per unit of its
parameter, so nothing about an effect is written down twice. At its neutral value it changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import NoneType
from typing import Any, ClassVar, Literal, get_args, get_type_hints

import numpy as np

from canest.errors import ConfigError
from canest.frames import BoolColumn
from canest.vehicle.columns import Columns
from canest.vehicle.samples import GRAVITY_MPS2

Stage = Literal["sampling", "geometry", "crank", "driveline", "speed", "road", "load"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an effect: unit, value of no effect, bounds, and a typical step."""

    unit: str
    neutral: float
    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Effect:
    """Base of all effects; subclasses are registered by their `name`."""

    name: ClassVar[str] = ""
    stage: ClassVar[Stage] = "road"
    text: ClassVar[str] = ""
    #: what the diagnosis may fit
    parameters: ClassVar[dict[str, Parameter]] = {}
    #: further numbers of a config entry, with their bounds
    settings: ClassVar[dict[str, Parameter]] = {}

    @property
    def signal(self) -> str | None:
        """Return the role that drives this effect, when it needs one of its own."""
        return None

    def apply(self, c: Columns) -> None:
        """Change the working columns (in place of their arrays, never inside them)."""

    def to_config(self) -> dict[str, Any]:
        """Return this effect as an entry of a config's ``effects:`` list."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {"effect": self.name} | {
            k.removeprefix("on_"): v for k, v in values.items() if v is not None or k in self.parameters
        }


EFFECTS: dict[str, type[Effect]] = {}


def _register(cls: type[Effect]) -> type[Effect]:
    EFFECTS[cls.name] = cls
    return cls


def effect_from_config(entry: Mapping[str, Any], where: str = "effects") -> Effect:
    """Build an effect from its config entry.

    Errors: ConfigError for an unknown effect, key, or a value out of bounds.
    """
    values = dict(entry)
    name = values.pop("effect", None)
    cls = EFFECTS.get(str(name))
    if cls is None:
        raise ConfigError(
            "unknown effect", where=where, found=str(name), expected="one of " + ", ".join(EFFECTS)
        )
    hints = get_type_hints(cls)
    known = {f.name.removeprefix("on_"): f.name for f in fields(cls)}
    for key, value in values.items():
        if key not in known:
            raise ConfigError(
                f"{name}: unknown key {key}", where=where, expected="one of " + ", ".join(sorted(known))
            )
        _check(f"{name}.{key}", value, hints[known[key]], {**cls.parameters, **cls.settings}.get(key), where)
    return cls(**{known[key]: value for key, value in values.items()})


def _check(what: str, value: Any, hint: Any, bounds: Parameter | None, where: str) -> None:
    """Refuse a value that is not of its field's type, or not within its bounds."""
    kinds = {*get_args(hint)} or {hint}
    if value is None and NoneType in kinds:
        return
    if bounds is not None:
        wanted = f"{bounds.low:g} to {bounds.high:g} {bounds.unit}".strip()
        fits = isinstance(value, int | float) and bounds.low <= value <= bounds.high
    else:
        wanted = "a whole number" if int in kinds else "a name"
        fits = isinstance(value, tuple(kinds))
    if not fits or isinstance(value, bool):
        raise ConfigError(what, where=where, found=value, expected=wanted)


@dataclass(frozen=True)
class _Added(Effect):
    """Adds its one parameter to a working column (or takes it off)."""

    column: ClassVar[str]
    sign: ClassVar[float] = 1.0

    def apply(self, c: Columns) -> None:
        """Add to the column."""
        (parameter,) = self.parameters
        setattr(c, self.column, getattr(c, self.column) + self.sign * getattr(self, parameter))


@dataclass(frozen=True)
class _Scaled(Effect):
    """Scales a working column by its one parameter."""

    column: ClassVar[str]

    def apply(self, c: Columns) -> None:
        """Scale the column."""
        (parameter,) = self.parameters
        setattr(c, self.column, getattr(c, self.column) * getattr(self, parameter))


@_register
@dataclass(frozen=True)
class Headwind(_Added):
    """Air moves against the vehicle."""

    name: ClassVar[str] = "headwind"
    text: ClassVar[str] = "steady wind, positive against the motion"
    column: ClassVar[str] = "wind_mps"
    parameters: ClassVar[dict[str, Parameter]] = {"wind_mps": Parameter("m/s", 0.0, -30.0, 30.0, 1.0)}
    wind_mps: float = 0.0


@_register
@dataclass(frozen=True)
class DragArea(_Added):
    """More (or less) drag area than declared."""

    name: ClassVar[str] = "drag_area"
    text: ClassVar[str] = "drag area Cd A beyond the config's"
    column: ClassVar[str] = "drag_area_m2"
    parameters: ClassVar[dict[str, Parameter]] = {"cda_delta_m2": Parameter("m2", 0.0, -3.0, 20.0, 0.3)}
    cda_delta_m2: float = 0.0


@_register
@dataclass(frozen=True)
class RollingResistance(_Added):
    """A higher (or lower) rolling resistance coefficient."""

    name: ClassVar[str] = "rolling_resistance"
    text: ClassVar[str] = "rolling resistance coefficient beyond the config's"
    column: ClassVar[str] = "mu"
    parameters: ClassVar[dict[str, Parameter]] = {"crr_delta": Parameter("", 0.0, -0.02, 0.1, 0.0005)}
    crr_delta: float = 0.0


@_register
@dataclass(frozen=True)
class RollingResistanceSpeed(Effect):
    """Rolling resistance that grows with speed."""

    name: ClassVar[str] = "rolling_resistance_speed"
    text: ClassVar[str] = "rolling resistance coefficient added per m/s"
    parameters: ClassVar[dict[str, Parameter]] = {"crr_per_mps": Parameter("s/m", 0.0, -0.002, 0.005, 2e-5)}
    crr_per_mps: float = 0.0

    def apply(self, c: Columns) -> None:
        """Add to mu in proportion to speed."""
        c.mu = c.mu + self.crr_per_mps * c.speed_mps


#: ambient temperature at which a config's rolling resistance holds, degC
ROLLING_REFERENCE_DEGC = 20.0


@_register
@dataclass(frozen=True)
class RollingResistanceTemperature(Effect):
    """Tyres and oil roll harder in the cold."""

    name: ClassVar[str] = "rolling_resistance_temperature"
    text: ClassVar[str] = "rolling resistance coefficient added per kelvin below 20 degC"
    parameters: ClassVar[dict[str, Parameter]] = {"crr_per_K": Parameter("1/K", 0.0, -0.001, 0.001, 1e-5)}
    crr_per_K: float = 0.0

    @property
    def signal(self) -> str | None:
        """Return the ambient temperature's role."""
        return "ambient_temperature"

    def apply(self, c: Columns) -> None:
        """Add to mu; nothing while the temperature is not known."""
        below = ROLLING_REFERENCE_DEGC - c.signal("ambient_temperature", missing=ROLLING_REFERENCE_DEGC)
        c.mu = c.mu + self.crr_per_K * below


@_register
@dataclass(frozen=True)
class RollingWarmup(Effect):
    """Cold tyres roll harder until they are warm."""

    name: ClassVar[str] = "rolling_warmup"
    text: ClassVar[str] = "rolling resistance coefficient added at the start, decaying"
    parameters: ClassVar[dict[str, Parameter]] = {
        "crr_cold": Parameter("", 0.0, 0.0, 0.05, 0.0005),
        "tau_s": Parameter("s", 300.0, 10.0, 7200.0, 30.0),
    }
    crr_cold: float = 0.0
    tau_s: float = 300.0

    def apply(self, c: Columns) -> None:
        """Add to mu, decaying with the time since the start."""
        c.mu = c.mu + self.crr_cold * np.exp(-c.elapsed_s / self.tau_s)


@_register
@dataclass(frozen=True)
class TorqueGain(_Scaled):
    """The engine gives another torque than it reports, in proportion."""

    name: ClassVar[str] = "torque_gain"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "true over reported net torque"
    column: ClassVar[str] = "torque_Nm"
    parameters: ClassVar[dict[str, Parameter]] = {"gain": Parameter("", 1.0, 0.3, 2.0, 0.01)}
    gain: float = 1.0


@_register
@dataclass(frozen=True)
class TorqueOffset(_Added):
    """Something takes a constant torque at the crank."""

    name: ClassVar[str] = "torque_offset"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "torque lost at the crank"
    column: ClassVar[str] = "torque_Nm"
    sign: ClassVar[float] = -1.0
    parameters: ClassVar[dict[str, Parameter]] = {"torque_Nm": Parameter("Nm", 0.0, -1000.0, 1000.0, 10.0)}
    torque_Nm: float = 0.0


@_register
@dataclass(frozen=True)
class TorqueDelay(Effect):
    """Torque is reported later than it acts (the grid waits for it: see `canest.grid`)."""

    name: ClassVar[str] = "torque_delay"
    stage: ClassVar[Stage] = "sampling"
    text: ClassVar[str] = "torque reported this much later than it acts"
    parameters: ClassVar[dict[str, Parameter]] = {"delay_s": Parameter("s", 0.0, 0.0, 1.0, 0.04)}
    delay_s: float = 0.0


@_register
@dataclass(frozen=True)
class DrivelineLoss(Effect):
    """Traction lost beyond the declared efficiency, in one gear or in all."""

    name: ClassVar[str] = "driveline_loss"
    stage: ClassVar[Stage] = "driveline"
    text: ClassVar[str] = "fraction of traction lost beyond the config's efficiency"
    parameters: ClassVar[dict[str, Parameter]] = {"loss": Parameter("", 0.0, -0.03, 0.5, 0.01)}
    loss: float = 0.0
    gear: int | None = None

    def apply(self, c: Columns) -> None:
        """Scale the efficiency where the gear matches."""
        here = 1.0 if self.gear is None else (c.gear == self.gear)
        c.efficiency = c.efficiency * (1.0 - self.loss * here)


@_register
@dataclass(frozen=True)
class WheelRadius(_Scaled):
    """The rolling radius is not the declared one."""

    name: ClassVar[str] = "wheel_radius"
    stage: ClassVar[Stage] = "geometry"
    text: ClassVar[str] = "true over declared rolling radius"
    column: ClassVar[str] = "radius_m"
    parameters: ClassVar[dict[str, Parameter]] = {"factor": Parameter("", 1.0, 0.7, 1.3, 0.005)}
    factor: float = 1.0


@_register
@dataclass(frozen=True)
class RotatingInertia(_Added):
    """More rotating inertia at the crank than declared."""

    name: ClassVar[str] = "rotating_inertia"
    stage: ClassVar[Stage] = "driveline"
    text: ClassVar[str] = "rotating inertia added at the crank"
    column: ClassVar[str] = "crank_inertia_kgm2"
    parameters: ClassVar[dict[str, Parameter]] = {"inertia_kgm2": Parameter("kgm2", 0.0, -1.0, 50.0, 0.5)}
    inertia_kgm2: float = 0.0


@_register
@dataclass(frozen=True)
class BrakeDrag(_Added):
    """A brake that does not quite release."""

    name: ClassVar[str] = "brake_drag"
    text: ClassVar[str] = "constant force against the motion"
    column: ClassVar[str] = "extra_N"
    sign: ClassVar[float] = -1.0
    parameters: ClassVar[dict[str, Parameter]] = {"force_N": Parameter("N", 0.0, 0.0, 20000.0, 100.0)}
    force_N: float = 0.0


#: accelerator position below which a pedal counts as up, %: less than half a step of SPN 91
PEDAL_UP_PCT = 0.2


@_register
@dataclass(frozen=True)
class RetarderUnreported(Effect):
    """An engine brake or retarder that acts without reporting its torque."""

    name: ClassVar[str] = "retarder_unreported"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "retarding torque at the crank while its cause is on"
    parameters: ClassVar[dict[str, Parameter]] = {"torque_Nm": Parameter("Nm", 0.0, 0.0, 5000.0, 50.0)}
    torque_Nm: float = 0.0
    #: pedal_up, brake, or the name of a role that is on (above 0.5) while it acts
    cause: str = "pedal_up"

    @property
    def signal(self) -> str | None:
        """Return the role behind the cause."""
        return {"pedal_up": "accelerator", "brake": "brake_switch"}.get(self.cause, self.cause)

    def active(self, c: Columns) -> BoolColumn:
        """Return where the cause is on."""
        if self.cause == "pedal_up":
            return c.signal("accelerator", missing=100.0) < PEDAL_UP_PCT
        return c.on(self.signal or "")

    def apply(self, c: Columns) -> None:
        """Take it off the net torque while the cause is on."""
        c.torque_Nm = c.torque_Nm - self.torque_Nm * self.active(c)


@_register
@dataclass(frozen=True)
class CorneringDrag(Effect):
    """Tyres that corner also drag."""

    name: ClassVar[str] = "cornering_drag"
    text: ClassVar[str] = "force per kg per (speed x yaw rate) squared"
    parameters: ClassVar[dict[str, Parameter]] = {"coefficient_s2pm": Parameter("s2/m", 0.0, 0.0, 2.0, 0.005)}
    coefficient_s2pm: float = 0.0

    @property
    def signal(self) -> str | None:
        """Return the yaw rate's role."""
        return "yaw_rate"

    def apply(self, c: Columns) -> None:
        """Add to mu: like rolling resistance it is a force in proportion to mass."""
        c.mu = c.mu + self.coefficient_s2pm / GRAVITY_MPS2 * (c.speed_mps * c.signal("yaw_rate")) ** 2


@_register
@dataclass(frozen=True)
class WheelSlip(Effect):
    """Driven wheels turn faster than the road passes, in proportion to their traction."""

    name: ClassVar[str] = "wheel_slip"
    stage: ClassVar[Stage] = "speed"
    text: ClassVar[str] = "driven-wheel slip per m/s2 of traction"
    parameters: ClassVar[dict[str, Parameter]] = {"slip_per_mps2": Parameter("s2/m", 0.0, 0.0, 0.2, 0.002)}
    slip_per_mps2: float = 0.0
    settings: ClassVar[dict[str, Parameter]] = {"mass_kg": Parameter("kg", 0.0, 50.0, 500_000.0, 1000.0)}
    #: mass by which traction becomes an acceleration; None: the geometric mean of the config's bounds
    mass_kg: float | None = None

    def apply(self, c: Columns) -> None:
        """Take the slip off the speed measured at the driven wheels."""
        mass = c.notes["nominal_mass_kg"] if self.mass_kg is None else self.mass_kg
        c.speed_mps = c.speed_mps * (1.0 - self.slip_per_mps2 * c.notes["traction_N"] / mass)


@_register
@dataclass(frozen=True)
class SwitchedLoad(Effect):
    """Something takes power at the crank while a signal (fan, compressor, PTO) is on."""

    name: ClassVar[str] = "switched_load"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "power taken at the crank while a signal or a regime is on"
    parameters: ClassVar[dict[str, Parameter]] = {"power_kW": Parameter("kW", 0.0, 0.0, 400.0, 2.0)}
    settings: ClassVar[dict[str, Parameter]] = {
        "threshold": Parameter("", 0.5, -1e6, 1e6, 0.1),
        "exponent": Parameter("", 0.0, -3.0, 3.0, 1.0),
        "reference_rpm": Parameter("rpm", 1500.0, 100.0, 20_000.0, 100.0),
    }
    power_kW: float = 0.0
    #: the role that switches it (as the signal map names it)
    on_signal: str | None = None
    #: on above this value of the signal
    threshold: float = 0.5
    #: power follows engine speed to this power, `power_kW` at `reference_rpm` (3 for a fan, 0 constant)
    exponent: float = 0.0
    reference_rpm: float = 1500.0

    @property
    def signal(self) -> str | None:
        """Return the switching role."""
        return self.on_signal

    def apply(self, c: Columns) -> None:
        """Take power / speed off the net torque while on."""
        if self.on_signal is None:
            return
        # below idle there is no power to take: bounds the torque while the engine starts or stops
        speed = np.maximum(c.engine_radps, 50.0)
        reference = self.reference_rpm * np.pi / 30
        power_W = 1000.0 * self.power_kW * (speed / reference) ** self.exponent
        c.torque_Nm = c.torque_Nm - power_W / speed * c.on(self.on_signal, self.threshold)


@_register
@dataclass(frozen=True)
class PayloadChange(Effect):
    """The load changes during a stop: a note to the estimator, not a force."""

    name: ClassVar[str] = "payload_change"
    stage: ClassVar[Stage] = "load"
    text: ClassVar[str] = "mass added at a stop"
    parameters: ClassVar[dict[str, Parameter]] = {
        "mass_delta_kg": Parameter("kg", 0.0, -100_000.0, 100_000.0, 100.0),
        "t_s": Parameter("s", 0.0, -1e12, 1e12, 1.0),
    }
    mass_delta_kg: float = 0.0
    t_s: float = 0.0
