"""What all estimators of [1/M, sin(beta + beta_mu)] share: start, hold over gates, numbers out.

A method only says how it learns from rows (`_start`, `_learn`); everything a user sees (bounds,
standard deviations, status, the batch start of section 5.2 of the 2005 paper) is written once, here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import fsum
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field

from canest.core.frames import FloatColumn
from canest.core.samples import RATE_HZ, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.autocorrelation import Runs
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.hold import rows_until
from canest.estimators.options import Options, parse
from canest.estimators.papers.outliers import OutlierOptions, OutlierStage
from canest.estimators.regression import (
    Integrator,
    Regression,
    differentiated,
    grade_of,
    grade_std_of,
    theta2_of,
    theta2_range,
)
from canest.estimators.status import StatusTracker

#: acceleration noise that scales prior covariances (P is in units of theta^2 per y^2), m/s2
PRIOR_NOISE_MPS2 = 0.05
#: P never exceeds this multiple of the prior's (2005, section 4.1: limit the growth of the covariance)
P_LIMIT = 10.0
#: step of the running variance of the innovation: a memory of ten seconds
VARIANCE_ALPHA = 1.0 / (10.0 * RATE_HZ)
SQRT12 = float(np.sqrt(12.0))

Number = TypeVar("Number", float, FloatColumn)


class TwoParameterOptions(Options):
    """Options that every two-parameter method has."""

    #: eq. 2 (dv/dt) or eq. 24 (speed gained over a sliding window)
    regression: Literal["differentiated", "integrated"] = "differentiated"
    #: longest window of the integrated regression
    window_s: float = Field(1.0, gt=0.02, le=60.0)
    #: "batch": least squares on the first seconds; "given": the initial mass; "auto": given if there is one
    start: Literal["auto", "batch", "given"] = "auto"
    #: length of the batch start (2005, section 5.2: four seconds)
    batch_s: float = Field(4.0, ge=0.1, le=600.0)
    #: grades beyond this are projected back (2013, Alg. 8)
    grade_limit: float = Field(0.25, gt=0.0, le=1.0)
    #: initial diagonal of P; None: from the spread of the bounds
    p0: tuple[float, float] | None = None
    #: distance-based outlier detection before learning (2013, section IV-B), or None
    outliers: OutlierOptions | None = None


@dataclass(slots=True)
class Box:
    """Bounds of theta for parameter projection, and the variances of a uniform prior over them."""

    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def variance(self) -> tuple[float, float]:
        """Return the variance of a uniform distribution over each range."""
        return (
            ((self.high[0] - self.low[0]) / SQRT12) ** 2,
            ((self.high[1] - self.low[1]) / SQRT12) ** 2,
        )

    def clip(self, theta: tuple[float, float]) -> tuple[float, float]:
        """Return theta projected onto the box (2013, Alg. 8)."""
        return (
            min(max(theta[0], self.low[0]), self.high[0]),
            min(max(theta[1], self.low[1]), self.high[1]),
        )


class TwoParameter(ChunkedEstimator):
    """An estimator of [1/M, sin(beta + beta_mu)]; subclasses learn, this class does the rest."""

    Options: ClassVar[type[TwoParameterOptions]] = TwoParameterOptions

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options: Any = parse(self.Options, options)
        low2, high2 = theta2_range(self.options.grade_limit)
        self.box = Box((1.0 / facts.mass_max_kg, low2), (1.0 / facts.mass_min_kg, high2))
        integrated = self.options.regression == "integrated"
        self._rows = Integrator(self.options.window_s) if integrated else differentiated
        self._outliers = OutlierStage(self.options.outliers, 4) if self.options.outliers else None
        self._status = StatusTracker(bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._batch: list[FloatColumn] = []
        self._held = np.full((4, 1), np.nan)  # theta1, theta2 and their variances, then held as numbers
        self._ready = self._confirmed = False
        self._theta, self._runs = np.zeros((2, 1)), Runs()
        given = facts.initial_mass_kg is not None
        if self.options.start == "given" or (self.options.start == "auto" and given):
            self._start_given(prior_mass_kg(facts))

    # what a method provides

    @abstractmethod
    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        """Set the state: theta, P = (p11, p12, p22) in theta^2 / y^2, and the variance of y's noise."""

    @abstractmethod
    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        """Learn from rows in order; return theta1, theta2, var1, var2 after each row, shape (4, k)."""

    def _variances(self, p11: Number, p12: Number, p22: Number, variance: Number) -> tuple[Number, Number]:
        """Return the variances of theta of a method without forgetting, scalars or (k,) as what is given.

        p11, p12, p22: P, in theta^2 / y^2; variance: of y's noise. With A the prior's information in P^-1, of
        which the data's is the rest, it is the diagonal of P (variance (P^-1 - A) + prior variance A) P:
        quiet data are sharp where they say something; where they say nothing the doubt stays the prior's.
        """
        a1, a2 = self._prior_information
        more = np.maximum(PRIOR_NOISE_MPS2**2 - variance, 0.0)
        return (
            variance * p11 + more * (a1 * p11 * p11 + a2 * p12 * p12),
            variance * p22 + more * (a1 * p12 * p12 + a2 * p22 * p22),
        )

    # what all share

    def _update(self, block: ModelBlock) -> EstimateBlock:
        rows = self._good(self._rows(block))
        known, skip = self._fill_batch(rows)
        if self._ready and skip < len(rows.at):
            y, phi1, phi2 = rows.y[skip:], rows.phi1[skip:], rows.phi2[skip:]
            learned = self._learn(y, phi1, phi2)
            before = np.concatenate((self._theta, learned[:2]), axis=1)[:, :-1]
            learned[2:] *= self._runs(y - phi1 * before[0] - phi2 * before[1])
            self._theta = learned[:2, -1:]
            known = np.concatenate((known, learned), axis=1)
        numbers = np.concatenate((self._held, self._numbers(known, rows.mu)), axis=1)
        # the estimate of a sample is that of the last row at or before it (held through gates)
        count = rows_until(rows.at, len(block))
        mass, mass_std, grade, grade_std = numbers[:, count]
        confirmed = ~np.isnan(mass) & (self._confirmed | (count > 0))
        self._held = numbers[:, -1:]
        self._confirmed = self._confirmed or bool(known.shape[1] and not np.isnan(known[0, -1]))
        return EstimateBlock(mass, mass_std, grade, grade_std, self._status.update(confirmed, mass, mass_std))

    def _good(self, rows: Regression) -> Regression:
        """Drop outliers, where the options ask for it."""
        if self._outliers is None:
            return rows
        at, kept = self._outliers(rows.at, np.stack((rows.y, rows.phi1, rows.phi2, rows.mu), axis=1))
        return Regression(at, kept[:, 0], kept[:, 1], kept[:, 2], kept[:, 3])

    def snapshot(self) -> dict[str, Any]:
        """Return the mass and its standard deviation, where there is a confirmed one."""
        mass, std = float(self._held[0, 0]), float(self._held[1, 0])
        return {"mass_kg": mass, "mass_std_kg": std} if self._confirmed else {}

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass and its (already widened) standard deviation."""
        self._start_given(mass_kg, mass_std_kg)

    def _numbers(self, known: FloatColumn, mu: FloatColumn) -> FloatColumn:
        """Return mass, its std, grade, its std from theta and its variances (first order), shape (4, k)."""
        theta1, theta2, var1, var2 = known
        prior1, prior2 = self.box.variance
        std1, std2 = np.sqrt(np.minimum(var1, prior1)), np.sqrt(np.minimum(var2, prior2))
        mass = np.clip(1.0 / theta1, self.facts.mass_min_kg, self.facts.mass_max_kg)
        grade = grade_of(theta2, mu, self.options.grade_limit)
        mass_std = np.minimum(std1 * mass * mass, (self.facts.mass_max_kg - self.facts.mass_min_kg) / SQRT12)
        return np.stack((mass, mass_std, grade, grade_std_of(grade, theta2, std2)))

    def _prior_p(self, mass_kg: float, std_kg: float | None) -> tuple[float, float]:
        """Return the diagonal of P before any data: what the user or the bounds say, per noise variance."""
        if self.options.p0 is not None and std_kg is None:
            p0: tuple[float, float] = self.options.p0
            return p0
        var1, var2 = self.box.variance
        if std_kg is not None:
            var1 = min(var1, (std_kg / (mass_kg * mass_kg)) ** 2)
        return var1 / PRIOR_NOISE_MPS2**2, var2 / PRIOR_NOISE_MPS2**2

    def _prior_theta(self, mass_kg: float) -> tuple[float, float]:
        grade = self.facts.initial_grade or 0.0
        return self.box.clip((1.0 / mass_kg, theta2_of(grade, self.facts.rolling_resistance)))

    def _start_given(self, mass_kg: float, std_kg: float | None = None) -> None:
        """Start from a mass that somebody gave (or remembered)."""
        theta, (p1, p2) = self._prior_theta(mass_kg), self._prior_p(mass_kg, std_kg)
        self._prior_information = (1.0 / p1, 1.0 / p2)
        self._begin(theta, (p1, 0.0, p2), PRIOR_NOISE_MPS2**2)

    def _begin(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        self._start(theta, p, variance)
        self._theta, self._runs = np.array([[theta[0]], [theta[1]]]), Runs()
        self._ready, self._batch = True, []
        start = np.array([[theta[0]], [theta[1]], [p[0] * variance], [p[2] * variance]])
        self._held = self._numbers(start, np.array([self.facts.rolling_resistance]))

    def _fill_batch(self, rows: Regression) -> tuple[FloatColumn, int]:
        """Put rows into the batch until it is full, then start.

        Returns what is known after each row taken, shape (4, taken): nothing but after the last of the batch.
        """
        if self._ready:
            return np.empty((4, 0)), 0
        want = round(self.options.batch_s * RATE_HZ)
        have = sum(part.shape[1] for part in self._batch)
        taken = min(want - have, len(rows.at))
        self._batch.append(np.stack((rows.y, rows.phi1, rows.phi2))[:, :taken])
        known = np.full((4, taken), np.nan)
        if have + taken == want:
            held = self._held
            known[:, -1] = self._solve_batch(*np.concatenate(self._batch, axis=1).tolist())
            self._held = held
        return known, taken

    def _solve_batch(self, y: list[float], phi1: list[float], phi2: list[float]) -> tuple[float, ...]:
        """Start by least squares on the batch (2005, eq. 5 and section 5.2); return theta, var1, var2.

        The spread of the bounds joins as prior information, so that a batch without excitation (a
        constant force cannot part mass from grade) gives a wide start inside the bounds, not a wild one.
        `math.fsum` makes the sums exact, whatever the blocks they came in.
        """
        mass = prior_mass_kg(self.facts)
        t1, t2 = self._prior_theta(mass)
        p1, p2 = self._prior_p(mass, None)
        self._prior_information = (1.0 / p1, 1.0 / p2)
        n11 = fsum(a * a for a in phi1) + 1.0 / p1
        n12 = fsum(a * b for a, b in zip(phi1, phi2, strict=True))
        n22 = fsum(b * b for b in phi2) + 1.0 / p2
        b1 = fsum(a * c for a, c in zip(phi1, y, strict=True)) + t1 / p1
        b2 = fsum(b * c for b, c in zip(phi2, y, strict=True)) + t2 / p2
        determinant = n11 * n22 - n12 * n12
        theta = self.box.clip(((n22 * b1 - n12 * b2) / determinant, (n11 * b2 - n12 * b1) / determinant))
        p = (n22 / determinant, -n12 / determinant, n11 / determinant)
        errors = (c - a * theta[0] - b * theta[1] for a, b, c in zip(phi1, phi2, y, strict=True))
        variance = fsum(e * e for e in errors) / max(1, len(y) - 2)
        self._begin(theta, p, variance)
        return (*theta, *self._variances(*p, variance))


def prior_mass_kg(facts: VehicleFacts) -> float:
    """Return the start value of the mass: the user's, else the middle of the bounds."""
    if facts.initial_mass_kg is not None:
        return min(max(facts.initial_mass_kg, facts.mass_min_kg), facts.mass_max_kg)
    return 0.5 * (facts.mass_min_kg + facts.mass_max_kg)
