"""What `pmg` and `resistance4` share: a grade that is measured, and a mass that is learned beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, EstimateBlock, VehicleFacts
from canest.estimators.description import option
from canest.estimators.options import Options
from canest.estimators.papers.inverse_mass import GRADE_LIMIT_TEXT
from canest.estimators.papers.kinematic import KinematicGrade
from canest.estimators.papers.learned_mass import LearnedMass
from canest.estimators.papers.prior import SQRT12, prior_mass_std_kg
from canest.estimators.sample_hold import rows_until


class MeasuredGradeOptions(Options):
    """How the grade follows from the accelerometer."""

    buffer_s: float = option(
        0.5,
        "window over which the grade signal counts as calm or bouncing",
        unit="s",
        gt=0.02,
        le=60.0,
    )
    memory_s: float = option(1.0, "memory of the grade", unit="s", gt=0.02, le=600.0)
    calm: float = option(
        0.005, "standard deviation of the raw grade below which all samples count alike", unit="ratio",
        gt=0.0, le=1.0,
    )  # fmt: skip
    offset_mps2: float = option(
        0.05, "unknown offset of the accelerometer, one standard deviation: part of the grade's own",
        unit="m/s²", ge=0.0, le=5.0,
    )  # fmt: skip
    grade_limit: float = option(0.25, GRADE_LIMIT_TEXT, unit="ratio", gt=0.0, le=1.0)


class MeasuredGrade(LearnedMass):
    """Mass and grade are held apart: each sample has those of the last row at or before it."""

    #: what the vehicle must send, for `missing`
    grade_signals: ClassVar[str]

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        o = self.options
        self._pitch = facts.pitch_rad_per_mps2 or 0.0
        self._kinematic = KinematicGrade(self._pitch, o.buffer_s, o.memory_s, o.calm)
        self._offset = o.offset_mps2 / GRAVITY_MPS2
        self._spread = prior_mass_std_kg(facts)
        self._held_grade = np.array([[facts.initial_grade or 0.0], [o.grade_limit / SQRT12]])
        self._seen = False

    def missing(self) -> str:
        """Return why there is nothing to work with ('' when there is)."""
        return "" if self.facts.has_accelerometer or self._seen else f"needs {self.grade_signals}"

    def _hold(
        self, grade_at: IntColumn, grades: FloatColumn, mass_at: IntColumn, masses: FloatColumn, n: int
    ) -> EstimateBlock:
        """Return n samples' estimates from grades (2, j) at ``grade_at`` and masses (2, k) at ``mass_at``."""
        self._seen = self._seen or len(grade_at) > 0
        joined = np.concatenate((self._held_grade, grades), axis=1)
        grade, grade_std = joined[:, rows_until(grade_at, n)]
        self._held_grade = joined[:, -1:]
        count = rows_until(mass_at, n)
        joined = np.concatenate((self._held, masses), axis=1)
        mass, mass_std = joined[:, count]
        self._held = joined[:, -1:]
        confirmed = self._confirmed | (count > 0)
        self._confirmed = self._confirmed or len(mass_at) > 0
        return EstimateBlock(mass, mass_std, grade, grade_std, self._status.update(confirmed, mass, mass_std))
