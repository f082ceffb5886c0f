"""Mass and grade by one extended Kalman filter (`ekf`): 2014 paper, eqs. 6-10.

Slips in the paper, put right here: "100 tan^-1 beta" for the grade in percent is 100 tan beta; "acausal"
processing is causal. The filter itself is in `ekf_filter`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import RATE_HZ, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.hold import rows_until
from canest.estimators.options import Options, parse
from canest.estimators.papers.kidambi2014.ekf_filter import EkfCore, Rows
from canest.estimators.papers.two_parameter import SQRT12, Box, prior_mass_kg
from canest.estimators.regression import grade_of, grade_std_of, theta2_of, theta2_range
from canest.estimators.status import StatusTracker


class EkfOptions(Options):
    """Options of the filter; Q and R are those of one step at ``rate_hz``."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        #: the paper gives no initial P for the filter; this is the one it gives for RLS
        "2014": {"q": (0.1, 1e-5, 25.0), "r": 100.0, "rate_hz": 30.0, "p0": (0.001, 10.0)},
    }

    #: process noise variances of v, (m/s)^2, of 1/m, 1/kg^2, and of sin(beta + beta_mu)
    q: tuple[float, float, float] = (1e-7, 1e-15, 2e-7)
    #: variance of the measured speed, (m/s)^2
    r: float = Field(1e-3, gt=0.0)
    #: rate that q and r belong to; at another rate the same noise densities hold
    rate_hz: float = Field(RATE_HZ, gt=0.0)
    #: initial variances of 1/m and sin(beta + beta_mu); None: from the spread of the bounds
    p0: tuple[float, float] | None = None
    #: grades beyond this are projected back
    grade_limit: float = Field(0.25, gt=0.0, le=1.0)

    @field_validator("q")
    @classmethod
    def _not_negative(cls, q: tuple[float, float, float]) -> tuple[float, float, float]:
        if min(q) < 0.0:
            raise ValueError("three variances, none negative")
        return q


class EkfBase(ChunkedEstimator):
    """What `ekf` and `ekf-select` share: options, bounds, start, numbers out."""

    wants_excitation_gate = True
    Options: ClassVar[type[EkfOptions]] = EkfOptions

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options: Any = parse(self.Options, options)
        low2, high2 = theta2_range(self.options.grade_limit)
        self.box = Box((1.0 / facts.mass_max_kg, low2), (1.0 / facts.mass_min_kg, high2))
        self._tracker = StatusTracker(bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._confirmed = self._before = False
        self._begin(prior_mass_kg(facts), None)

    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        grade = self.facts.initial_grade or 0.0
        theta = self.box.clip((1.0 / mass_kg, theta2_of(grade, self.facts.rolling_resistance)))
        variance = self.options.p0 or self.box.variance
        if std_kg is not None:
            variance = (min(variance[0], (std_kg / mass_kg**2) ** 2), variance[1])
        self._start(theta, variance)
        start = np.array([[theta[0]], [theta[1]], [variance[0]], [variance[1]]])
        self._held = self._numbers(start, np.array([self.facts.rolling_resistance]))

    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        raise NotImplementedError

    def _numbers(self, known: FloatColumn, mu: FloatColumn) -> FloatColumn:
        """Return mass, its std, grade, its std from theta and its variances (first order), shape (4, k)."""
        theta1, theta2, var1, var2 = known
        prior1, prior2 = self.box.variance
        std1, std2 = np.sqrt(np.minimum(var1, prior1)), np.sqrt(np.minimum(var2, prior2))
        mass = np.clip(1.0 / theta1, self.facts.mass_min_kg, self.facts.mass_max_kg)
        grade = grade_of(theta2, mu, self.options.grade_limit)
        mass_std = np.minimum(std1 * mass * mass, (self.facts.mass_max_kg - self.facts.mass_min_kg) / SQRT12)
        return np.stack((mass, mass_std, grade, grade_std_of(grade, theta2, std2)))

    def _hold(self, at: IntColumn, numbers: FloatColumn, n: int) -> EstimateBlock:
        """Return one estimate per sample: that of the last row at or before it."""
        all_numbers = np.concatenate((self._held, numbers), axis=1)
        count = rows_until(at, n)
        mass, mass_std, grade, grade_std = all_numbers[:, count]
        learned = self._confirmed | (count > 0)
        self._held = all_numbers[:, -1:]
        self._confirmed = self._confirmed or len(at) > 0
        return EstimateBlock(mass, mass_std, grade, grade_std, self._tracker.update(learned, mass, mass_std))

    def snapshot(self) -> dict[str, Any]:
        """Return the mass and its standard deviation, where there is a confirmed one."""
        mass, std = float(self._held[0, 0]), float(self._held[1, 0])
        return {"mass_kg": mass, "mass_std_kg": std} if self._confirmed else {}

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass and its (already widened) standard deviation."""
        self._begin(mass_kg, mass_std_kg)


class Ekf(EkfBase):
    """One extended Kalman filter; paused while a gate is closed, restarted at the measured speed after it."""

    names = ("ekf",)

    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        self._core = EkfCore(self.options, self.box, theta, variance)

    def _update(self, block: ModelBlock) -> EstimateBlock:
        rows = Rows(block, self._before)
        self._before = rows.after
        known = self._core.run(rows, 0, len(rows.at))
        return self._hold(rows.at, self._numbers(known[:4], rows.mu), len(block))
