"""What several sections of a config must agree on: masses, gears, roles, and what is known by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from canest.config.sections import EstimatorSection, Source
from canest.core.errors import ConfigError
from canest.core.roles import ROLES, TWO_STATE, expected_role
from canest.core.section import MisplacedError
from canest.vehicle.facts import Vehicle

Signals = Mapping[str, Source]

#: a sum of numbers that are rounded in a file
_ROUNDING = 1e-9


def refuse_contradictions(
    vehicle: Vehicle, signals: Signals, estimator: EstimatorSection, effects: Sequence[Mapping[str, Any]]
) -> None:
    """Check sections that are each right. Errors: MisplacedError."""
    _start_possible(vehicle, estimator)
    _estimator_known(estimator)
    _roles_known(signals, _effects_possible(effects, vehicle, signals))
    _two_states_inverted(signals)


def _start_possible(vehicle: Vehicle, estimator: EstimatorSection) -> None:
    start, low, high = estimator.initial_mass_kg, vehicle.mass_min_kg, vehicle.mass_max_kg
    if start is not None and not low <= start <= high:
        raise MisplacedError(
            f"no mass of this vehicle, found {start:g}, expected {low:g} to {high:g} kg "
            "(vehicle.mass_min_kg, mass_max_kg)",
            "estimator",
            "initial_mass_kg",
        )


def _estimator_known(estimator: EstimatorSection) -> None:
    # numpy comes with it, which takes as long to import as the config
    from canest.estimators.registry import require_known

    try:
        require_known(estimator.name, where="")
    except ConfigError as error:
        raise MisplacedError(str(error), "estimator", "name") from None


def _effects_possible(
    effects: Sequence[Mapping[str, Any]], vehicle: Vehicle, signals: Signals
) -> dict[str, int]:
    """Return the roles that effects need -> the first effect that needs it."""
    used: dict[str, int] = {}
    if not effects:
        return used
    # numpy as above, and all effects
    from canest.vehicle.effects import effect_from_config

    for i, entry in enumerate(effects):
        try:
            signal = effect_from_config(entry, "").signal
        except ConfigError as error:
            raise MisplacedError(str(error), "effects", i) from None
        if signal is not None:
            used.setdefault(signal, i)
        _sums_positive(effects[: i + 1], vehicle)
        _gear_known(vehicle, signals, entry.get("gear"), i)
    return used


def _sums_positive(effects: Sequence[Mapping[str, Any]], vehicle: Vehicle) -> None:
    """Refuse a last effect that makes negative what the vehicle declares (a drag that pushes)."""
    from canest.vehicle.effects import added_to, effect_class

    for name, info in effect_class(effects[-1]["effect"]).parameters.items():
        if not info.declared:
            continue
        own = float(getattr(vehicle, info.declared))
        added = added_to(info.declared, effects)
        if own + added < -_ROUNDING * own:
            raise MisplacedError(
                f"vehicle.{info.declared} {own:g} and this are negative, found {effects[-1].get(name)}, "
                f"expected a sum of 0 or more",
                "effects", len(effects) - 1, name,
            )  # fmt: skip


def _gear_known(vehicle: Vehicle, signals: Signals, gear: int | None, i: int) -> None:
    """Refuse a gear that no effect could ever meet. Without a table, the bus alone knows the gears."""
    gears = vehicle.gear_ratios
    if gear is None or gear in gears or (not gears and "gear" in signals):
        return
    known = f"one of {', '.join(map(str, gears))} (vehicle.gear_ratios)" if gears else "null: all gears"
    raise MisplacedError(f"no gear of this vehicle, found {gear}, expected {known}", "effects", i, "gear")


def _roles_known(signals: Signals, used: dict[str, int]) -> None:
    unknown = [role for role in signals if role not in ROLES and role not in used]
    if unknown:
        from canest.vehicle.effects import plugin_roles  # reads the metadata of all installed packages

        for role in unknown:
            if role in plugin_roles():
                continue
            expected = expected_role(role)
            raise MisplacedError(f"unknown role, expected {expected}", "signals", role)
    for role, i in used.items():
        if role not in signals:
            raise MisplacedError(
                f"needs the signal {role}, found no such key in signals:, expected a source for it",
                "effects",
                i,
            )


def _two_states_inverted(signals: Signals) -> None:
    for role, source in signals.items():
        if source.invert and role in ROLES and role not in TWO_STATE:
            raise MisplacedError(
                f"{role} has more than two states, found true, expected no such key (scale: -1 turns a sign)",
                "signals",
                role,
                "invert",
            )
