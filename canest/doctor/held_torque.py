"""Is a torque renewed as often as it comes, and may it be as large as it is? Gateways repeat, ranges end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.config.sections import SLOWEST_PERIOD_S
from canest.core.frames import FloatColumn, IntColumn
from canest.doctor.stretches import Samples, known
from canest.vehicle.role_sources import torque_role

if TYPE_CHECKING:
    from canest.config import Config

#: intervals are counted in quarter octaves from 1 ms on; longer ones are gaps of the sender, s
_PER_OCTAVE, _LEAST_S, _BINS, _LONGEST_S = 4, 1e-3, 64, 20.0
#: of the changes that follow each other soonest this share is chance; fewer changes tell nothing
_SOONEST, _FEWEST = 0.02, 50
#: a torque that is renewed changes within so many messages, or within this time (s), while a driver drives
_MESSAGES, _SOON_S = 3.0, 0.3
#: a stated period that is this share of the one found is right; so much longer than it is seems the slowest
_STATED, _JITTER = 0.7, 1.2
#: an engine's largest torque depends on its speed: it does not stay at one number for this share of the
#: samples that drive, unless that is its full scale, %, or it is as often just below; fewer tell nothing
_AT_LARGEST, _FULL_PCT, _TIMES, _LEAST_SAMPLES = 0.25, 97.0, 3.0, 3000
#: torques are counted in steps of 2.5 % from 0.001 on, of which four are just below
_STEP, _SMALLEST, _STEPS, _BELOW = 0.025, 1e-3, 1000, 4


class HeldTorqueCheck:
    """Takes the samples of the torque in use. Streams; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        role = torque_role(config.signals, config.vehicle)
        self._role = role if role in config.signals else ""
        self._stated_s = config.signals[self._role].period_s if self._role else None
        self._last: tuple[IntColumn, FloatColumn] | None = None
        self._changed_us: int | None = None
        self._messages, self._changes = (np.zeros((2, _BINS)) for _ in range(2))  #: number, seconds
        self._largest, self._at_largest, self._driving = 0.0, 0, np.zeros(_STEPS, np.int64)

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        if self._role not in samples:
            return
        t_us, values = known(samples[self._role])
        if not len(values):
            return
        self._note_largest(values)
        if self._last is not None:
            t_us, values = np.append(self._last[0], t_us), np.append(self._last[1], values)
        self._last = t_us[-1:], values[-1:]
        _count(self._messages, np.diff(t_us))
        changed = t_us[1:][np.diff(values) != 0.0]
        if len(changed):
            before = [] if self._changed_us is None else [self._changed_us]
            _count(self._changes, np.diff(np.append(before, changed)))
            self._changed_us = int(changed[-1])

    def _note_largest(self, values: FloatColumn) -> None:
        largest = float(values.max())
        if largest > self._largest:
            self._largest, self._at_largest = largest, 0
        self._at_largest += int(np.count_nonzero(values == self._largest))
        self._driving += np.bincount(_steps(values[values > 0.0]), minlength=_STEPS)

    def hints(self) -> list[str]:
        """Return what the torque cannot be, one sentence each."""
        return [hint for hint in (self._repeated(), self._limited()) if hint]

    def _repeated(self) -> str:
        """Return that a torque comes oftener than it is renewed, '' where it does not."""
        if self._changes[0].sum() < _FEWEST:
            return ""
        message_s, renewed_s = _quantile(self._messages, 0.5), _quantile(self._changes, _SOONEST)
        if renewed_s < max(_SOON_S, _MESSAGES * message_s) or (self._stated_s or 0.0) > _STATED * renewed_s:
            return ""
        found = (
            f"signals.{self._role} comes every {message_s:.2g} s and never changes within {renewed_s:.2g} s: "
            "somebody repeats it, and in between it is of the past"
        )
        if renewed_s > _JITTER * SLOWEST_PERIOD_S:
            return f"{found}. Expected every {SLOWEST_PERIOD_S:g} s or oftener"
        stated_s = min(renewed_s, SLOWEST_PERIOD_S)
        return f"{found}. With period_s: {stated_s:.2g} its reports are joined, and estimates are that later"

    def _limited(self) -> str:
        """Return that a torque stops at one number, '' where it does not."""
        full = self._role == "engine_torque_pct" and self._largest >= _FULL_PCT
        driving = int(self._driving.sum())
        if full or driving < _LEAST_SAMPLES or self._at_largest < _AT_LARGEST * driving:
            return ""
        top = int(_steps(np.array([self._largest]))[0])
        below = int(self._driving[max(top - _BELOW, 0) : top + 1].sum()) - self._at_largest
        if self._at_largest < _TIMES * below:
            return ""
        share = 100 * self._at_largest / driving
        return (
            f"signals.{self._role} is exactly {self._largest:g}, its largest value, in {share:.0f} % of the "
            "samples that drive: does the sender or the DBC end its range there? Then masses are too small"
        )


def _steps(values: FloatColumn) -> IntColumn:
    """Return the step of positive numbers (n,)."""
    steps = np.log(np.maximum(values / _SMALLEST, 1.0)) / _STEP
    return np.minimum(steps.astype(np.int64), _STEPS - 1)


def _count(histogram: FloatColumn, intervals_us: IntColumn | FloatColumn) -> None:
    """Add intervals to a histogram (2, bins): their number and their sum in s."""
    seconds = np.asarray(intervals_us, np.float64) * 1e-6
    seconds = seconds[(seconds > 0.0) & (seconds < _LONGEST_S)]
    octaves = np.log2(np.maximum(seconds / _LEAST_S, 1.0))
    bins = np.minimum((_PER_OCTAVE * octaves).astype(np.int64), _BINS - 1)
    histogram += np.bincount(bins, minlength=_BINS), np.bincount(bins, seconds, minlength=_BINS)


def _quantile(histogram: FloatColumn, share: float) -> float:
    """Return the mean interval of the bin that a share of all lies below, s."""
    below = np.cumsum(histogram[0])
    at = int(np.searchsorted(below, share * below[-1]))
    number, seconds = histogram[:, min(at, _BINS - 1)]
    return float(seconds / number) if number else 0.0
