"""Engine constants that the config assumes until the bus reports them.

An engine sends its reference torque every five seconds, or only after minutes when its controller wakes late.
What was learned until then is as wrong as the assumed number.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from canest.estimators.base import Estimator
from canest.grid.grid import GridBlock

#: largest error of an assumed constant that is no contradiction, as a share of the reference torque
TOLERANCE = 0.01
#: standard deviation of a mass that was learned with a wrong constant, as a share of it
MASS_STD_SHARE = 0.5


class AssumedConstants(NamedTuple):
    """Role -> the number assumed for it, and by how much the reported one may differ (same unit)."""

    numbers: Mapping[str, tuple[float, float]]

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
        """Yield ticks in parts, and whether a report contradicts an assumed constant where each begins."""
        begin, contradicted = 0, False
        for at in self._contradictions(ticks):
            before, ticks = ticks.split(at - begin)
            if len(before):
                yield before, contradicted
            begin, contradicted = at, True
        yield ticks, contradicted

    def _contradictions(self, ticks: GridBlock) -> list[int]:
        """Return the ticks at which a reported constant differs from the assumed one, in order."""
        found = []
        for role, (assumed, tolerance) in list(self._assumed.items()):
            reported = np.isfinite(ticks.values[role])
            if reported.any():
                del self._assumed[role]
                at = int(reported.argmax())
                if abs(ticks.values[role][at] - assumed) > tolerance:
                    found.append(at)
        return sorted(set(found))


def carry_over(fresh: Estimator, mass_kg: float, restored: tuple[float, float, float] | None) -> Estimator:
    """Return the fresh estimator, started from the mass that is left after a wrong assumed constant.

    mass_kg: learned with that constant, a guess from now on (NaN for none). restored: mass and std in kg,
    and the unseen time in s, that a restart gave the stream; they win.
    """
    if restored is not None:
        fresh.restore(*restored)
    elif math.isfinite(mass_kg):
        fresh.restore(mass_kg, MASS_STD_SHARE * mass_kg)
    return fresh
