"""Does the torque behave as one: does it push where the vehicle gets faster, as hard and steadily as any?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.roles import ROLES
from canest.doctor.motion import STEP_S, motion_of
from canest.doctor.stretches import Samples, at, known
from canest.vehicle.role_sources import torque_role
from canest.vehicle.torque_dropout import torque_limits

if TYPE_CHECKING:
    from canest.config import Config

#: a vehicle is driven that moves (m/s) and gets faster by more than this (m/s2), with more than this share of
#: the largest torque
_MOVES_MPS, _FASTER_MPS2, _DRIVEN_SHARE = 2.0, 0.3, 0.1
#: for so long (s), and this share of it, before a sign is wrong
_LEAST_S, _WRONG_SHARE = 10.0, 0.8
#: no vehicle gets faster by so few N m or percent, but a ratio of the full torque ends there: 125 %
_RATIO = 1.25
_OTHER_FORMS = {
    "%": "a ratio, which takes a factor of 100 (scale: 100)",
    "Nm": "in kN m (unit: kNm), or a ratio of the full torque (scale: that torque)",
}
#: no torque changes by this share of its range from one sample to the next, in so many of its steps
_WILD, _WILD_SHARE, _WITHIN_US, _FEWEST = 0.25, 0.1, 120_000, 1000
#: steps are counted by their size, in quarter octaves, from 2 to this power
_PER_OCTAVE, _LEAST_OCTAVE, _OCTAVES = 4, -20, 60
#: which is more than so many times what bends no mass
_FAR_TIMES = 2.0


class TorqueCourseCheck:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._config = config
        role = torque_role(config.signals, config.vehicle)
        self._role = role if role in config.signals else None
        limits = torque_limits([role] if self._role else [], config.vehicle, {}, {})
        self._far = limits[role].far if self._role and role in limits else np.inf
        self._largest, self._driven_s, self._against_s = 0.0, 0.0, 0.0
        self._range = np.inf, -np.inf
        self._before: tuple[int, float] | None = None
        self._steps = np.zeros(_PER_OCTAVE * _OCTAVES, np.int64)

    def push(self, stretch: Samples) -> None:
        """Take the samples of a stretch."""
        if self._role in stretch:
            self._note_steps(stretch)
            self._compare(stretch)

    def _note_steps(self, samples: Samples) -> None:
        assert self._role is not None
        t_us, values = known(samples[self._role])
        if not len(values):
            return
        low, high = np.percentile(values, (2, 98)).tolist()
        self._range = min(low, self._range[0]), max(high, self._range[1])
        if self._before is not None:
            t_us, values = np.append(self._before[0], t_us), np.append(self._before[1], values)
        self._before = int(t_us[-1]), float(values[-1])
        sizes = np.abs(np.diff(values))[np.diff(t_us) <= _WITHIN_US]
        octaves = np.log2(np.maximum(sizes, 2.0**_LEAST_OCTAVE)) - _LEAST_OCTAVE
        bins = np.minimum((_PER_OCTAVE * octaves).astype(int), len(self._steps) - 1)
        self._steps += np.bincount(bins, minlength=len(self._steps))

    def _compare(self, stretch: Samples) -> None:
        motion = motion_of(stretch, self._config.vehicle)
        if motion is None or self._role is None:
            return
        torque = at(motion.stamps, stretch[self._role])
        self._largest = max(self._largest, float(np.nanmax(np.abs(torque), initial=0.0)))
        faster = motion.accel_mps2 > _FASTER_MPS2
        driven = faster & (motion.before_mps > _MOVES_MPS) & (np.abs(torque) > _DRIVEN_SHARE * self._largest)
        self._driven_s += STEP_S * np.count_nonzero(driven)
        self._against_s += STEP_S * np.count_nonzero(driven & (torque < 0.0))

    def hints(self) -> list[str]:
        """Return what no torque does, at most one sentence."""
        found = self.fault()
        return [found] if found else []

    def fault(self) -> str:
        """Return why the signal is no torque that could be used, '' where it may be one."""
        if self._role is None:
            return ""
        wild, steps, low, high = self._wild_steps(), int(self._steps.sum()), *self._range
        if steps >= _FEWEST and wild > _WILD_SHARE * steps and _WILD * (high - low) > _FAR_TIMES * self._far:
            return (
                f"signals.{self._role}: {100 * wild / steps:.0f} % of the steps from sample to sample are "
                "more than a quarter of its range, which is no torque: is its byte order wrong, or do two "
                "senders share its identifier?"
            )
        if self._driven_s >= _LEAST_S and self._against_s > _WRONG_SHARE * self._driven_s:
            return (
                f"signals.{self._role} is negative in {self._against_s:,.0f} of {self._driven_s:,.0f} s in "
                "which the vehicle gets faster by it: is its sign turned (scale), or is it another signal?"
            )
        unit = ROLES[self._role].unit
        if self._driven_s >= _LEAST_S and max(-low, high) <= _RATIO and unit in _OTHER_FORMS:
            return (
                f"signals.{self._role} is between {low:.3g} and {high:.3g} {unit} while the vehicle gets "
                f"faster by it: is it {_OTHER_FORMS[unit]}?"
            )
        return ""

    def _wild_steps(self) -> int:
        """Return how many steps are larger than no torque makes them."""
        least = _WILD * (self._range[1] - self._range[0])
        if not 0.0 < least < np.inf:
            return 0
        return int(self._steps[int(np.ceil(_PER_OCTAVE * (np.log2(least) - _LEAST_OCTAVE))) :].sum())
