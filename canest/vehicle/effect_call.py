"""The call of an effect: one of another package that fails is named."""

from __future__ import annotations

from typing import Any

from canest.core.plugins import is_of_canest, named_failures
from canest.vehicle.working_columns import ModelColumns


def apply(effect: Any, c: ModelColumns) -> None:
    """Let an effect change the columns. Errors: PluginError for one of another package that fails."""
    if is_of_canest(effect):
        effect.apply(c)
        return
    with named_failures(f"effect {effect.name} ({type(effect).__module__})"):
        effect.apply(c)
