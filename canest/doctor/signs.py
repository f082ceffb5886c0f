"""Signals whose sign is that of nothing: engines turn forwards, and retarders brake."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.doctor.stretches import Samples

if TYPE_CHECKING:
    from canest.config import Config

#: speeds -> from which value on (of their unit) they are no noise about zero
_FORWARDS = {
    "engine_speed": 100.0, "output_shaft_speed": 50.0, "input_shaft_speed": 50.0, "vehicle_speed": 3.0,
    "undriven_speed": 3.0,
}  # fmt: skip
_RETARDER, _BRAKES_PCT = "retarder_torque_pct", 5.0
#: so many samples on the wrong side
_FEWEST = 100


class SignCheck:
    """Keeps how often a signal was above and below zero."""

    def __init__(self, config: Config) -> None:
        self._least = {r: n for r, n in {**_FORWARDS, _RETARDER: _BRAKES_PCT}.items() if r in config.signals}
        self._above, self._below = dict.fromkeys(self._least, 0), dict.fromkeys(self._least, 0)

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        for role, least in self._least.items():
            if role in samples:
                self._above[role] += int(np.count_nonzero(samples[role][1] > least))
                self._below[role] += int(np.count_nonzero(samples[role][1] < -least))

    def hints(self) -> list[str]:
        """Return which signals have the other sign, one sentence each."""
        found = []
        for role in self._least:
            above, below = self._above[role], self._below[role]
            if role == _RETARDER and above >= _FEWEST and not below:
                found.append(
                    f"signals.{role} is positive in {above:,} samples and never negative, and a retarder "
                    "that brakes reports a negative torque: is its sign turned (scale: -1)?"
                )
            elif role != _RETARDER and below >= _FEWEST and not above:
                found.append(
                    f"signals.{role} is negative in {below:,} samples and never positive: is its sign turned "
                    "(scale: -1)?"
                )
        return found
