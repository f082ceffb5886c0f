"""What several sections of a config must agree on: masses, gears, roles, and what is known by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.core.errors import ConfigError
from canest.core.nearest_name import expected_name
from canest.core.roles import ROLES, TWO_STATE
from canest.core.section import MisplacedError

if TYPE_CHECKING:
    from canest.config.schema import Config


def refuse_contradictions(config: Config) -> None:
    """Check a config whose sections are each right. Errors: MisplacedError."""
    _start_possible(config)
    _estimator_known(config)
    _roles_known(config, _effects_possible(config))
    _two_states_inverted(config)


def _start_possible(config: Config) -> None:
    start, low, high = (
        config.estimator.initial_mass_kg,
        config.vehicle.mass_min_kg,
        config.vehicle.mass_max_kg,
    )
    if start is not None and not low <= start <= high:
        raise MisplacedError(
            f"no mass of this vehicle, found {start:g}, expected {low:g} to {high:g} kg "
            "(vehicle.mass_min_kg, mass_max_kg)",
            "estimator",
            "initial_mass_kg",
        )


def _estimator_known(config: Config) -> None:
    from canest.estimators.base import require_known

    try:
        require_known(config.estimator.name, where="")
    except ConfigError as error:
        raise MisplacedError(str(error), "estimator", "name") from None


def _effects_possible(config: Config) -> dict[str, int]:
    """Return the roles that effects need -> the first effect that needs it."""
    used: dict[str, int] = {}
    if not config.effects:
        return used
    from canest.vehicle.effects import effect_from_config

    for i, entry in enumerate(config.effects):
        try:
            signal = effect_from_config(entry, "").signal
        except ConfigError as error:
            raise MisplacedError(str(error), "effects", i) from None
        if signal is not None:
            used.setdefault(signal, i)
        _gear_known(config, entry.get("gear"), i)
    return used


def _gear_known(config: Config, gear: int | None, i: int) -> None:
    """Refuse a gear that no effect could ever meet. Without a table, the bus alone knows the gears."""
    gears = config.vehicle.gear_ratios
    if gear is None or gear in gears or (not gears and "gear" in config.signals):
        return
    known = f"one of {', '.join(map(str, gears))} (vehicle.gear_ratios)" if gears else "null: all gears"
    raise MisplacedError(f"no gear of this vehicle, found {gear}, expected {known}", "effects", i, "gear")


def _roles_known(config: Config, used: dict[str, int]) -> None:
    unknown = [role for role in config.signals if role not in ROLES and role not in used]
    if unknown:
        from canest.vehicle.effects import plugin_roles  # reads the metadata of all installed packages

        for role in unknown:
            if role in plugin_roles():
                continue
            expected = expected_name(role, ROLES, "a role", "docs/config.md")
            raise MisplacedError(f"unknown role, expected {expected}", "signals", role)
    for role, i in used.items():
        if role not in config.signals:
            raise MisplacedError(
                f"needs the signal {role}, found no such key in signals:, expected a source for it",
                "effects",
                i,
            )


def _two_states_inverted(config: Config) -> None:
    for role, source in config.signals.items():
        if source.invert and role in ROLES and role not in TWO_STATE:
            raise MisplacedError(
                f"{role} has more than two states, found true, expected no such key (scale: -1 turns a sign)",
                "signals",
                role,
                "invert",
            )
