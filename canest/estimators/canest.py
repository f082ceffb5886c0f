"""`canest`: the default estimator, one Kalman filter over windows of 0.2 s (see `canest_kernel`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest import fast
from canest.estimators import canest_kernel as kernel
from canest.estimators.base import Estimator
from canest.estimators.canest_prior import ROLLING_SHARE_STD, TORQUE_GAIN_STD, prior_of
from canest.estimators.canest_windows import COLUMNS, SHIFT, Windows
from canest.estimators.columns import give, state_in, state_out
from canest.estimators.options import Options, parse
from canest.estimators.status import StatusTracker
from canest.frames import FloatColumn
from canest.vehicle.samples import STEP_S, EstimateBlock, ModelBlock, Status, VehicleFacts

#: a mass is trusted once its std is below this share of it
VALID_SHARE = 0.04
#: ... and while the vehicle has not stood long enough for its load to be changing
UNLOADED_S = 10.0
_SENSED, _UNDRIVEN, _ALTITUDE = (COLUMNS.index(c) for c in ("sensed_mps2", "undriven_mps", "altitude_m"))
_SPEED, _OPEN = COLUMNS.index("speed_mps"), COLUMNS.index("open")


class CanestOptions(Options):
    """None: everything follows from the vehicle's facts and signals."""


class Canest(Estimator):
    """Mass and grade with the standard deviations they deserve.

    The filter's own standard deviation is completed by what no sample can tell: the gain of the reported
    torque (a mass 1 % too large and a torque 1 % too large look the same) and the rolling resistance (the
    same for the grade).
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
        self._memory[kernel.FRESH] = 1.0
        for slot, floor in zip(
            (kernel.SPEED_VAR, kernel.SENSED_VAR, kernel.UNDRIVEN_VAR), prior.noise_floor, strict=True
        ):
            self._memory[slot] = 4.0 * floor * floor
        self._extra: set[int] = set()
        self._windows = Windows()
        self._status = StatusTracker(VALID_SHARE)
        self._last = np.zeros(kernel.OUTPUTS + 2)
        self._last[kernel.OUT_U] = self._x[kernel.U]
        self._last[kernel.OUT_U_VAR] = self._P[kernel.U][kernel.U]
        self._last[kernel.OUT_GRADE_VAR] = self._P[kernel.GRADE][kernel.GRADE]
        self._since = 0

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples; a sample's estimate uses the windows that end at or before it."""
        windows, finished = self._windows.push(block)
        known = np.vstack([self._last, self._filter(windows)])
        self._last = known[-1]
        held = known[finished].T
        return self._estimates(held, self._ticks_since(finished))

    def _filter(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Run the kernel over windows (columns, w); return its outputs and the speed and distance rate."""
        n = windows.shape[1]
        if n == 0:
            return np.empty((0, kernel.OUTPUTS + 2))
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
        return np.column_stack([np.asarray(out), windows[_SPEED], windows[_OPEN]])

    def _ticks_since(self, finished: NDArray[np.int64]) -> FloatColumn:
        """Return how many ticks each sample lies behind the end of its last window."""
        n = len(finished)
        index = np.arange(n)
        new = np.diff(finished, prepend=0) > 0
        last = np.maximum.accumulate(np.where(new, index, -self._since - 1))
        if n:
            self._since = int(n - 1 - last[-1])
        return (index - last).astype(np.float64)

    def _mass(self, known: NDArray[np.float64]) -> tuple[FloatColumn, FloatColumn]:
        """Return mass and its std (kg) of kernel outputs (n, outputs)."""
        u = np.maximum(known[:, kernel.OUT_U], 1.0 / self.facts.mass_max_kg)
        mass = np.maximum(1.0 / u, self.facts.mass_min_kg)
        share = np.sqrt(np.maximum(known[:, kernel.OUT_U_VAR], 0.0) * mass * mass + TORQUE_GAIN_STD**2)
        return mass, np.minimum(share * mass, self.facts.mass_max_kg)

    def _estimates(self, held: NDArray[np.float64], ticks: FloatColumn) -> EstimateBlock:
        facts = self.facts
        mass, mass_std = self._mass(held.T)
        speed = held[kernel.OUTPUTS]
        ahead_m = np.maximum(speed, 0.0) * (ticks + SHIFT) * STEP_S
        sine = held[kernel.OUT_GRADE] + held[kernel.OUT_CURVATURE] * ahead_m
        sine = np.clip(sine, -0.5, 0.5)
        rolling = ROLLING_SHARE_STD * facts.rolling_resistance
        grade_std = np.sqrt(np.maximum(held[kernel.OUT_GRADE_VAR], 0.0) + rolling**2)
        learned = held[kernel.OUT_LEARNED] > 0.0
        started = learned | (facts.initial_mass_kg is not None)
        standing = held[kernel.OUT_STANDING_S] > UNLOADED_S
        status = self._status.update(learned & ~standing, mass, mass_std)
        status[learned & standing] = Status.CONVERGING
        nan = np.nan
        return EstimateBlock(
            mass_kg=np.where(started, mass, nan),
            mass_std_kg=np.where(started, mass_std, nan),
            grade=np.where(started, sine / np.sqrt(1.0 - sine * sine), nan),
            grade_std=np.where(started, np.minimum(grade_std, 1.0), nan),
            status=status,
        )

    def snapshot(self) -> dict[str, Any]:
        """Return the mass with its std, and how well the innovations behave."""
        mass, std = self._mass(self._last[None, :])
        return {
            "mass_kg": float(mass[0]),
            "mass_std_kg": float(std[0]),
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
        self._last[kernel.OUT_LEARNED] = 1.0
