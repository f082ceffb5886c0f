"""The vehicle's total distance: among its senders, the one that counts what the vehicle drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S

LARGEST_KM = 10_000_000.0  #: no vehicle has driven as far; the message's range is 50 times as much
CONFIRM_KM = 0.5  #: driven between two checks of a sender
_SHARE = 0.25  #: of what was driven: a wheel radius that is declared wrong
_SLACK_KM = 0.2  #: one step of the coarser message (0.125 km), and what is driven between two messages

Sender = tuple[int, int]  #: group and source address


@dataclass(slots=True)
class _Count:
    """A sender's newest distance, and both distances at the last check."""

    km: float
    since_km: float
    since_driven_km: float
    confirmed: bool = False


class Odometer:
    """Compares what senders count with what was driven: only the true one fits the wheels."""

    def __init__(self) -> None:
        self._counts: dict[Sender, _Count] = {}  # at most two groups of 256 addresses
        self._driven_km = 0.0

    @property
    def reported_km(self) -> float | None:
        """Return the confirmed distance, else that of the first sender; None where nobody sends one."""
        first = next(iter(self._counts.values()), None)
        return first.km if self.confirmed_km is None and first is not None else self.confirmed_km

    @property
    def confirmed_km(self) -> float | None:
        """Return the distance of the first sender whose distance has advanced by what was driven."""
        return next((count.km for count in self._counts.values() if count.confirmed), None)

    def add_driven(self, speed_mps: FloatColumn) -> None:
        """Take the vehicle's speed at the next ticks; NaN where it is not known."""
        self._driven_km += float(np.nansum(speed_mps)) * STEP_S * 1e-3

    def update(self, sender: Sender, km: float) -> None:
        """Take a sender's total distance (km)."""
        if km > LARGEST_KM:
            return
        count = self._counts.setdefault(sender, _Count(km, km, self._driven_km))
        stepped_back, count.km = km < count.km, km
        counted_km, driven_km = km - count.since_km, self._driven_km - count.since_driven_km
        fits = abs(counted_km - driven_km) <= _SHARE * driven_km + _SLACK_KM
        too_far = counted_km > driven_km and not fits
        if stepped_back or too_far or driven_km >= CONFIRM_KM:
            count.confirmed = fits and not stepped_back
            count.since_km, count.since_driven_km = km, self._driven_km
