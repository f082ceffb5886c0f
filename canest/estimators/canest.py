"""`canest`: the default estimator, one Kalman filter over windows of 0.2 s (see `canest_kernel`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest import fast
from canest.estimators import canest_kernel as kernel
from canest.estimators import canest_output as output
from canest.estimators.base import Estimator
from canest.estimators.canest_prior import prior_of
from canest.estimators.canest_windows import COLUMNS, SHIFT, Windows
from canest.estimators.columns import give, state_in, state_out
from canest.estimators.options import Options, parse
from canest.estimators.status import StatusTracker
from canest.frames import FloatColumn
from canest.vehicle.samples import STEP_S, EstimateBlock, ModelBlock, Status, VehicleFacts

#: a mass is trusted once its std is below this share of it ...
VALID_SHARE = 0.04
#: ... or below the larger one where the vehicle has accelerated: integral of a^2 dt since its load may have
#: changed, m2/s3 (a launch gives 5 to 10, five minutes of motorway cruise 1 to 4)
DRIVEN_SHARE, DRIVEN_EFFORT = 0.055, 5.0
#: ... and while the vehicle has not stood long enough for its load to be changing
UNLOADED_S = 10.0
#: sine of the steepest slope given out; no road is steeper than 35 %
STEEPEST = 0.33
_SENSED, _UNDRIVEN, _ALTITUDE = (COLUMNS.index(c) for c in ("sensed_mps2", "undriven_mps", "altitude_m"))
_SPEED = COLUMNS.index("speed_mps")


class CanestOptions(Options):
    """None: everything follows from the vehicle's facts and signals."""


