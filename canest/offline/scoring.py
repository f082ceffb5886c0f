"""Estimates against truth, streamed: errors as the summary reports them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, IntColumn, MonotonicClock
from canest.logs.truth import Truth

if TYPE_CHECKING:
    from canest.core.estimates import Estimates
    from canest.offline.leg import Leg


#: truth this far beyond its first and last row still counts (it is sampled slower than the estimates)
TRUTH_REACH_US = 200_000


class Reference(NamedTuple):
    """What estimates are compared with; see `Score` for the three."""

    truth: Truth | None = None
    mass_kg: float | None = None
    after_s: float = 60.0

    @property
    def known(self) -> bool:
        """Return whether there is anything to compare with."""
        return self.truth is not None or self.mass_kg is not None

    def score(self, *, settled: bool = False) -> Score:
        """Return a fresh score against it. settled: it counts the settled samples, of an empty log none."""
        score = Score(self.truth, self.mass_kg, self.after_s)
        score.settled_samples = 0 if settled else None
        return score


class ErrorSum:
    """Sums the errors of mass and grade over samples that have an estimate and a truth."""

    def __init__(self) -> None:
        self.mass_samples = self.grade_samples = 0
        self.mass_square_pct2 = self.grade_square_deg2 = 0.0
        self.mass_max_pct = 0.0

    def add(self, mass_pct: FloatColumn, grade_deg: FloatColumn) -> None:
        """Take errors (n,), NaN where they are not known."""
        known = mass_pct[np.isfinite(mass_pct)]
        self.mass_samples += len(known)
        self.mass_square_pct2 += float(known @ known)
        self.mass_max_pct = max(self.mass_max_pct, float(np.abs(known).max(initial=0.0)))
        known = grade_deg[np.isfinite(grade_deg)]
        self.grade_samples += len(known)
        self.grade_square_deg2 += float(known @ known)

    def merge(self, other: ErrorSum) -> None:
        """Add what another sum has counted."""
        self.mass_samples += other.mass_samples
        self.grade_samples += other.grade_samples
        self.mass_square_pct2 += other.mass_square_pct2
        self.grade_square_deg2 += other.grade_square_deg2
        self.mass_max_pct = max(self.mass_max_pct, other.mass_max_pct)

    def figures(self) -> dict[str, float | None]:
        """Return RMS and largest error of the mass (%) and RMS of the grade (degrees); None without any."""
        mass, grade = self.mass_samples, self.grade_samples
        return {
            "mass_rms_pct": (self.mass_square_pct2 / mass) ** 0.5 if mass else None,
            "mass_max_pct": self.mass_max_pct if mass else None,
            "grade_rms_deg": (self.grade_square_deg2 / grade) ** 0.5 if grade else None,
        }


class Score:
    """Sums errors over all samples, gated ones too, from `after_s` after the first sample on.

    Beside them, from the first sample on, over those that are settled (see `canest.offline.legs`).
    A sample without an estimate or without truth is not counted; `without_estimate` counts those of
    the first kind. Time goes on where the log's clock was set back.

    truth: table by the log's own stamps, interpolated linearly at each sample; its row for a stamp goes
    for every sample with that stamp. mass_kg: a constant true mass, wins over the table's.
    """

    def __init__(self, truth: Truth | None, mass_kg: float | None = None, after_s: float = 60.0) -> None:
        self._truth, self._mass_kg, self.after_s = truth, mass_kg, after_s
        self._monotonic = MonotonicClock()
        self._first_us: int | None = None
        self._span_us: tuple[int, int] | None = None  # earliest and latest stamp
        self._all, self._settled = ErrorSum(), ErrorSum()
        self.without_estimate = 0
        self.settled_samples: int | None = None

    @property
    def mass_samples(self) -> int:
        """Return over how many samples the mass has been scored."""
        return self._all.mass_samples

    def add(self, estimates: Estimates, settled: BoolColumn | None = None) -> None:
        """Take the next estimates (n), and where known which of them are settled (n,)."""
        if not len(estimates):
            return
        if self._first_us is None:
            self._first_us = int(estimates.t_us[0])
        first, last = self._span_us or (self._first_us, self._first_us)
        self._span_us = min(first, int(estimates.t_us.min())), max(last, int(estimates.t_us.max()))
        late = self._monotonic(estimates.t_us) - self._first_us >= round(self.after_s * 1e6)
        if settled is None:
            settled = np.zeros(len(estimates), np.bool_)
        else:
            self.settled_samples = (self.settled_samples or 0) + int(np.count_nonzero(settled))
        counted = late | settled
        if not counted.any():
            return
        mass_kg, grade = self.truth_at(estimates.t_us[counted])
        with np.errstate(invalid="ignore"):
            mass_pct = 100.0 * (estimates.mass_kg[counted] / mass_kg - 1.0)
            grade_deg = np.degrees(np.arctan(estimates.grade[counted]) - np.arctan(grade))
        late, settled = late[counted], settled[counted]
        self.without_estimate += int(np.isnan(estimates.grade[counted][late]).sum())
        self._all.add(mass_pct[late], grade_deg[late])
        self._settled.add(mass_pct[settled], grade_deg[settled])

    def with_truth(self, legs: Sequence[Leg]) -> list[Leg]:
        """Return the legs with what they truly weighed, where the truth knows."""
        stamps = np.array([round((leg.mass_t_s or leg.from_s) * 1e6) for leg in legs], np.int64)
        masses, _ = self.truth_at(stamps)
        return [leg.with_truth(mass_kg) for leg, mass_kg in zip(legs, masses.tolist(), strict=True)]

    def truth_at(self, t_us: IntColumn) -> tuple[FloatColumn, FloatColumn]:
        """Return true mass (kg) and grade at the stamps (n,), NaN where nobody knows."""
        mass_kg = grade = np.full(len(t_us), np.nan)
        if self._truth is not None:
            times = self._truth.t_us
            known = (t_us >= times[0] - TRUTH_REACH_US) & (t_us <= times[-1] + TRUTH_REACH_US)
            if self._truth.mass_kg is not None:
                mass_kg = np.where(known, np.interp(t_us, times, self._truth.mass_kg), np.nan)
            if self._truth.grade is not None:
                grade = np.where(known, np.interp(t_us, times, self._truth.grade), np.nan)
        if self._mass_kg is not None:
            mass_kg = np.full(len(t_us), self._mass_kg)
        return mass_kg, grade

    def notes(self) -> list[str]:
        """Return what was wrong with the truth's table, and that it is of another time than the estimates."""
        if self._truth is None:
            return []
        notes = list(self._truth.notes)
        if self._span_us is None:
            return notes
        (begin, end), (first, last) = self._truth.t_us[[0, -1]].tolist(), self._span_us
        if begin > last + TRUTH_REACH_US or first > end + TRUTH_REACH_US:
            notes.append(
                f"the truth is of another time, t_s {begin / 1e6:.0f} to {end / 1e6:.0f}, than the log's "
                f"{first / 1e6:.0f} to {last / 1e6:.0f}"
            )
        return notes

    def beyond(self, least_kg: float, most_kg: float) -> list[str]:
        """Return that the truth has a mass which the vehicle cannot have, nothing where it has none."""
        table = None if self._truth is None else self._truth.mass_kg
        masses = np.array([self._mass_kg]) if self._mass_kg is not None else table
        if masses is None or not np.isfinite(masses).any():
            return []
        lightest, heaviest = float(np.nanmin(masses)), float(np.nanmax(masses))
        for mass_kg, bound, bound_kg, wrong in (
            (lightest, "mass_min_kg", least_kg, lightest < least_kg),
            (heaviest, "mass_max_kg", most_kg, heaviest > most_kg),
        ):
            if wrong:
                return [
                    f"the true mass {mass_kg:,.0f} kg is beyond vehicle.{bound} = {bound_kg:,.0f} kg: "
                    "another vehicle's truth, another unit, or the bound is wrong"
                ]
        return []

    def merge(self, other: Score) -> None:
        """Add what another log scored (pooled errors)."""
        self._all.merge(other._all)
        self._settled.merge(other._settled)
        self.without_estimate += other.without_estimate
        if other.settled_samples is not None:
            self.settled_samples = (self.settled_samples or 0) + other.settled_samples

    def errors(self) -> dict[str, Any]:
        """Return the `errors` of summary.json; null where nothing could be counted."""
        errors: dict[str, Any] = {
            **self._all.figures(),
            "after_s": self.after_s,
            "without_estimate": self.without_estimate,
        }
        if self.settled_samples is not None:
            errors["settled"] = {**self._settled.figures(), "samples": self.settled_samples}
        return errors
