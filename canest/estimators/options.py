"""Options of estimators: validated models with named presets, errors in the house form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from canest.core.errors import ConfigError
from canest.core.nearest_name import expected_name
from canest.core.validation import first_mistake

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
        mistake = first_mistake(error)
        where = f"{WHERE}.{mistake.key}" if mistake.key else WHERE
        if mistake.kind == "unknown key":
            expected = expected_name(mistake.key, model.model_fields, "an option")
            raise ConfigError("unknown option", where=where, found=mistake.key, expected=expected) from None
        found = mistake.found if mistake.key else None
        raise ConfigError("wrong value", where=where, found=found, expected=mistake.words) from None
