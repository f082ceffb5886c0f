"""Every known effect by its name: canest's own, and those of other packages.

Another package adds an effect through an entry point of the group ``canest.effects``:

    [project.entry-points."canest.effects"]
    trailer_drag = "canest_trailer_drag:TrailerDrag"

Its metadata is read only where a name is not one of canest's own, or where all effects are asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from functools import cache
from types import NoneType
from typing import Any, get_args, get_type_hints

from canest.core.errors import ConfigError
from canest.core.nearest_name import expected_name
from canest.core.plugins import usable_plugins
from canest.vehicle.effects.base import Effect, Parameter
from canest.vehicle.effects.crank import (
    RetarderUnreported,
    SwitchedLoad,
    TorqueDelay,
    TorqueGain,
    TorqueOffset,
)
from canest.vehicle.effects.driveline import DrivelineLoss, RotatingInertia, WheelRadius, WheelSlip
from canest.vehicle.effects.load import PayloadChange
from canest.vehicle.effects.resistance import (
    BrakeDrag,
    CorneringDrag,
    DragArea,
    Headwind,
    RollingResistance,
    RollingResistanceSpeed,
    RollingResistanceTemperature,
    RollingWarmup,
)

#: group of the entry points that add effects
EFFECTS_GROUP = "canest.effects"
#: stages that an effect of another package may act in: the grid and the load know their own effects
PLUGIN_STAGES = ("geometry", "crank", "driveline", "speed", "road")

_OWN: tuple[type[Effect], ...] = (
    Headwind, DragArea, RollingResistance, RollingResistanceSpeed, TorqueGain, TorqueOffset, TorqueDelay,
    DrivelineLoss, WheelRadius, RotatingInertia, BrakeDrag, RollingWarmup, WheelSlip,
    RollingResistanceTemperature, CorneringDrag, RetarderUnreported, SwitchedLoad, PayloadChange,
)  # fmt: skip
#: canest's own effects by name, in the order in which they are listed and tried
EFFECTS: dict[str, type[Effect]] = {cls.name: cls for cls in _OWN}


def all_effects() -> dict[str, type[Effect]]:
    """Return every effect by name: canest's own first, then those of other packages."""
    return EFFECTS | plugin_effects()[0]


def skipped_effects() -> dict[str, str]:
    """Return the effects of other packages that cannot be used: name -> why, in one line."""
    return dict(plugin_effects()[1])


def plugin_roles() -> set[str]:
    """Return the roles that drive effects of other packages unless a config names others."""
    return {signal for cls in plugin_effects()[0].values() if (signal := cls().signal) is not None}


def added_to(declared: str, entries: Iterable[Mapping[str, Any]]) -> float:
    """Return what entries of a config's effects add to a field of its vehicle. Errors: ConfigError."""
    return sum(
        float(entry.get(name, parameter.neutral))
        for entry in entries
        for name, parameter in effect_class(entry["effect"]).parameters.items()
        if parameter.declared == declared
    )


def effect_class(name: str, where: str = "effects") -> type[Effect]:
    """Return an effect's class. Errors: ConfigError for an unknown name, or one that cannot be used."""
    own = EFFECTS.get(name)
    if own is not None:
        return own
    plugins, skipped = plugin_effects()
    if name in plugins:
        return plugins[name]
    if name in skipped:
        raise ConfigError(
            f"the effect {name} cannot be used: {skipped[name]}",
            where=where,
            expected="a package that can be imported",
        )
    expected = expected_name(name, all_effects(), "an effect")
    raise ConfigError("unknown effect", where=where, found=name, expected=expected)


def effect_from_config(entry: Mapping[str, Any], where: str = "effects") -> Effect:
    """Build an effect from its config entry.

    Errors: ConfigError for an unknown effect, key, or a value out of bounds.
    """
    values = dict(entry)
    name = values.pop("effect", None)
    cls = effect_class(str(name), where)
    hints = _hints(cls)
    known = {f.name.removeprefix("on_"): f.name for f in fields(cls)}
    for key, value in values.items():
        if key not in known:
            expected = expected_name(str(key), sorted(known), f"a key of {name}")
            raise ConfigError(f"{name}: unknown key {key}", where=where, expected=expected)
        _check(f"{name}.{key}", value, hints[known[key]], {**cls.parameters, **cls.settings}.get(key), where)
    for key in cls.required:
        if values.get(key) is None:
            raise ConfigError(f"{name}: without {key} it never acts", where=where, expected=f"{key}: ROLE")
    return cls(**{known[key]: value for key, value in values.items()})


@cache
def plugin_effects() -> tuple[dict[str, type[Effect]], dict[str, str]]:
    """Return the effects of other packages by name, and those that were skipped: name -> why."""
    return usable_plugins(EFFECTS_GROUP, unfit)


def unfit(name: str, cls: object) -> str:
    """Return why the object of an entry point cannot be an effect, "" where it can be one."""
    if not (isinstance(cls, type) and issubclass(cls, Effect)):
        return f"{cls!r} is no subclass of canest.vehicle.effects.Effect"
    if name in EFFECTS:
        return f"{cls.__module__} gives it again, but it is one of canest's own"
    if cls.name != name:
        return f"{cls.__qualname__} calls itself {cls.name!r}"
    if cls.stage not in PLUGIN_STAGES:
        return f"its stage is {cls.stage!r}, expected one of {', '.join(PLUGIN_STAGES)}"
    numbers = {*cls.parameters, *cls.settings}
    if not cls.parameters or not numbers <= {f.name for f in fields(cls)}:
        return f"{cls.__qualname__} has no field for each of its parameters (is it a dataclass?)"
    try:
        plain = cls()
        off = [p for p, info in cls.parameters.items() if getattr(plain, p) != info.neutral]
        _hints(cls)
    except Exception as error:  # whatever foreign code does
        return f"{cls.__qualname__}() fails: {type(error).__name__}: {error}"
    return f"{cls.__qualname__}.{off[0]} is not neutral by default" if off else ""


_HINTS: dict[type[Effect], dict[str, Any]] = {}


def _hints(cls: type[Effect]) -> dict[str, Any]:
    """Return a class' types by field; working them out costs more than building the effect."""
    if cls not in _HINTS:
        _HINTS[cls] = get_type_hints(cls)
    return _HINTS[cls]


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
