"""Effects: each thing a vehicle may have that the plain model lacks, as one small class.

One file per place where they act; `registry` knows them all by name, those of other packages too.
"""

from typing import Any

from canest.vehicle.effects.base import Effect, Parameter
from canest.vehicle.effects.registry import (
    EFFECTS,
    EFFECTS_GROUP,
    added_to,
    all_effects,
    effect_class,
    effect_from_config,
    plugin_roles,
    skipped_effects,
)
from canest.vehicle.effects.trials import DrivenData, Trial
from canest.vehicle.working_columns import ModelColumns

__all__ = [
    "EFFECTS",
    "EFFECTS_GROUP",
    "DrivenData",
    "Effect",
    "ModelColumns",
    "Parameter",
    "Trial",
    "added_to",
    "all_effects",
    "effect_class",
    "effect_from_config",
    "plugin_roles",
    "skipped_effects",
]


def __getattr__(name: str) -> Any:
    """Return `ModelColumns` under its name of 0.1.0, with a DeprecationWarning."""
    if name != "Columns":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import warnings  # wanted by the old name only

    warnings.warn(f"{__name__}.Columns is now ModelColumns", DeprecationWarning, stacklevel=2)
    return ModelColumns
