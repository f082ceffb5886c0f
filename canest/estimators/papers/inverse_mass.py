"""What all estimators of theta = [1/M, sin(beta + beta_mu)] share: bounds, start, numbers out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import EstimateBlock, VehicleFacts
from canest.estimators.description import option
from canest.estimators.options import Options
from canest.estimators.papers.learned_mass import LearnedMass
from canest.estimators.papers.prior import SQRT12, prior_mass_std_kg
from canest.estimators.regression import grade_of, grade_std_of, theta2_of, theta2_range
from canest.estimators.sample_hold import rows_until

GRADE_LIMIT_TEXT = "grades beyond this are projected back (2013, Alg. 8)"


class InverseMassOptions(Options):
    """Options of every estimator of the inverse mass."""

    grade_limit: float = option(0.25, GRADE_LIMIT_TEXT, unit="ratio", gt=0.0, le=1.0)
    p0: tuple[float, float] | None = option(
        None, "initial covariance of 1/M and sin(β + β_mu); null: from the spread of the bounds",
        allowed="two numbers",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
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


class InverseMassEstimator(LearnedMass):
    """Bounds of theta, and its translation into mass and grade with their standard deviations."""

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        low2, high2 = theta2_range(self.options.grade_limit)
        self.box = Box((1.0 / facts.mass_max_kg, low2), (1.0 / facts.mass_min_kg, high2))
        self._held = np.full((4, 1), np.nan)

    def _prior_theta(self, mass_kg: float) -> tuple[float, float]:
        """Return theta of a mass and of the grade that the user gave (0 without one)."""
        grade = self.facts.initial_grade or 0.0
        return self.box.clip((1.0 / mass_kg, theta2_of(grade, self.facts.rolling_resistance)))

    def _hold_start(self, theta: tuple[float, float], variances: tuple[float, float]) -> None:
        """Give out theta, with its variances, until there is a row."""
        start = np.array([[theta[0]], [theta[1]], [variances[0]], [variances[1]]])
        self._held = self._numbers(start, np.array([self.facts.rolling_resistance]))

    def _numbers(self, known: FloatColumn, mu: FloatColumn) -> FloatColumn:
        """Return mass, its std, grade, its std from theta and its variances (first order), shape (4, k)."""
        theta1, theta2, var1, var2 = known
        prior1, prior2 = self.box.variance
        std1, std2 = np.sqrt(np.minimum(var1, prior1)), np.sqrt(np.minimum(var2, prior2))
        mass = np.clip(1.0 / theta1, self.facts.mass_min_kg, self.facts.mass_max_kg)
        grade = grade_of(theta2, mu, self.options.grade_limit)
        mass_std = np.minimum(std1 * mass * mass, prior_mass_std_kg(self.facts))
        return np.stack((mass, mass_std, grade, grade_std_of(grade, theta2, std2)))

    def _hold(self, at: IntColumn, numbers: FloatColumn, n: int) -> EstimateBlock:
        """Return one estimate per sample: that of the last row at or before it (held through gates).

        at: positions of the rows among the n samples, (k,). numbers: (4, k), as `_numbers` gives them.
        """
        joined = np.concatenate((self._held, numbers), axis=1)
        count = rows_until(at, n)
        mass, mass_std, grade, grade_std = joined[:, count]
        confirmed = ~np.isnan(mass) & (self._confirmed | (count > 0))
        self._held = joined[:, -1:]
        self._confirmed = self._confirmed or bool(len(at) and not np.isnan(numbers[0, -1]))
        return EstimateBlock(mass, mass_std, grade, grade_std, self._status.update(confirmed, mass, mass_std))
