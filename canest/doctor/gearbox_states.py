"""Do the states of the gearbox fit the motion? A shift is short, and a converter locks up at speed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.doctor.motion import STEP_S, motion_of
from canest.doctor.stretches import Samples, held

if TYPE_CHECKING:
    from canest.config import Config

_SHIFT, _LOCKUP = "shift_in_process", "lockup_engaged"
#: a vehicle is slow below and fast above these, m/s; each for at least so long before it counts, s
_SLOW_MPS, _FAST_MPS, _LEAST_S = 3.0, 8.0, 20.0
#: nobody shifts for a larger share of the time, or locks a converter up while creeping and not at speed
_SHIFTS_SHARE, _MOSTLY, _HARDLY = 0.5, 0.8, 0.4


class GearboxStateCheck:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._vehicle, self._sources = config.vehicle, config.signals
        self._roles = [role for role in (_SHIFT, _LOCKUP) if role in config.signals]
        #: seconds by role: slow, slow and on, fast, fast and on
        self._seconds = {role: np.zeros(4) for role in self._roles}

    def push(self, stretch: Samples) -> None:
        """Take the samples of a stretch."""
        motion = motion_of(stretch, self._vehicle) if self._roles else None
        if motion is None:
            return
        for role in self._roles:
            if role not in stretch:
                continue
            state = held(motion.stamps, stretch[role])
            known, on = np.isfinite(state), state > 0.5
            slow, fast = known & (motion.after_mps < _SLOW_MPS), known & (motion.after_mps > _FAST_MPS)
            counts = [np.count_nonzero(rows) for rows in (slow, slow & on, fast, fast & on)]
            self._seconds[role] += STEP_S * np.array(counts)

    def hints(self) -> list[str]:
        """Return which states cannot be right, one sentence each."""
        return [hint for role in self._roles if (hint := self._hint(role))]

    def _hint(self, role: str) -> str:
        slow_s, slow_on_s, fast_s, fast_on_s = self._seconds[role].tolist()
        if fast_s < _LEAST_S:
            return ""
        inverted = str(not self._sources[role].invert).lower()
        remedy = f"is it inverted? Then signals.{role} needs invert: {inverted}"
        if role == _SHIFT and fast_on_s > _SHIFTS_SHARE * fast_s:
            return f"{role} is on in {fast_on_s:,.0f} of {fast_s:,.0f} s of driving: {remedy}"
        turned = slow_s >= _LEAST_S and slow_on_s > _MOSTLY * slow_s and fast_on_s < _HARDLY * fast_s
        if role == _LOCKUP and turned:
            return (
                f"{role} is on in {slow_on_s:,.0f} of {slow_s:,.0f} s at standstill or walking pace, and in "
                f"{fast_on_s:,.0f} of {fast_s:,.0f} s at speed: {remedy}"
            )
        return ""
