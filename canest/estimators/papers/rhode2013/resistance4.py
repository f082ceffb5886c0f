"""The four-parameter driving-resistance model with a grade signal (`resistance4`): 2013 paper, eqs. 9-11.

B = F, the traction less everything known but drag;  A = [g cos, a + g sin, g cos v, Faero]  of the measured
grade;  X = [m f_r0, m, m f_r1, (A c_x) / (A c_x)_config].
The fourth parameter is relative to the config's drag area: air density and effects stay the model's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from canest.core.errors import ConfigError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.autocorrelation import Runs
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.hold import rows_until
from canest.estimators.options import Options, parse
from canest.estimators.papers.kinematic import KinematicGrade, has_accelerometer
from canest.estimators.papers.outliers import OutlierOptions, OutlierStage
from canest.estimators.papers.rhode2013.multiple_forgetting import MultipleForgetting
from canest.estimators.papers.two_parameter import P_LIMIT, SQRT12, prior_mass_kg
from canest.estimators.regression import FORCE_LIMIT_N, usable
from canest.estimators.status import StatusTracker

#: force noise that scales the initial covariance, N
PRIOR_NOISE_N = 1000.0
#: what rolling resistance and relative drag area can be on any road: f_r0, f_r1 in s/m, ratio
ROLLING_RANGE = (0.002, 0.02)
ROLLING_SPEED_RANGE = (0.0, 2e-4)
DRAG_RANGE = (0.3, 3.0)


class Resistance4Options(Options):
    """Forgetting of each parameter, and where the grade comes from when no slope sensor sends it."""

    #: lambda of m f_r0, m, m f_r1 and the relative drag area (2013, Alg. 7)
    forgetting: tuple[float, float, float, float] = (0.9999, 0.9995, 0.9999, 0.9999)
    #: distance-based outlier detection before learning (2013, section IV-B), or None
    outliers: OutlierOptions | None = None
    #: as in `pmg`
    buffer_s: float = Field(0.5, gt=0.02, le=60.0)
    memory_s: float = Field(1.0, gt=0.02, le=600.0)
    calm: float = Field(0.005, gt=0.0, le=1.0)
    offset_mps2: float = Field(0.05, ge=0.0, le=5.0)
    #: grades beyond this are projected back
    grade_limit: float = Field(0.25, gt=0.0, le=1.0)


class Resistance4(ChunkedEstimator):
    """Mass, rolling resistance and drag by RLSMF with projection, the grade being measured.

    The grade is the slope sensor's where there is one, else the accelerometer's (see `kinematic`); it is
    also what this estimator gives as its grade. `parameters` holds the four and their standard deviations.
    """

    names = ("resistance4",)
    wants_excitation_gate = True

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        o = self.options = parse(Resistance4Options, options)
        if not all(0.0 < value <= 1.0 for value in o.forgetting):
            raise ConfigError(
                "wrong forgetting factors",
                where="estimator.options.forgetting",
                found=list(o.forgetting),
                expected="four numbers above 0, at most 1",
            )
        self._pitch = facts.pitch_rad_per_mps2 or 0.0
        self._kinematic = KinematicGrade(self._pitch, o.buffer_s, o.memory_s, o.calm)
        self._outliers = OutlierStage(o.outliers, 5) if o.outliers else None
        self._tracker = StatusTracker(bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._spread = (facts.mass_max_kg - facts.mass_min_kg) / SQRT12
        self._held_grade = np.array([[facts.initial_grade or 0.0], [o.grade_limit / SQRT12]])
        self._confirmed = self._seen = False
        self.parameters: tuple[FloatColumn, FloatColumn] | None = None
        self._begin(prior_mass_kg(facts), self._spread)

    def _begin(self, mass_kg: float, std_kg: float) -> None:
        facts = self.facts
        low = np.array([facts.mass_min_kg * ROLLING_RANGE[0], facts.mass_min_kg, 0.0, DRAG_RANGE[0]])
        high = facts.mass_max_kg * np.array([ROLLING_RANGE[1], 1.0, ROLLING_SPEED_RANGE[1], 0.0])
        high[3] = DRAG_RANGE[1]
        prior = ((high - low) / SQRT12) ** 2 / PRIOR_NOISE_N**2
        p = prior.copy()
        p[1] = min(p[1], (std_kg / PRIOR_NOISE_N) ** 2)
        start = np.array([mass_kg * facts.rolling_resistance, mass_kg, 0.0, 1.0])
        forgetting = np.array(self.options.forgetting)
        self._learner = MultipleForgetting(
            np.clip(start, low, high), p, forgetting, low, high, P_LIMIT * prior, PRIOR_NOISE_N**2
        )
        self._held_mass = np.array([[mass_kg], [min(std_kg, self._spread)]])
        self._x, self._runs = np.clip(start, low, high)[None], Runs()

    def missing(self) -> str:
        """Return why there is nothing to work with ('' when there is)."""
        if self.facts.has_accelerometer or self._seen:
            return ""
        return "needs a grade signal: a slope sensor or a longitudinal accelerometer"

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass and its (already widened) standard deviation."""
        self._begin(mass_kg, mass_std_kg)

    def snapshot(self) -> dict[str, Any]:
        """Return the mass and its standard deviation, where there is a confirmed one."""
        mass, std = float(self._held_mass[0, 0]), float(self._held_mass[1, 0])
        return {"mass_kg": mass, "mass_std_kg": std} if self._confirmed else {}

    def _update(self, block: ModelBlock) -> EstimateBlock:
        n, limit = len(block), self.options.grade_limit
        grade_at, grades, felt_at, felt, cosine = self._grades(block)
        count = rows_until(grade_at, n)
        grade, grade_std = np.concatenate((self._held_grade, grades), axis=1)[:, count]
        at, known = self._learn(block, felt_at, felt, cosine)
        numbers = np.concatenate((self._held_mass, known), axis=1)
        rows = rows_until(at, n)
        mass, mass_std = numbers[:, rows]
        learned = self._confirmed | (rows > 0)
        if n:
            self._held_grade = np.array([[grade[-1]], [grade_std[-1]]])
        self._held_mass = numbers[:, -1:]
        self._confirmed = self._confirmed or len(at) > 0
        grade = np.clip(grade, -limit, limit)
        return EstimateBlock(mass, mass_std, grade, grade_std, self._tracker.update(learned, mass, mass_std))

    def _grades(
        self, block: ModelBlock
    ) -> tuple[IntColumn, FloatColumn, IntColumn, FloatColumn, FloatColumn]:
        """Return where there is a grade, it and its std; where the regression can use it, a + g sin, cos."""
        limit = self.options.grade_limit
        offset = self.options.offset_mps2 / GRAVITY_MPS2
        sensor = np.abs(block.slope) <= 1.0
        at, sine, variance = self._kinematic(block)
        cosine2 = 1.0 - np.minimum(sine * sine, 0.5)
        measured, std = np.full(len(block), np.nan), np.full(len(block), offset)
        measured[at] = sine / np.sqrt(cosine2)
        std[at] = np.sqrt(variance + offset * offset)
        measured = np.clip(np.where(sensor, block.slope, measured), -limit, limit)
        here = np.flatnonzero(~np.isnan(measured))
        self._seen = self._seen or len(here) > 0
        use = np.flatnonzero(usable(block) & ~np.isnan(measured) & (np.abs(block.aero_N) < FORCE_LIMIT_N))
        slope, accel = measured[use], block.accel_mps2[use]
        cosine = 1.0 / np.sqrt(1.0 + slope * slope)
        direct = (has_accelerometer(block) & ~sensor)[use]
        sensed = np.where(direct, block.accelerometer_mps2[use], 0.0)
        by_sensor = sensed - (GRAVITY_MPS2 * self._pitch) * accel
        felt = np.where(direct, by_sensor, accel + GRAVITY_MPS2 * slope * cosine)
        return here, np.stack((measured[here], std[here])), use, felt, cosine

    def _learn(
        self, block: ModelBlock, at: IntColumn, felt: FloatColumn, cosine: FloatColumn
    ) -> tuple[IntColumn, FloatColumn]:
        """Learn from the rows at ``at``; return their positions, mass and its std, shape (2, k)."""
        weight, aero = GRAVITY_MPS2 * cosine, block.aero_N[at]
        force = block.force_N[at] + aero
        rows = np.stack((weight, felt, weight * block.speed_mps[at], aero, force), axis=1)
        if self._outliers is not None:
            at, rows = self._outliers(at, rows)
        a, b = np.ascontiguousarray(rows[:, :4]), rows[:, 4]
        x, variance = self._learner.add(a, b)
        before = np.concatenate((self._x, x))[: len(x)]
        product = a * before
        variance *= self._runs(b - product[:, 0] - product[:, 1] - product[:, 2] - product[:, 3])[:, None]
        self._x = np.concatenate((self._x, x))[-1:]
        if len(at):
            self.parameters = (x[-1], np.sqrt(variance[-1]))
        return at, np.stack((x[:, 1], np.minimum(np.sqrt(variance[:, 1]), self._spread)))