class Canest(Estimator):
    """Mass and grade with the standard deviations they deserve.

    Samples become windows (`canest_windows`), windows pass the filter (`canest_kernel`) from a prior made of
    vehicle facts (`canest_prior`), and the states become numbers for others (`canest_output`).
    """

    names = ("canest",)

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options = parse(CanestOptions, options)
        self._begin(None, None)

    def _begin(self, mass_kg: float | None, mass_std_kg: float | None) -> None:
        """Set every state to its prior."""
        wide = prior_of(self.facts)
        prior = prior_of(self.facts, mass_kg, mass_std_kg)
        self._prior = wide
        self._x = list(prior.mean)
        self._P = [[s * s if i == j else 0.0 for j in range(kernel.STATES)] for i, s in enumerate(prior.std)]
        self._memory = [0.0] * kernel.MEMORY
        slots = (kernel.SPEED_VAR, kernel.SENSED_VAR, kernel.UNDRIVEN_VAR)
        for slot, noise in zip(slots, prior.noise_start, strict=True):
            self._memory[slot] = noise * noise
        self._extra: set[int] = set()
        self._windows = Windows()
        self._status = StatusTracker(VALID_SHARE)
        start = np.zeros((1, kernel.OUTPUTS))
        start[0, kernel.OUT_U], start[0, kernel.OUT_U_VAR] = prior.mean[kernel.U], prior.std[kernel.U] ** 2
        start[0, kernel.OUT_GRADE] = prior.mean[kernel.GRADE]
        start[0, kernel.OUT_GRADE_VAR] = prior.std[kernel.GRADE] ** 2
        self._last = output.known(start, np.zeros(1), self.facts)[0]
        self._since = 0

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples; a sample's estimate uses the windows that end at or before it."""
        windows, finished = self._windows.push(block)
        if windows.shape[1]:
            found = output.known(self._filter(windows), windows[_SPEED], self.facts)
            known = np.vstack([self._last, found])
        else:
            known = self._last[None, :]
        self._last = known[-1]
        return self._estimates(known, finished)

    def _filter(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Run the kernel over windows (columns, w); return its outputs (w, OUTPUTS)."""
        n = windows.shape[1]
        for row, states in (
            (_SENSED, {kernel.BIAS, kernel.PITCH}),
            (_UNDRIVEN, {kernel.LAG, kernel.SCALE}),
            (_ALTITUDE, {kernel.HEIGHT}),
        ):
            if np.isfinite(windows[row]).any():
                self._extra |= states
        always = (
            kernel.Q, kernel.U, kernel.DELAY, kernel.SLIP, kernel.WIND, kernel.GRADE, kernel.CURVATURE,
        )  # fmt: skip
        active = sorted({*always, *self._extra})
        compiled = fast.enabled()
        x, memory = state_in(self._x), state_in(self._memory)
        P = np.array(self._P) if compiled else self._P
        out: Any = np.zeros((n, kernel.OUTPUTS)) if compiled else [[0.0] * kernel.OUTPUTS for _ in range(n)]
        kernel.run(
            n,
            windows if compiled else windows.tolist(),
            x,
            P,
            memory,
            np.array(active) if compiled else active,
            *give(np.array(self._prior.std), np.array(self._prior.noise_floor)),
            self._prior.torque_std_Nm,
            state_in([0.0] * kernel.STATES),
            out,
        )
        self._x, self._memory = state_out(x), state_out(memory)
        self._P = [state_out(row) for row in P]
        return np.asarray(out)

    def _ticks_since(self, finished: NDArray[np.int64]) -> FloatColumn:
        """Return how many ticks each sample lies behind the end of its last window."""
        n = len(finished)
        index = np.arange(n)
        new = np.diff(finished, prepend=0) > 0
        last = np.maximum.accumulate(np.where(new, index, -self._since - 1))
        if n:
            self._since = int(n - 1 - last[-1])
        return (index - last).astype(np.float64)

    def _estimates(self, known: NDArray[np.float64], finished: NDArray[np.int64]) -> EstimateBlock:
        """Give every sample what was known after its last window, the grade carried on to where it is."""

        def held(column: int) -> FloatColumn:
            value: FloatColumn = known[:, column][finished]
            return value

        mass, mass_std = held(output.MASS_KG), held(output.MASS_STD_KG)
        ahead_m = held(output.SPEED_MPS) * (self._ticks_since(finished) + SHIFT) * STEP_S
        sine = np.clip(held(output.SINE) + held(output.SINE_PER_M) * ahead_m, -STEEPEST, STEEPEST)
        learned = held(output.LEARNED) > 0.0
        standing = held(output.STANDING_S) > UNLOADED_S
        limit = np.where(held(output.EFFORT) >= DRIVEN_EFFORT, DRIVEN_SHARE, VALID_SHARE)
        status = self._status.update(learned & ~standing, mass, mass_std * (VALID_SHARE / limit))
        status[learned & standing] = Status.CONVERGING
        grade = sine / np.sqrt(1.0 - sine * sine)
        grade_std = np.minimum(held(output.SINE_STD), 1.0)
        if self.facts.initial_mass_kg is None and not learned.all():
            mass, mass_std, grade, grade_std = (
                np.where(learned, column, np.nan) for column in (mass, mass_std, grade, grade_std)
            )
        return EstimateBlock(mass, mass_std, grade, grade_std, status)

    def snapshot(self) -> dict[str, Any]:
        """Return the mass with its std, and how well the innovations behave."""
        return {
            "mass_kg": float(self._last[output.MASS_KG]),
            "mass_std_kg": float(self._last[output.MASS_STD_KG]),
            "learned": self._memory[kernel.LEARNED] > 0.0,
            **self.consistency(),
        }

    def consistency(self) -> dict[str, float]:
        """Return the mean normalised innovation squared (1 when honest) and its runs test (standard normal).

        Runs test: Wald and Wolfowitz (1940), of the innovations' signs; far below -3 means one-signed.
        """
        count, positive = self._memory[kernel.COUNT], self._memory[kernel.POSITIVE]
        negative = count - positive
        if count < 20 or not positive or not negative:
            return {"nis": float("nan"), "runs_z": float("nan"), "windows": count}
        expected = 1.0 + 2.0 * positive * negative / count
        variance = (expected - 1.0) * (expected - 2.0) / (count - 1.0)
        return {
            "nis": self._memory[kernel.NIS_SUM] / count,
            "runs_z": (self._memory[kernel.RUNS] - expected) / math.sqrt(variance),
            "windows": count,
        }

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass with its (already widened) standard deviation."""
        self._begin(mass_kg, mass_std_kg)
        self._memory[kernel.LEARNED] = 1.0
        self._last[output.LEARNED] = 1.0
