"""Effects: each thing a vehicle may have that the plain model lacks, as one small class.

One file per place where they act; importing this package registers them all.
"""

# imported in the order in which a user is told of them
from canest.vehicle.effects import resistance, crank, driveline, load  # noqa: I001
from canest.vehicle.effects.base import EFFECTS, Effect, Parameter, effect_from_config

__all__ = ["EFFECTS", "Effect", "Parameter", "crank", "driveline", "effect_from_config", "load", "resistance"]
