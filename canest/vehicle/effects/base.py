"""Effects: each thing a vehicle may have that the plain model lacks, as one small class.

An effect is written down once. Its class has how it changes the model's working columns, its parameters with
units and bounds, what it means, which signal drives it, how the diagnosis tries it and how a report speaks of
it. A config lists effects; live, replay and diagnosis read the same list. The diagnosis fits the change of
the model's output per unit of the first parameter. At its neutral value an effect changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf, sqrt
from typing import Any, ClassVar, Literal

from canest.vehicle.effects.trials import DrivenData, Trial
from canest.vehicle.working_columns import ModelColumns

#: where an effect acts, in the order of the model; "sampling" delays the torque, "load" adds mass
Stage = Literal["sampling", "geometry", "crank", "driveline", "speed", "road", "load"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    neutral: the value of no effect. low, high: bounds of a config. step: a change that the model shows, for
    numerical derivatives. declared: the field of the config's ``vehicle`` that it adds to; the sum is never
    negative. usual, usual_share: half-width of what every vehicle has and nobody declares, as a number or as
    a share of ``declared``; 0 for none. fault, fault_share: standard deviation of it among vehicles that have
    it as a fault, likewise; 0 where any size within the bounds is as likely.
    """

    unit: str
    neutral: float
    low: float
    high: float
    step: float
    declared: str = ""
    usual: float = 0.0
    usual_share: float = 0.0
    fault: float = 0.0
    fault_share: float = 0.0

    def lowest(self, vehicle: object) -> float:
        """Return the lower bound for a vehicle: no sum with what it declares is negative."""
        return max(self.low, -float(getattr(vehicle, self.declared))) if self.declared else self.low

    def usual_std(self, vehicle: object) -> float:
        """Return the standard deviation among vehicles and days (of an even distribution), 0 for none."""
        width = self.usual_share * float(getattr(vehicle, self.declared)) if self.usual_share else self.usual
        return width / sqrt(3.0)

    def fault_std(self, vehicle: object) -> float:
        """Return the standard deviation among vehicles that have it as a fault; infinite: not known."""
        share = self.fault_share * float(getattr(vehicle, self.declared)) if self.fault_share else 0.0
        return share or self.fault or inf


@dataclass(frozen=True)
class Effect:
    """Base of all effects. A subclass is a frozen dataclass whose fields have defaults.

    A field is a key of the config's entry under the same name; ``on_signal`` is the key ``signal``.
    """

    #: its name in a config
    name: ClassVar[str] = ""
    stage: ClassVar[Stage] = "road"
    #: what it means, in one line
    text: ClassVar[str] = ""
    #: the first is what the diagnosis fits; the others are its shape
    parameters: ClassVar[dict[str, Parameter]] = {}
    #: further numbers of a config entry, with their bounds
    settings: ClassVar[dict[str, Parameter]] = {}
    #: keys without which the effect does nothing
    required: ClassVar[tuple[str, ...]] = ()

    #: how rare it is: of effects that a drive cannot distinguish, the commonest (lowest) is named first
    rarity: ClassVar[int] = 1000
    #: what is named first of effects that a drive cannot distinguish: 2 a danger, 1 wear, 0 neither
    urgency: ClassVar[int] = 0
    #: it as a part of a sentence, without a number; "" for its name
    words: ClassVar[str] = ""
    #: whether it scales all traction, as an unknown mass does: it is never found beside one
    scales_traction: ClassVar[bool] = False
    #: field that distinguishes several of it in one vehicle; "" where there is one at most
    several_by: ClassVar[str] = ""
    #: quantity that causes it, over which a report draws the residual; "" for its signal, else its force
    cause_quantity: ClassVar[str] = ""
    #: what would separate it from its equivalents; "" where nothing is known
    separated_by: ClassVar[str] = ""
    #: why it was not tried, where `trials` gave nothing; "" for: the signal map does not name its signal
    untried_reason: ClassVar[str] = ""

    @property
    def signal(self) -> str | None:
        """Return the role that drives this effect, when it needs one of its own."""
        return None

    @property
    def caused_by(self) -> str:
        """Return the quantity that causes it: `cause_quantity`, unless its fields name another."""
        return self.cause_quantity

    def apply(self, c: ModelColumns) -> None:
        """Change the working columns (in place of their arrays, never inside them)."""

    @classmethod
    def trials(cls, drives: DrivenData) -> Sequence[Trial]:
        """Return the forms of it that are worth trying on these drives: one, where its signal is mapped."""
        signal = cls().signal
        return [Trial(cls.name)] if signal is None or signal in drives.roles else []

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence. std: of the first parameter."""
        return f"{self.name.replace('_', ' ')} of {self.amount(std)}"

    def amount(self, std: float) -> str:
        """Return the first parameter with its standard deviation and unit, e.g. "6.49 ± 0.4 m/s"."""
        name = self.fitted_parameter()
        return f"{getattr(self, name):.3g} ± {std:.1g} {self.parameters[name].unit}".strip()

    @classmethod
    def in_words(cls) -> str:
        """Return it as a part of a sentence, without a number, e.g. "a dragging brake"."""
        return cls.words or cls.name.replace("_", " ")

    @classmethod
    def fitted_parameter(cls) -> str:
        """Return the name of the parameter that the diagnosis fits."""
        return next(iter(cls.parameters))

    def to_config(self) -> dict[str, Any]:
        """Return this effect as an entry of a config's ``effects:`` list."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {"effect": self.name} | {
            k.removeprefix("on_"): v for k, v in values.items() if v is not None or k in self.parameters
        }


@dataclass(frozen=True)
class Added(Effect):
    """Adds its one parameter to a working column (or takes it off)."""

    column: ClassVar[str]
    sign: ClassVar[float] = 1.0

    def apply(self, c: ModelColumns) -> None:
        """Add to the column."""
        (parameter,) = self.parameters
        setattr(c, self.column, getattr(c, self.column) + self.sign * getattr(self, parameter))


@dataclass(frozen=True)
class Scaled(Effect):
    """Scales a working column by its one parameter."""

    column: ClassVar[str]

    def apply(self, c: ModelColumns) -> None:
        """Scale the column."""
        (parameter,) = self.parameters
        setattr(c, self.column, getattr(c, self.column) * getattr(self, parameter))
