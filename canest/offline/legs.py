"""Finds the load legs of a drive while its estimates stream by; memory does not grow with the log."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.estimates import Estimates
from canest.core.frames import BoolColumn, FloatColumn, IntColumn, MonotonicClock
from canest.core.samples import RATE_HZ, STATUS_LABELS, STEP_S, EstimateBlock, ModelBlock, Status
from canest.offline.leg import Leg, load_legs

#: in a pause of this length the load may change (a bus stop takes ten seconds, a pallet takes longer)
LOAD_STOP_S = 10.0
#: a shorter pause is none: a speed signal drops out, a vehicle rocks
SHORTEST_STOP_S = 3.0
#: who moves less than this between two stops manoeuvres where it stands: about a vehicle's length
MANOEUVRE_M = 20.0
#: rises and falls of the road below this are noise of the estimated grade
RISE_M = 2.0
_PER_S = int(RATE_HZ)


class LastValid(NamedTuple):
    """The newest estimate whose status was valid."""

    t_s: float
    mass_kg: float
    mass_std_kg: float


class Motion:
    """A pipeline's listener: how fast the vehicle moved at every sample."""

    def __init__(self) -> None:
        self._parts: list[FloatColumn] = []

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples."""
        self._parts.append(np.where(samples.stopped, 0.0, np.abs(samples.raw_speed_mps)))

    def taken(self) -> FloatColumn:
        """Return the speeds since the last call, m/s (n,): 0 while standing, NaN where not known."""
        speed = np.concatenate(self._parts) if self._parts else np.empty(0)
        self._parts.clear()
        return speed


class Legs:
    """Cuts a drive where the load may have changed.

    last_valid: the newest valid estimate, standing or not. driving_s: time in motion.
    """

    def __init__(self) -> None:
        self.last_valid: LastValid | None = None
        self.driving_s = 0.0
        self._valid_s = 0.0
        self._done: list[Leg] = []
        self._open: _OpenLeg | None = None
        self._monotonic = MonotonicClock()
        self._moved_us: int | None = None  #: when it last moved, in time that only goes on

    @property
    def valid_share(self) -> float:
        """Return the share of the time in motion in which the status was valid, 0 to 1."""
        return self._valid_s / self.driving_s if self.driving_s else 0.0

    def add(self, estimates: Estimates, speed_mps: FloatColumn) -> BoolColumn:
        """Take the next estimates with their speeds (n,), 0 while standing, NaN where not known.

        Return which samples (n,) are settled: in motion, in a leg whose mass has been valid.
        """
        e, settled = estimates, np.zeros(len(estimates), np.bool_)
        self._note_last_valid(e)
        time_us = self._monotonic(e.t_us)
        rows = np.flatnonzero(speed_mps > 0.0)
        if not len(rows):
            return settled
        before_us = time_us[rows[0]] if self._moved_us is None else self._moved_us
        pause_s = np.diff(time_us[rows], prepend=before_us) * 1e-6
        self._moved_us = int(time_us[rows[-1]])
        edges = np.flatnonzero(pause_s >= LOAD_STOP_S).tolist()
        for part, (start, end) in enumerate(zip([0, *edges], [*edges, len(rows)], strict=True)):
            if part:
                self._close()
            if end > start:
                at = rows[start:end]
                leg = self._open = self._open or _OpenLeg(int(e.t_us[at[0]]), int(time_us[at[0]]))
                # the pause before a leg is not one of its stops
                stops = int(np.count_nonzero(pause_s[start + bool(part) : end] >= SHORTEST_STOP_S))
                settled[at] = leg.add(_Moving.of(e, speed_mps, at), stops)
                leg.passed_us = leg.passed_us[0], int(time_us[at[-1]])
        valid = e.status[rows] == Status.VALID
        self.driving_s += len(rows) * STEP_S
        self._valid_s += int(np.count_nonzero(valid)) * STEP_S
        return settled

    def legs(self) -> list[Leg]:
        """Return the legs so far, those of one load merged, the loads numbered from 1."""
        is_leg = self._open is not None and self._open.distance_m >= MANOEUVRE_M
        return load_legs([*self._done, self._open.leg()] if self._open and is_leg else self._done)

    def _close(self) -> None:
        if self._open is not None and self._open.distance_m >= MANOEUVRE_M:
            self._done.append(self._open.leg())
        self._open = None

    def _note_last_valid(self, e: Estimates) -> None:
        valid = np.flatnonzero(e.status == Status.VALID)
        if len(valid):
            at = int(valid[-1])
            self.last_valid = LastValid(
                float(e.t_us[at]) / 1e6, float(e.mass_kg[at]), float(e.mass_std_kg[at])
            )


class _Moving(NamedTuple):
    """Samples of one leg, all in motion."""

    t_us: IntColumn
    speed_mps: FloatColumn
    mass_kg: FloatColumn
    mass_std_kg: FloatColumn
    grade: FloatColumn
    status: NDArray[np.uint8]

    @staticmethod
    def of(e: Estimates, speed_mps: FloatColumn, at: IntColumn) -> _Moving:
        """Return the samples at ``at``."""
        return _Moving(e.t_us[at], speed_mps[at], e.mass_kg[at], e.mass_std_kg[at], e.grade[at], e.status[at])


class _OpenLeg:
    """A leg that has not ended."""

    def __init__(self, t_us: int, passed_us: int) -> None:
        self.distance_m = 0.0
        self.passed_us = passed_us, passed_us
        self._first_us = self._last_us = t_us
        self._samples = self._valid_samples = self._stops = 0
        self._status = Status.UNESTIMATED
        self._mass: tuple[int, float, float] | None = None
        self._climb = _Climb()

    def add(self, s: _Moving, stops: int) -> BoolColumn:
        """Take the next samples; return from which on the mass has been valid in this leg."""
        self._last_us = int(s.t_us[-1])
        ahead_m = s.speed_mps * STEP_S
        self.distance_m += float(ahead_m.sum())
        self._climb.add(np.nan_to_num(ahead_m * s.grade / np.sqrt(1.0 + s.grade * s.grade)))
        self._stops += stops
        self._samples += len(s.t_us)
        valid = s.status == Status.VALID
        settled: BoolColumn = np.logical_or.accumulate(valid) | (self._valid_samples > 0)
        self._valid_samples += int(np.count_nonzero(valid))
        best = Status.VALID if self._valid_samples else Status.CONVERGING
        found = np.flatnonzero((s.status == best) & np.isfinite(s.mass_kg))
        if len(found):
            at = int(found[-1])
            self._mass = int(s.t_us[at]), float(s.mass_kg[at]), float(s.mass_std_kg[at])
            self._status = best
        return settled

    def leg(self) -> Leg:
        """Return what it is so far."""
        t_us, mass_kg, std_kg = self._mass or (None, None, None)
        return Leg(
            from_s=self._first_us / 1e6,
            to_s=self._last_us / 1e6,
            mass_kg=mass_kg,
            mass_std_kg=std_kg,
            valid_share=self._valid_samples / self._samples,
            mass_t_s=None if t_us is None else t_us / 1e6,
            distance_m=self.distance_m,
            climb_m=self._climb.climb_m,
            driving_s=self._samples * STEP_S,
            stops=self._stops,
            status=STATUS_LABELS[self._status],
            passed_us=self.passed_us,
        )


class _Climb:
    """Sums the rises of a height that is looked at once in a second of driving."""

    def __init__(self) -> None:
        self.climb_m = 0.0
        self._samples = 0
        self._height_m = self._turned_m = 0.0

    def add(self, rise_m: FloatColumn) -> None:
        """Take how much higher every sample is than the one before, m (n,)."""
        heights = self._height_m + np.cumsum(rise_m)
        self._height_m = float(heights[-1])
        first = -self._samples % _PER_S
        self._samples += len(rise_m)
        for height_m in heights[first::_PER_S].tolist():
            risen_m = height_m - self._turned_m
            if abs(risen_m) >= RISE_M:
                self.climb_m += max(risen_m, 0.0)
                self._turned_m = height_m
