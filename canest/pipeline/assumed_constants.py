"""Numbers of the config that stand in for constants of the engine, until the bus tells them.

An engine sends its reference torque every five seconds, or only after minutes when its controller wakes late.
What was learned until then is as wrong as the number that stood in.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from canest.estimators.base import Estimator
from canest.grid.grid import GridBlock

#: what such a number may be off by, as engines are: a share of the reference torque
TOLERANCE = 0.01
#: doubt of a mass that was learned with a wrong one, as a share of it
DOUBT = 0.5


@dataclass(frozen=True, slots=True)
class AssumedConstants:
    """Role -> the number assumed for it, and by how much the reported one may differ (same unit)."""

    numbers: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @staticmethod
    def of(
        roles: Collection[str], reference_torque_Nm: float | None, friction_torque_pct: float
    ) -> AssumedConstants:
        """Return the constants of those roles that the bus reports."""
        reference_Nm = reference_torque_Nm or math.inf  # without one nothing was learned
        numbers = {
            "reference_torque": (reference_Nm, TOLERANCE * reference_Nm),
            "engine_friction_pct": (friction_torque_pct, 100.0 * TOLERANCE),
        }
        return AssumedConstants({role: n for role, n in numbers.items() if role in roles})


class AssumedConstantsCheck:
    """Compares each assumed constant with the first reported one."""

    def __init__(self, assumed: AssumedConstants) -> None:
        self._assumed = dict(assumed.numbers)

    def parts(self, ticks: GridBlock) -> Iterator[tuple[GridBlock, bool]]:
        """Yield ticks in parts, each with whether it begins where something else is heard than stood in."""
        begin, refuted = 0, False
        for at in self._refuted(ticks):
            before, ticks = ticks.split(at - begin)
            if len(before):
                yield before, refuted
            begin, refuted = at, True
        yield ticks, refuted

    def _refuted(self, ticks: GridBlock) -> list[int]:
        found = []
        for role, (assumed, tolerance) in list(self._assumed.items()):
            heard = np.isfinite(ticks.values[role])
            if heard.any():
                del self._assumed[role]
                at = int(heard.argmax())
                if abs(ticks.values[role][at] - assumed) > tolerance:
                    found.append(at)
        return sorted(set(found))


def carry_over(fresh: Estimator, mass_kg: float, remembered: tuple[float, float] | None) -> Estimator:
    """Return a fresh estimator that goes on after a wrong number.

    mass_kg: learned with it, a guess from now on (NaN for none). remembered: mass and std in kg that were
    given before, from which it begins anew.
    """
    if remembered is not None:
        fresh.restore(*remembered)
    elif math.isfinite(mass_kg):
        fresh.restore(mass_kg, DOUBT * mass_kg)
    return fresh
