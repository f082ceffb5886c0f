"""Parallel mass and grade from a longitudinal accelerometer (`pmg`): 2014 paper, eqs. 14-17.

Slip in the paper: eq. 17 has m_k on its own right-hand side; the innovation uses the mass before the update.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from canest.core import jit
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, STEP_S, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.autocorrelation import AutocorrelationInflation
from canest.estimators.description import Description, option
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack
from canest.estimators.papers.kinematic import has_accelerometer
from canest.estimators.papers.measured_grade import MeasuredGrade, MeasuredGradeOptions
from canest.estimators.papers.prior import P_LIMIT, PRIOR_NOISE_N, VARIANCE_ALPHA, prior_mass_kg
from canest.estimators.regression import usable


class PmgOptions(MeasuredGradeOptions):
    """Options of both halves."""

    forgetting: float = option(0.9998, "λ of the mass", gt=0.0, le=1.0)
    correlation_s: float = option(
        5.0, "memory of the correlation between acceleration and force", unit="s", gt=0.02, le=600.0
    )


class MassFilter(NamedTuple):
    """What the kernel needs: lambda, step of the correlation's memory, bounds of the mass, ceiling of P."""

    forgetting: float
    beta: float
    low: float
    high: float
    top: float


class Pmg(MeasuredGrade):
    """Grade from accelerometer and speed, gates closed or not; mass from force over specific force.

    The mass update is one-parameter RLS whose gain is multiplied by the correlation between acceleration and
    force (eq. 17), negative correlations counting as none.
    """

    descriptions = (
        Description(
            "pmg",
            "grade from the accelerometer, mass from its specific force",
            "2014, eqs. 14-17",
            needs=("speed", "torque", "longitudinal accelerometer"),
            options=PmgOptions,
        ),
    )
    grade_signals = "a longitudinal accelerometer"

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        o, top = self.options, P_LIMIT * (self._spread / PRIOR_NOISE_N) ** 2
        beta = STEP_S / o.correlation_s
        self._filter = MassFilter(o.forgetting, beta, facts.mass_min_kg, facts.mass_max_kg, top)
        self._begin(prior_mass_kg(facts), None)

    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        std = self._spread if std_kg is None else std_kg
        # mass, P, mean x, mean F, var x, var F, covariance, noise variance
        p = min((std / PRIOR_NOISE_N) ** 2, self._filter.top)
        self._state = [mass_kg, p, 0.0, 0.0, 0.0, 0.0, 0.0, PRIOR_NOISE_N**2]
        self._held = np.array([[mass_kg], [min(std, self._spread)]])
        self._mass_kg, self._inflation = mass_kg, AutocorrelationInflation()

    def _update(self, block: ModelBlock) -> EstimateBlock:
        return self._hold(*self._grades(block), *self._masses(block), len(block))

    def _grades(self, block: ModelBlock) -> tuple[IntColumn, FloatColumn]:
        at, sine, variance = self._kinematic(block)
        limit = self.options.grade_limit
        sine = np.clip(sine, -limit, limit)
        cosine2 = 1.0 - sine * sine
        grade = np.clip(sine / np.sqrt(cosine2), -limit, limit)
        std = np.sqrt(variance + self._offset * self._offset) / (cosine2 * np.sqrt(cosine2))
        return at, np.stack((grade, std))

    def _masses(self, block: ModelBlock) -> tuple[IntColumn, FloatColumn]:
        at = np.flatnonzero(usable(block) & has_accelerometer(block))
        specific_mps2 = block.accelerometer_mps2[at] - (GRAVITY_MPS2 * self._pitch) * block.accel_mps2[at]
        out, state = outputs(len(at), 2), state_in(self._state)
        columns = pack(specific_mps2 + GRAVITY_MPS2 * block.mu[at], block.force_N[at])
        learn_mass(*columns, self._filter, state, *out)
        self._state = state_out(state)
        masses = unpack(out[0])
        before = np.concatenate(([self._mass_kg], masses))[: len(masses)]
        if len(masses):
            self._mass_kg = float(masses[-1])
        wider = self._inflation(block.force_N[at] - before * (specific_mps2 + GRAVITY_MPS2 * block.mu[at]))
        return at, np.stack((masses, np.minimum(np.sqrt(unpack(out[1]) * wider), self._spread)))


@jit.kernel
def learn_mass(
    specific_mps2: Container,
    force: Container,
    settings: MassFilter,
    state: Container,
    mass: Container,
    variance: Container,
) -> None:
    """2014, eq. 17: one-parameter RLS of F = m f (specific force), its gain times the correlation of both."""
    m, p, mean_x, mean_f, var_x, var_f, cross, s = state
    forgetting, beta, low, high, top = settings
    for k in range(len(specific_mps2)):
        x = specific_mps2[k]
        f = force[k]
        dx = x - mean_x
        df = f - mean_f
        mean_x += beta * dx
        mean_f += beta * df
        var_x += beta * (dx * (x - mean_x) - var_x)
        var_f += beta * (df * (f - mean_f) - var_f)
        cross += beta * (dx * (f - mean_f) - cross)
        rho = 0.0
        if cross > 0.0:
            rho = min(cross / sqrt(var_x * var_f), 1.0)
        gain = p * x / (forgetting + x * p * x)
        e = f - m * x
        m += gain * rho * e
        p = min((1.0 - gain * x) * p / forgetting, top)
        m = min(max(m, low), high)
        s += VARIANCE_ALPHA * (e * e - s)
        mass[k] = m
        variance[k] = p * s
    state[0] = m
    state[1] = p
    state[2] = mean_x
    state[3] = mean_f
    state[4] = var_x
    state[5] = var_f
    state[6] = cross
    state[7] = s
