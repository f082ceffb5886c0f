"""The call of an effect: one of another package that fails, or leaves what is no column, is named."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core.columns import column_of
from canest.core.errors import PluginError
from canest.core.plugins import is_of_canest, named_failures
from canest.vehicle.working_columns import ModelColumns

_COLUMNS = [field.name for field in fields(ModelColumns) if field.name not in ("signals", "auxiliary")]


def apply(effect: Any, c: ModelColumns) -> None:
    """Let an effect change the columns. Errors: PluginError for one of another package that fails."""
    if is_of_canest(effect):
        effect.apply(c)
        return
    name = f"effect {effect.name} ({type(effect).__module__})"
    before = {column: getattr(c, column) for column in _COLUMNS}
    with named_failures(name):
        effect.apply(c)
    for column, given in before.items():
        if getattr(c, column) is not given:
            setattr(c, column, _checked(getattr(c, column), given, f"its {column} is wrong", name))


def _checked(found: object, given: NDArray[Any], what: str, name: str) -> NDArray[Any]:
    column = column_of(found, given, what, name, "ticks")
    if np.count_nonzero(~np.isfinite(column) & np.isfinite(given)):
        raise PluginError(what, where=name, found="NaN or infinity", expected="a number where there was one")
    return column
