"""Effects: each thing a vehicle may have that the plain model lacks, as one small class.

One file per place where they act; `registry` knows them all by name, those of other packages too.
"""

from canest.vehicle.effects.base import Effect, Parameter
from canest.vehicle.effects.registry import (
    EFFECTS,
    EFFECTS_GROUP,
    all_effects,
    effect_class,
    effect_from_config,
    plugin_roles,
    skipped_effects,
)
from canest.vehicle.effects.trials import DrivenData, Trial
from canest.vehicle.working_columns import Columns

__all__ = [
    "EFFECTS",
    "EFFECTS_GROUP",
    "Columns",
    "DrivenData",
    "Effect",
    "Parameter",
    "Trial",
    "all_effects",
    "effect_class",
    "effect_from_config",
    "plugin_roles",
    "skipped_effects",
]
