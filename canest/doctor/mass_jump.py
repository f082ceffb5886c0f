"""A valid mass that becomes another while the vehicle drives, as hardly any load does."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from canest.core.samples import RATE_HZ, STEP_US, EstimateBlock, ModelBlock, Status

#: masses are compared every 10 s with those of three minutes: a spreader at 14 kg/s loses 2.5 t in that
_EVERY_TICKS, _KEPT = round(10 * RATE_HZ), 18
#: of two that differ by this share, and by so many standard deviations, one is wrong
_SHARE, _STDS = 0.15, 4.0


class MassJump:
    """A pipeline's listener; memory does not grow with the log.

    found: in a sentence, with the newest numbers; '' while no mass has jumped.
    """

    def __init__(self) -> None:
        self.found = ""
        self._stood = 0  #: ticks
        self._valid: deque[tuple[int, float, float, int]] = deque(maxlen=_KEPT)  #: tick, kg, std, stood

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples with their estimates."""
        ticks = samples.t_us // STEP_US
        rows = np.flatnonzero((ticks % _EVERY_TICKS == 0) & (estimates.status == Status.VALID))
        if len(rows):
            stood = self._stood + np.cumsum(samples.stopped)[rows]
            masses, stds = estimates.mass_kg[rows], estimates.mass_std_kg[rows]
            for now in zip(ticks[rows].tolist(), masses.tolist(), stds.tolist(), stood.tolist(), strict=True):
                self._compare(*now)
                self._valid.append(now)
        self._stood += int(np.count_nonzero(samples.stopped))

    def _compare(self, tick: int, mass_kg: float, std_kg: float, stood: int) -> None:
        for before_tick, before_kg, before_std_kg, before_stood in self._valid:
            seconds = (tick - before_tick) / RATE_HZ
            recent = before_stood == stood and 0.0 < seconds <= _KEPT * _EVERY_TICKS / RATE_HZ
            change_kg = abs(mass_kg - before_kg)
            if recent and change_kg > max(_SHARE * before_kg, _STDS * math.hypot(std_kg, before_std_kg)):
                self.found = (
                    f"the mass went from {before_kg:,.0f} to {mass_kg:,.0f} kg within {seconds:.0f} s while "
                    "the vehicle drove, which hardly any load does: did the torque's gain, a ratio or the "
                    "radius change, or is the rest of another vehicle?"
                )
                return
