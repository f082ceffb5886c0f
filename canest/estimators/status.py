"""When an estimate is `valid`: one rule; its limit of the relative standard deviation is the estimator's."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FloatColumn
from canest.core.samples import RATE_HZ, Status

#: valid once std/mass has stayed below this ...
VALID_RATIO = 0.10
#: ... for this long (the hover-thrust estimators of flight controllers use the same hold)
HOLD_S = 2.0
_ON = 1e-6


class StatusTracker:
    """Counts how long the standard deviation has been small; carries the count over blocks.

    bounds_kg: a mass that was projected onto one of them is no result. One that noise takes off again is like
    that of a vehicle which weighs as much as it may, and counts.
    """

    def __init__(
        self,
        ratio: float = VALID_RATIO,
        bounds_kg: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        self._ratio, self._hold = ratio, round(HOLD_S * RATE_HZ)
        # a little inside: a projected mass lies on the bound but for rounding
        self._least_kg, self._most_kg = bounds_kg[0] * (1.0 + _ON), bounds_kg[1] * (1.0 - _ON)
        self._run = 0

    def update(
        self, learned: BoolColumn, mass_kg: FloatColumn, mass_std_kg: FloatColumn
    ) -> NDArray[np.uint8]:
        """Return the status per sample, shape (n,).

        learned: True from the first sample on at which the data confirmed or moved the start value.
        NaN in the mass counts as "no number yet".
        """
        n = len(mass_kg)
        small = learned & (mass_std_kg <= self._ratio * mass_kg)
        small &= (mass_kg > self._least_kg) & (mass_kg < self._most_kg)
        index = np.arange(1, n + 1)
        last_large = np.maximum.accumulate(np.where(small, -self._run, index)) if n else index
        run = index - last_large
        if n:
            self._run = int(run[-1])
        status = np.where(learned & ~np.isnan(mass_kg), Status.CONVERGING, Status.UNESTIMATED)
        status[run >= self._hold] = Status.VALID
        return status.astype(np.uint8)


def none_begins(
    status: NDArray[np.uint8], stale: BoolColumn, was_valid: bool
) -> tuple[NDArray[np.uint8], bool]:
    """Return statuses of n samples, none of which becomes `valid` on a stale one: silence confirms nothing.

    was_valid: whether the last sample that was not stale was valid; the new one is returned as well.
    """
    if not stale.any():  # nearly always, and once a tick in the daemon
        return status, bool(status[-1] == Status.VALID) if len(status) else was_valid
    index = np.maximum.accumulate(np.where(stale, -1, np.arange(len(status))))
    confirmed = np.where(index >= 0, status[index] == Status.VALID, was_valid)
    status = np.where(stale & (status == Status.VALID) & ~confirmed, Status.CONVERGING, status)
    return status.astype(np.uint8), bool(confirmed[-1])
