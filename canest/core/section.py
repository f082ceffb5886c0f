"""What all sections of a config have in common: unknown keys refused, numbers that are numbers.

`extra="forbid"` everywhere: a misspelt key is an error, never a silent default.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


class MisplacedError(ValueError):
    """A mistake that a validator of the whole section found; ``keys``: where in the section it is."""

    def __init__(self, message: str, *keys: str | int) -> None:
        super().__init__(message)
        self.keys = keys


class Section(BaseModel):
    """Base of all sections: unknown keys refused, values immutable, no silent type juggling."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, str_strip_whitespace=True, defer_build=True
    )


def _number_not_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("found yes/no, expected a number")  # noqa: TRY004 - pydantic wants ValueError
    return value


def empty_section() -> Any:
    """Return the default of a section: as if it stood empty in the config, and validated with it.

    An instance would build a validator of its own at import, 1 ms each.
    """
    return Field(default_factory=dict, validate_default=True)


Number = Annotated[float, BeforeValidator(_number_not_bool)]
Whole = Annotated[int, BeforeValidator(_number_not_bool)]
