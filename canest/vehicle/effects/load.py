"""What the vehicle carries."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.vehicle.effects.base import Effect, Parameter, Stage
from canest.vehicle.effects.trials import DrivenData, Trial


@dataclass(frozen=True)
class PayloadChange(Effect):
    """The load changes during a stop. The diagnosis finds it in a drive; estimators do by themselves."""

    name: ClassVar[str] = "payload_change"
    words: ClassVar[str] = "a changed load"
    stage: ClassVar[Stage] = "load"
    text: ClassVar[str] = "mass added in the stop around t_s (the log's clock); estimators find it themselves"
    rarity: ClassVar[int] = 180
    several_by: ClassVar[str] = "t_s"
    untried_reason: ClassVar[str] = "no stop of 30 s between driving, or drives of the same time"
    parameters: ClassVar[dict[str, Parameter]] = {
        "mass_delta_kg": Parameter("kg", 0.0, -100_000.0, 100_000.0, 100.0),
        "t_s": Parameter("s", 0.0, -1e12, 1e12, 1.0),
    }
    mass_delta_kg: float = 0.0
    t_s: float = 0.0

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it for each stop that was long enough for loading."""
        return [Trial(f"{cls.name} at {t:.0f} s", (("t_s", t),)) for t in drives.loading_stops_s]

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        change = "loaded" if self.mass_delta_kg > 0 else "unloaded"
        return (
            f"{abs(self.mass_delta_kg):,.0f} ± {std:,.0f} kg {change} in the stop around t_s {self.t_s:.0f}"
        )


def added_kg(effects: Iterable[Effect], t_us: IntColumn) -> FloatColumn:
    """Return how much heavier the vehicle is by these effects than at first (n,)."""
    added = np.zeros(len(t_us))
    for effect in effects:
        if isinstance(effect, PayloadChange):
            added += np.where(t_us >= effect.t_s * 1e6, effect.mass_delta_kg, 0.0)
    return added
