"""The call of an effect: one of another package that fails is named."""

from __future__ import annotations

from typing import Any

from canest.core.errors import CanestError, PluginError
from canest.vehicle.working_columns import ModelColumns


def apply(effect: Any, c: ModelColumns) -> None:
    """Let an effect change the columns. Errors: PluginError for one of another package that fails."""
    if type(effect).__module__.startswith("canest."):
        effect.apply(c)
        return
    try:
        effect.apply(c)
    except CanestError:
        raise
    except Exception as error:
        name = f"effect {effect.name} ({type(effect).__module__})"
        raise PluginError(f"{type(error).__name__}: {error}", where=name) from error
