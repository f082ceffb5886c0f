"""Parallel mass and grade from a longitudinal accelerometer (`pmg`): 2014 paper, eqs. 14-17.

Slip in the paper: eq. 17 has m_k on its own right-hand side; the innovation uses the mass before the update.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any

import numpy as np
from pydantic import Field

from canest.core import jit
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, STEP_S, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.autocorrelation import Runs
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.hold import rows_until
from canest.estimators.kernel_arrays import Container, give, room, state_in, state_out, take
from canest.estimators.options import Options, parse
from canest.estimators.papers.kinematic import KinematicGrade, has_accelerometer
from canest.estimators.papers.two_parameter import P_LIMIT, SQRT12, VARIANCE_ALPHA, prior_mass_kg
from canest.estimators.regression import usable
from canest.estimators.status import StatusTracker

#: force noise that scales the initial covariance, N
PRIOR_NOISE_N = 1000.0


class PmgOptions(Options):
    """Options of both halves."""

    #: lambda of the mass
    forgetting: float = Field(0.9998, gt=0.0, le=1.0)
    #: memory of the correlation between acceleration and force
    correlation_s: float = Field(5.0, gt=0.02, le=600.0)
    #: window over which the grade signal's variance tells calm from bouncing
    buffer_s: float = Field(0.5, gt=0.02, le=60.0)
    #: memory of the grade
    memory_s: float = Field(1.0, gt=0.02, le=600.0)
    #: standard deviation of the raw grade below which all samples count alike
    calm: float = Field(0.005, gt=0.0, le=1.0)
    #: unknown offset of the accelerometer, one standard deviation, m/s2: part of the grade's own
    offset_mps2: float = Field(0.05, ge=0.0, le=5.0)
    #: grades beyond this are projected back
    grade_limit: float = Field(0.25, gt=0.0, le=1.0)


class Pmg(ChunkedEstimator):
    """Grade from accelerometer and speed whatever the gates say; mass from force over what is felt.

    The mass update is one-parameter RLS whose gain is multiplied by the correlation between acceleration and
    force (eq. 17), negative correlations counting as none.
    """

    names = ("pmg",)

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options: Any = parse(PmgOptions, options)
        o = self.options
        self._pitch = facts.pitch_rad_per_mps2 or 0.0
        self._grade = KinematicGrade(self._pitch, o.buffer_s, o.memory_s, o.calm)
        self._tracker = StatusTracker(bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._spread = (facts.mass_max_kg - facts.mass_min_kg) / SQRT12
        self._top = P_LIMIT * (self._spread / PRIOR_NOISE_N) ** 2
        self._held_grade = np.array([[facts.initial_grade or 0.0], [o.grade_limit / SQRT12]])
        self._confirmed = self._seen = False
        self._begin(prior_mass_kg(facts), self._spread)

    def _begin(self, mass_kg: float, std_kg: float) -> None:
        # mass, P, mean x, mean F, var x, var F, covariance, noise variance
        p = min((std_kg / PRIOR_NOISE_N) ** 2, self._top)
        self._state = [mass_kg, p, 0.0, 0.0, 0.0, 0.0, 0.0, PRIOR_NOISE_N**2]
        self._held_mass = np.array([[mass_kg], [min(std_kg, self._spread)]])
        self._mass_kg, self._runs = mass_kg, Runs()

    def missing(self) -> str:
        """Return why there is nothing to work with ('' when there is)."""
        if self.facts.has_accelerometer or self._seen:
            return ""
        return "needs a longitudinal accelerometer"

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass and its (already widened) standard deviation."""
        self._begin(mass_kg, mass_std_kg)

    def snapshot(self) -> dict[str, Any]:
        """Return the mass and its standard deviation, where there is a confirmed one."""
        mass, std = float(self._held_mass[0, 0]), float(self._held_mass[1, 0])
        return {"mass_kg": mass, "mass_std_kg": std} if self._confirmed else {}

    def _update(self, block: ModelBlock) -> EstimateBlock:
        n = len(block)
        grade, grade_std = _hold(self._held_grade, *self._grades(block), n)
        at, masses = self._masses(block)
        mass, mass_std = _hold(self._held_mass, at, masses, n)
        learned = self._confirmed | (rows_until(at, n) > 0)
        if n:
            self._held_grade = np.array([[grade[-1]], [grade_std[-1]]])
            self._held_mass = np.array([[mass[-1]], [mass_std[-1]]])
        self._confirmed = self._confirmed or len(at) > 0
        return EstimateBlock(mass, mass_std, grade, grade_std, self._tracker.update(learned, mass, mass_std))

    def _grades(self, block: ModelBlock) -> tuple[IntColumn, FloatColumn]:
        at, sine, variance = self._grade(block)
        self._seen = self._seen or len(at) > 0
        limit = self.options.grade_limit
        sine = np.clip(sine, -limit, limit)
        cosine2 = 1.0 - sine * sine
        grade = np.clip(sine / np.sqrt(cosine2), -limit, limit)
        offset = self.options.offset_mps2 / GRAVITY_MPS2
        std = np.sqrt(variance + offset * offset) / (cosine2 * np.sqrt(cosine2))
        return at, np.stack((grade, std))

    def _masses(self, block: ModelBlock) -> tuple[IntColumn, FloatColumn]:
        at = np.flatnonzero(usable(block) & has_accelerometer(block))
        felt = block.accelerometer_mps2[at] - (GRAVITY_MPS2 * self._pitch) * block.accel_mps2[at]
        out, state = room(len(at), 2), state_in(self._state)
        o, facts = self.options, self.facts
        columns = give(felt + GRAVITY_MPS2 * block.mu[at], block.force_N[at])
        limits = (facts.mass_min_kg, facts.mass_max_kg, self._top)
        learn_mass(*columns, o.forgetting, STEP_S / o.correlation_s, *limits, VARIANCE_ALPHA, state, *out)
        self._state = state_out(state)
        masses = take(out[0])
        before = np.concatenate(([self._mass_kg], masses))[: len(masses)]
        if len(masses):
            self._mass_kg = float(masses[-1])
        wider = self._runs(block.force_N[at] - before * (felt + GRAVITY_MPS2 * block.mu[at]))
        return at, np.stack((masses, np.minimum(np.sqrt(take(out[1]) * wider), self._spread)))


def _hold(held: FloatColumn, at: IntColumn, numbers: FloatColumn, n: int) -> FloatColumn:
    """Return numbers (2, n), each sample having those of the last row at or before it."""
    joined = np.concatenate((held, numbers), axis=1)
    return np.asarray(joined[:, rows_until(at, n)])


@jit.kernel
def learn_mass(
    felt: Container,
    force: Container,
    forgetting: float,
    beta: float,
    low: float,
    high: float,
    top: float,
    alpha: float,
    state: Container,
    mass: Container,
    variance: Container,
) -> None:
    """2014, eq. 17: one-parameter RLS of force = m felt, its gain times the correlation of the two."""
    m, p, mean_x, mean_f, var_x, var_f, cross, s = state
    for k in range(len(felt)):
        x = felt[k]
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
        s += alpha * (e * e - s)
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
