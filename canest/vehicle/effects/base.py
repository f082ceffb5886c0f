"""Effects: each thing a vehicle may have that the plain model lacks, as one small class.

A config lists them, live, replay and diagnosis read the same list. An effect changes the model's working
columns; its regressor (what the diagnosis fits) is the change of the model's output per unit of its
parameter, so nothing about an effect is written down twice. At its neutral value it changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from types import NoneType
from typing import Any, ClassVar, Literal, get_args, get_type_hints

from canest.core.errors import ConfigError
from canest.vehicle.working_columns import Columns

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
    #: keys without which the effect does nothing
    required: ClassVar[tuple[str, ...]] = ()

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


def register(cls: type[Effect]) -> type[Effect]:
    """Make an effect known by its name (class decorator)."""
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
    hints = _hints(cls.name)
    known = {f.name.removeprefix("on_"): f.name for f in fields(cls)}
    for key, value in values.items():
        if key not in known:
            raise ConfigError(
                f"{name}: unknown key {key}", where=where, expected="one of " + ", ".join(sorted(known))
            )
        _check(f"{name}.{key}", value, hints[known[key]], {**cls.parameters, **cls.settings}.get(key), where)
    for key in cls.required:
        if values.get(key) is None:
            raise ConfigError(f"{name}: without {key} it never acts", where=where, expected=f"{key}: ROLE")
    return cls(**{known[key]: value for key, value in values.items()})


@cache
def _hints(name: str) -> dict[str, Any]:
    return get_type_hints(EFFECTS[name])


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
class Added(Effect):
    """Adds its one parameter to a working column (or takes it off)."""

    column: ClassVar[str]
    sign: ClassVar[float] = 1.0

    def apply(self, c: Columns) -> None:
        """Add to the column."""
        (parameter,) = self.parameters
        setattr(c, self.column, getattr(c, self.column) + self.sign * getattr(self, parameter))


@dataclass(frozen=True)
class Scaled(Effect):
    """Scales a working column by its one parameter."""

    column: ClassVar[str]

    def apply(self, c: Columns) -> None:
        """Scale the column."""
        (parameter,) = self.parameters
        setattr(c, self.column, getattr(c, self.column) * getattr(self, parameter))
