"""Options of estimators: validated models with named presets, errors in the house form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from canest.core.errors import ConfigError

WHERE = "estimator.options"


class Options(BaseModel):
    """Base of every estimator's options: unknown keys refused, immutable.

    ``presets`` names sets of values (the papers' tunings); explicit keys win over the preset's.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    #: name of a shipped tuning, or None
    preset: str | None = None


O = TypeVar("O", bound=Options)  # noqa: E741 - the one type variable of this page


def parse(model: type[O], options: Mapping[str, Any] | None) -> O:
    """Validate ``options`` against ``model``, a named preset filled in below the explicit keys.

    Errors: ConfigError with ``where`` = ``estimator.options.KEY``.
    """
    given = dict(options or {})
    if given.get("preset") is not None:
        preset = given["preset"] = str(given["preset"])  # YAML reads 2014 as a number
        if preset not in model.presets:
            names = ", ".join(model.presets) or "none for this estimator"
            raise ConfigError(
                "unknown preset", where=f"{WHERE}.preset", found=preset, expected=f"one of {names}"
            )
        given = {**model.presets[preset], **given}
    try:
        return model(**given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        where = f"{WHERE}.{key}" if key else WHERE
        if first["type"] == "extra_forbidden":
            known = ", ".join(name for name in model.model_fields)
            raise ConfigError("unknown option", where=where, found=key, expected=f"one of {known}") from None
        found = first["input"] if key else None
        raise ConfigError(
            "wrong value", where=where, found=found, expected=_expectation(first["msg"])
        ) from None


def _expectation(message: str) -> str:
    """Turn pydantic's sentence ("Input should be greater than 0") into what was expected."""
    return message.removeprefix("Value error, ").removeprefix("Input should be ")
