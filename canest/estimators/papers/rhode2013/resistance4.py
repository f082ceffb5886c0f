"""The four-parameter driving-resistance model with a grade signal (`resistance4`): 2013 paper, eqs. 9-11.

B = F, the traction less everything known but drag;  A = [g cos, a + g sin, g cos v, Faero]  of the measured
grade;  X = [m f_r0, m, m f_r1, (A c_x) / (A c_x)_config].
The fourth parameter is relative to the config's drag area: air density and effects stay the model's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from canest.core.errors import ConfigError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.autocorrelation import AutocorrelationInflation
from canest.estimators.description import Description, option
from canest.estimators.papers.kinematic import has_accelerometer
from canest.estimators.papers.measured_grade import MeasuredGrade, MeasuredGradeOptions
from canest.estimators.papers.outliers import OutlierOptions, OutlierStage
from canest.estimators.papers.prior import P_LIMIT, PRIOR_NOISE_N, SQRT12, prior_mass_kg
from canest.estimators.papers.rhode2013.multiple_forgetting import MultipleForgetting
from canest.estimators.regression import FORCE_LIMIT_N, usable

#: what rolling resistance and relative drag area can be on any road: f_r0, f_r1 in s/m, ratio
ROLLING_RANGE = (0.002, 0.02)
ROLLING_SPEED_RANGE = (0.0, 2e-4)
DRAG_RANGE = (0.3, 3.0)


class Resistance4Options(MeasuredGradeOptions):
    """Forgetting of each parameter, and where the grade comes from when no slope sensor sends it."""

    forgetting: tuple[float, float, float, float] = option(
        (0.9999, 0.9995, 0.9999, 0.9999),
        "λ of m f_r0, m, m f_r1 and the relative drag area (2013, Alg. 7)",
        allowed="four numbers, > 0, ≤ 1",
    )
    outliers: OutlierOptions | None = option(
        None, "distance-based outlier detection before learning (2013, section IV-B)",
        allowed="null, or the keys below",
    )  # fmt: skip


class Resistance4(MeasuredGrade):
    """Mass, rolling resistance and drag by RLSMF with projection, the grade being measured.

    The grade is the slope sensor's where there is one, else the accelerometer's (see `kinematic`); it is
    also what this estimator gives as its grade. `parameters` holds the four and their standard deviations.
    """

    descriptions = (
        Description(
            "resistance4",
            "mass, rolling resistance and drag at once, the grade being measured",
            "2013, eqs. 9-11",
            needs=("speed", "torque", "slope or longitudinal accelerometer"),
            options=Resistance4Options,
        ),
    )
    wants_excitation_gate = True
    grade_signals = "a grade signal: a slope sensor or a longitudinal accelerometer"

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        o = self.options
        if not all(0.0 < value <= 1.0 for value in o.forgetting):
            raise ConfigError(
                "wrong forgetting factors",
                where="estimator.options.forgetting",
                found=list(o.forgetting),
                expected="four numbers above 0, at most 1",
            )
        self._outliers = OutlierStage(o.outliers, 5) if o.outliers else None
        self.parameters: tuple[FloatColumn, FloatColumn] | None = None
        self._begin(prior_mass_kg(facts), None)

    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        facts, std = self.facts, self._spread if std_kg is None else std_kg
        low = np.array([facts.mass_min_kg * ROLLING_RANGE[0], facts.mass_min_kg, 0.0, DRAG_RANGE[0]])
        high = facts.mass_max_kg * np.array([ROLLING_RANGE[1], 1.0, ROLLING_SPEED_RANGE[1], 0.0])
        high[3] = DRAG_RANGE[1]
        prior = ((high - low) / SQRT12) ** 2 / PRIOR_NOISE_N**2
        p = prior.copy()
        p[1] = min(p[1], (std / PRIOR_NOISE_N) ** 2)
        start = np.clip(np.array([mass_kg * facts.rolling_resistance, mass_kg, 0.0, 1.0]), low, high)
        self._learner = MultipleForgetting(
            start, p, np.array(self.options.forgetting), low, high, P_LIMIT * prior, PRIOR_NOISE_N**2
        )
        self._held = np.array([[mass_kg], [min(std, self._spread)]])
        self._x, self._inflation = start[None], AutocorrelationInflation()

    def _update(self, block: ModelBlock) -> EstimateBlock:
        limit = self.options.grade_limit
        grade_at, grades, rows_at, specific_mps2, cosine = self._grades(block)
        found = self._hold(grade_at, grades, *self._learn(block, rows_at, specific_mps2, cosine), len(block))
        return replace(found, grade=np.clip(found.grade, -limit, limit))

    def _grades(
        self, block: ModelBlock
    ) -> tuple[IntColumn, FloatColumn, IntColumn, FloatColumn, FloatColumn]:
        """Return where there is a grade, it and its std; where the regression can use it, a + g sin, cos."""
        limit = self.options.grade_limit
        sensor = np.abs(block.slope) <= 1.0
        at, sine, variance = self._kinematic(block)
        cosine2 = 1.0 - np.minimum(sine * sine, 0.5)
        measured, std = np.full(len(block), np.nan), np.full(len(block), self._offset)
        measured[at] = sine / np.sqrt(cosine2)
        std[at] = np.sqrt(variance + self._offset * self._offset)
        measured = np.clip(np.where(sensor, block.slope, measured), -limit, limit)
        here = np.flatnonzero(~np.isnan(measured))
        use = np.flatnonzero(usable(block) & ~np.isnan(measured) & (np.abs(block.aero_N) < FORCE_LIMIT_N))
        slope, accel = measured[use], block.accel_mps2[use]
        cosine = 1.0 / np.sqrt(1.0 + slope * slope)
        direct = (has_accelerometer(block) & ~sensor)[use]
        sensed = np.where(direct, block.accelerometer_mps2[use], 0.0)
        by_sensor = sensed - (GRAVITY_MPS2 * self._pitch) * accel
        specific_mps2 = np.where(direct, by_sensor, accel + GRAVITY_MPS2 * slope * cosine)
        return here, np.stack((measured[here], std[here])), use, specific_mps2, cosine

    def _learn(
        self, block: ModelBlock, at: IntColumn, specific_mps2: FloatColumn, cosine: FloatColumn
    ) -> tuple[IntColumn, FloatColumn]:
        """Learn from the rows at ``at``; return their positions, mass and its std, shape (2, k)."""
        weight, aero = GRAVITY_MPS2 * cosine, block.aero_N[at]
        force = block.force_N[at] + aero
        rows = np.stack((weight, specific_mps2, weight * block.speed_mps[at], aero, force), axis=1)
        if self._outliers is not None:
            at, rows = self._outliers(at, rows)
        a, b = np.ascontiguousarray(rows[:, :4]), rows[:, 4]
        x, variance = self._learner.add(a, b)
        before = np.concatenate((self._x, x))[: len(x)]
        product = a * before
        variance *= self._inflation(b - product[:, 0] - product[:, 1] - product[:, 2] - product[:, 3])[
            :, None
        ]
        self._x = np.concatenate((self._x, x))[-1:]
        if len(at):
            self.parameters = (x[-1], np.sqrt(variance[-1]))
        return at, np.stack((x[:, 1], np.minimum(np.sqrt(variance[:, 1]), self._spread)))
