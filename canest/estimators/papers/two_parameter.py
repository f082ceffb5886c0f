"""Estimators of theta = [1/M, sin(beta + beta_mu)] by linear regression: batch start, rows, numbers out.

A method only defines how it learns from rows (`_start`, `_learn`); everything a user sees (bounds,
standard deviations, status, the batch start of section 5.2 of the 2005 paper) is written once.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from math import fsum
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import RATE_HZ, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.autocorrelation import AutocorrelationInflation
from canest.estimators.description import option
from canest.estimators.kernel_arrays import Container, outputs, unpack
from canest.estimators.papers.inverse_mass import InverseMassEstimator, InverseMassOptions
from canest.estimators.papers.outliers import OutlierOptions, OutlierStage
from canest.estimators.papers.prior import P_LIMIT, PRIOR_NOISE_MPS2, prior_mass_kg
from canest.estimators.regression import Integrator, Regression, differentiated

Number = TypeVar("Number", float, FloatColumn)


class TwoParameterOptions(InverseMassOptions):
    """Options that every two-parameter method has."""

    regression: Literal["differentiated", "integrated"] = option(
        "differentiated", "2005, eq. 2 (dv/dt) or eq. 24 (speed gained over a sliding window)"
    )
    window_s: float = option(1.0, "longest window of the integrated regression", unit="s", gt=0.02, le=60.0)
    start: Literal["auto", "batch", "given"] = option(
        "auto",
        "batch: least squares on the first seconds; given: the initial mass; auto: given, if there is one",
    )
    batch_s: float = option(
        4.0, "length of the batch start (2005, section 5.2: four seconds)", unit="s", ge=0.1, le=600.0
    )
    outliers: OutlierOptions | None = option(
        None, "distance-based outlier detection before learning (2013, section IV-B)",
        allowed="null, or the keys below",
    )  # fmt: skip


class Limits(NamedTuple):
    """Bounds of theta (projection) and ceilings of the covariance's diagonal, as kernels take them."""

    low1: float
    high1: float
    low2: float
    high2: float
    top1: float
    top2: float


class Known(NamedTuple):
    """What a kernel fills: theta and its variances after each row, (k,) each."""

    theta1: Container
    theta2: Container
    var1: Container
    var2: Container

    @staticmethod
    def empty(k: int) -> Known:
        """Return containers for k rows."""
        return Known(*outputs(k, 4))

    def columns(self) -> FloatColumn:
        """Return theta1, theta2, var1, var2, shape (4, k)."""
        return np.stack([unpack(column) for column in self])


class TwoParameter(InverseMassEstimator):
    """An estimator of [1/M, sin(beta + beta_mu)]; subclasses learn, this class does the rest."""

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        integrated = self.options.regression == "integrated"
        self._rows = Integrator(self.options.window_s) if integrated else differentiated
        self._outliers = OutlierStage(self.options.outliers, 4) if self.options.outliers else None
        self._batch: list[FloatColumn] = []
        self._ready = False
        self._theta, self._inflation = np.zeros((2, 1)), AutocorrelationInflation()
        given = facts.initial_mass_kg is not None
        if self.options.start == "given" or (self.options.start == "auto" and given):
            self._begin(prior_mass_kg(facts), None)

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
        little noise gives a small variance; without information it stays that of the prior.
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
            learned[2:] *= self._inflation(y - phi1 * before[0] - phi2 * before[1])
            self._theta = learned[:2, -1:]
            known = np.concatenate((known, learned), axis=1)
        return self._hold(rows.at, self._numbers(known, rows.mu), len(block))

    def _good(self, rows: Regression) -> Regression:
        """Drop outliers, where the options ask for it."""
        if self._outliers is None:
            return rows
        at, kept = self._outliers(rows.at, np.stack((rows.y, rows.phi1, rows.phi2, rows.mu), axis=1))
        return Regression(at, kept[:, 0], kept[:, 1], kept[:, 2], kept[:, 3])

    def _prior_p(self, mass_kg: float, std_kg: float | None) -> tuple[float, float]:
        """Return the diagonal of P before any data: by the user or the bounds, per noise variance."""
        if self.options.p0 is not None and std_kg is None:
            p0: tuple[float, float] = self.options.p0
            return p0
        var1, var2 = self.box.variance
        if std_kg is not None:
            var1 = min(var1, (std_kg / (mass_kg * mass_kg)) ** 2)
        return var1 / PRIOR_NOISE_MPS2**2, var2 / PRIOR_NOISE_MPS2**2

    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        """Start from a mass that somebody gave (or that was saved)."""
        p1, p2 = self._prior_p(mass_kg, std_kg)
        self._prior_information = (1.0 / p1, 1.0 / p2)
        self._begin_at(self._prior_theta(mass_kg), (p1, 0.0, p2), PRIOR_NOISE_MPS2**2)

    def _begin_at(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        self._start(theta, p, variance)
        self._theta, self._inflation = np.array([[theta[0]], [theta[1]]]), AutocorrelationInflation()
        self._ready, self._batch = True, []
        self._hold_start(theta, (p[0] * variance, p[2] * variance))

    def _ceiling(self, p: tuple[float, float, float]) -> tuple[float, float]:
        """Return the ceilings of P's diagonal: `P_LIMIT` times the prior's, at least the start's."""
        top1, top2 = (P_LIMIT * v / PRIOR_NOISE_MPS2**2 for v in self.box.variance)
        return max(top1, p[0]), max(top2, p[2])

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
        self._begin_at(theta, p, variance)
        return (*theta, *self._variances(*p, variance))
