"""Do the speeds of the road agree with each other, where no shaft tells which of them is right?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.doctor.engine_and_road import MIN_MPS, ROAD_SPEEDS
from canest.doctor.proportion import Proportion
from canest.doctor.speed_units import mistaken_unit
from canest.doctor.stretches import Samples, at

if TYPE_CHECKING:
    from canest.config import Config

#: speeds that differ by less are worn tyres, tolerances of a speedometer and rounding
_TOLERANCE = 0.06


class RoadSpeedCheck:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        #: with shaft or engine each of them is compared by `ConsistencyCheck`
        turning = {"output_shaft_speed", "engine_speed"} & config.signals.keys()
        roles = () if turning else ROAD_SPEEDS
        self._first, *self._others = [role for role in roles if role in config.signals] or [""]
        self._compared = {role: Proportion() for role in self._others}

    def push(self, stretch: Samples) -> None:
        """Take the samples of a stretch."""
        for role in self._others:
            if role not in stretch or self._first not in stretch:
                continue
            t_us, mps = stretch[role]
            first_mps = at(t_us, stretch[self._first])
            self._compared[role].add(mps, first_mps, np.minimum(mps, first_mps) > MIN_MPS)

    def hints(self) -> list[str]:
        """Return which speeds differ, one sentence each."""
        found = []
        for role, compared in self._compared.items():
            times = compared.times
            if times is None or abs(times - 1.0) <= _TOLERANCE:
                continue
            mistaken = mistaken_unit(times) or mistaken_unit(1.0 / times)
            why = f", as it is when {mistaken} in one of them" if mistaken else ""
            found.append(
                f"{role} is {times:.3g} times {self._first}{why}: which one is right? (unit: of "
                f"signals.{role} and of signals.{self._first})"
            )
        return found
