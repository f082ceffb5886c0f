"""How long the mass stood at one of the vehicle's bounds, where it is never valid."""

from __future__ import annotations

import numpy as np

from canest.core.estimates import Estimates
from canest.core.samples import Status
from canest.vehicle.facts import Vehicle

#: a mass that differs by less from a bound is at it; a mass that is there so long is no accident
_AT, _LONG = 1e-3, 0.2


class AtBound:
    """Counts estimates; memory does not grow with the log."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._bounds_kg = {"mass_max_kg": vehicle.mass_max_kg, "mass_min_kg": vehicle.mass_min_kg}
        self._samples, self._at = 0, dict.fromkeys(self._bounds_kg, 0)

    def push(self, estimates: Estimates) -> None:
        """Take the estimates of a block."""
        known = np.isfinite(estimates.mass_kg) & (estimates.status != Status.UNESTIMATED)
        self._samples += int(np.count_nonzero(known))
        for name, bound_kg in self._bounds_kg.items():
            near = np.abs(estimates.mass_kg[known] - bound_kg) < _AT * bound_kg
            self._at[name] += int(np.count_nonzero(near))

    def notes(self, contradiction: str) -> list[str]:
        """Return at which bound the mass stood, in a sentence; [] for none.

        contradiction: what the estimator says at the end. A bound that it names needs no second sentence.
        """
        return [
            f"the mass stood at vehicle.{name} = {self._bounds_kg[name]:,.0f} kg in {100 * share:.0f} % of "
            "the samples, and is never valid there: is the bound wrong, or torque, ratio or wheel radius?"
            for name, count in self._at.items()
            if (share := count / max(self._samples, 1)) > _LONG and f"vehicle.{name}" not in contradiction
        ]
