"""What every method that learns a mass shares: start, restore, restart."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import VehicleFacts
from canest.estimators.bounds import unseen_std_kg
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.status import StatusTracker


class LearnedMass(ChunkedEstimator):
    """Options, status and memory of a method whose mass is held while gates are closed.

    `_held`: the numbers after the last row so far, shape (r, 1); its first rows are mass_kg and mass_std_kg.
    `_confirmed`: data have confirmed or moved the start value.
    """

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self._status = StatusTracker(bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._held: FloatColumn = np.full((2, 1), np.nan)
        self._confirmed = False

    @abstractmethod
    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        """Set the state to a mass and its standard deviation; None: derived from options and bounds."""

    def snapshot(self) -> dict[str, Any]:
        """Return the mass and its standard deviation, where there is a confirmed one."""
        mass, std = float(self._held[0, 0]), float(self._held[1, 0])
        return {"mass_kg": mass, "mass_std_kg": std} if self._confirmed else {}

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:
        """Start from a saved mass and its standard deviation, widened by an unseen stop."""
        self._begin(mass_kg, math.hypot(mass_std_kg, unseen_std_kg(unseen_s, self.facts)))
