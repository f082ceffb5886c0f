"""The vehicle as a notebook writes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import ModelWrapValidatorHandler, ValidationError, model_validator

from canest.config.load import explained
from canest.config.origins import Origins
from canest.core.errors import ConfigError
from canest.vehicle import facts

_EXAMPLE = "facts by name, mass_max_kg=3500"


class Vehicle(facts.Vehicle):
    """Facts of a vehicle: the section `vehicle` of a config, checked and immutable.

    Needed: mass_min_kg, mass_max_kg, wheel_radius_m, final_drive, drag_area_m2 (Cd x A) and
    rolling_resistance; gear_ratios {gear: ratio} where there are gears. docs/config.md lists every fact with
    its unit, default and bounds.

    Errors: ConfigError for a fact that is missing, unknown or out of bounds.

    Example:
        >>> import canest
        >>> van = canest.Vehicle(
        ...     mass_min_kg=2000,
        ...     mass_max_kg=3500,
        ...     wheel_radius_m=0.34,
        ...     final_drive=3.9,
        ...     gear_ratios={1: 4.2, 2: 2.4, 3: 1.5, 4: 1.0},
        ...     drag_area_m2=1.2,
        ...     rolling_resistance=0.009,
        ... )
        >>> van.final_drive
        3.9
    """

    if not TYPE_CHECKING:  # checkers know the facts by name

        def __init__(self, *unnamed: object, **facts: object) -> None:
            if unnamed:
                raise ConfigError(
                    "a fact without a name", where="vehicle", found=unnamed[0], expected=_EXAMPLE
                )
            super().__init__(**facts)

    @model_validator(mode="wrap")
    @classmethod
    def _in_one_line(cls, values: Any, handler: ModelWrapValidatorHandler[Vehicle]) -> Vehicle:
        """Raise canest's own error, which is no ValueError and so passes pydantic."""
        try:
            return handler(values)
        except ValidationError as error:
            raise explained(error, Origins(), ("vehicle",)) from None
