"""`mean-mass`: the mean of F / (a + g (s + mu)) over samples with enough of it, on a road of known grade.

Newton's law, M (a + g sin(beta) + g mu cos(beta)) = F, gives a mass for every single sample once the grade is
known. Here the grade is assumed: an option, 0 without it. So this is an estimator for level test tracks, and
an example of how little one needs; on hills it is wrong, and its standard deviation does not know that.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from canest.core.samples import GRAVITY_MPS2, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.description import Description, option
from canest.estimators.options import Options
from canest.estimators.status import StatusTracker

#: neighbouring samples have passed the same filter: about this many of them are one independent value
SAMPLES_PER_VALUE = 50.0


class MeanMassOptions(Options):
    """What the road is taken for, and which samples count."""

    grade: float = option(0.0, "grade of the whole road", unit="ratio", ge=-0.3, le=0.3)
    least_mps2: float = option(
        0.3, "samples count where a + g (s + mu) is above this: a small divisor makes noise large",
        unit="m/s²", gt=0.0, le=5.0,
    )  # fmt: skip


class MeanMass(Estimator):
    """The mean of the samples' masses, and its standard deviation from their scatter."""

    valid_is_configured = True
    descriptions = (
        Description(
            "mean-mass",
            "mean of force over acceleration on a road of known grade",
            "Newton's second law",
            options=MeanMassOptions,
        ),
    )

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self._status = StatusTracker(self.valid_std, bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._sums = np.zeros((3, 1))  # number of values, their sum, the sum of their squares

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples, return their estimates (same length)."""
        n, grade = len(block), self.options.grade
        cosine = 1.0 / np.sqrt(1.0 + grade * grade)
        divisor = block.accel_mps2 + GRAVITY_MPS2 * cosine * (grade + block.mu)
        with np.errstate(divide="ignore", invalid="ignore"):
            mass = block.force_N / divisor
        # NaN fails every comparison: what is not known does not count
        use = (block.gate == 0) & (divisor > self.options.least_mps2) & (mass > 0.0) & np.isfinite(mass)
        value = np.where(use, mass, 0.0)
        # added up sample by sample, from the last block's end: any cut gives the same bits
        terms = np.concatenate((self._sums, np.stack((use.astype(float), value, value * value))), axis=1)
        sums = np.cumsum(terms, axis=1)[:, 1:] if n else terms[:, 1:]
        self._sums = sums[:, -1:] if n else self._sums
        count, total, squares = sums
        least = np.maximum(count, 1.0)
        mean = total / least
        variance = np.maximum(squares / least - mean * mean, 0.0) * SAMPLES_PER_VALUE / least
        learned = count >= SAMPLES_PER_VALUE
        low, high = self.facts.mass_min_kg, self.facts.mass_max_kg
        mass_kg = np.where(learned, np.clip(mean, low, high), np.nan)
        mass_std_kg = np.where(learned, np.sqrt(variance), np.nan)
        status = self._status.update(learned, mass_kg, mass_std_kg)
        return EstimateBlock(mass_kg, mass_std_kg, np.full(n, grade), np.full(n, np.nan), status)
