"""What the vehicle carries."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.vehicle.effects.base import Effect, Parameter, Stage, register


@register
@dataclass(frozen=True)
class PayloadChange(Effect):
    """The load changes during a stop. The diagnosis finds it in a drive; estimators do by themselves."""

    name: ClassVar[str] = "payload_change"
    stage: ClassVar[Stage] = "load"
    text: ClassVar[str] = "mass added in the stop around t_s (the log's clock); estimators find it themselves"
    parameters: ClassVar[dict[str, Parameter]] = {
        "mass_delta_kg": Parameter("kg", 0.0, -100_000.0, 100_000.0, 100.0),
        "t_s": Parameter("s", 0.0, -1e12, 1e12, 1.0),
    }
    mass_delta_kg: float = 0.0
    t_s: float = 0.0


def added_kg(effects: Iterable[Effect], t_us: IntColumn) -> FloatColumn:
    """Return how much heavier the vehicle is by these effects than at first (n,)."""
    added = np.zeros(len(t_us))
    for effect in effects:
        if isinstance(effect, PayloadChange):
            added += np.where(t_us >= effect.t_s * 1e6, effect.mass_delta_kg, 0.0)
    return added
