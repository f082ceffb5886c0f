"""`canest-0.1`: the default of version 0.1, two mixed Kalman filters over windows of 0.2 s."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.samples import STEP_S, EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.bounds import beyond_bound, unseen_std_kg
from canest.estimators.canest_0_1 import kernel, output
from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.noise import SWING_MPN
from canest.estimators.canest_0_1.prior import LOUDEST, prior_of
from canest.estimators.canest_0_1.roads import CURVED_M, STRAIGHT_M
from canest.estimators.canest_0_1.windows import COLUMNS, Windows
from canest.estimators.description import Description
from canest.estimators.kernel_arrays import pack as give
from canest.estimators.kernel_arrays import state_in, state_out
from canest.estimators.options import Options, parse
from canest.estimators.status import StatusTracker
from canest.estimators.windowing import SHIFT

#: effort that a remembered mass stands for: its std says all that is in doubt, m2/s3
REMEMBERED = 10.0
#: sine of the steepest slope given out; no road is steeper than 35 %
STEEPEST = 0.33
_DEAF = "the accelerometer does not feel what the speed tells, and is not used: another unit, sign or axis?"
_SPEED, _SENSED = COLUMNS.index("speed_mps"), COLUMNS.index("sensed_mps2")
#: the rows its kernel takes: version 0.1 knew no road map
_TAKEN = [row for row, name in enumerate(COLUMNS) if name not in ("road_sine", "road_std")]


class CanestOptions(Options):
    """None: everything follows from the vehicle's facts and signals."""


class Canest(Estimator):
    """Mass and grade with the standard deviations they deserve.

    Samples become windows (`canest_windows`), windows pass the filter (`canest_kernel`) from a prior made of
    vehicle facts (`canest_prior`), and the states become numbers for others (`canest_output`).
    """

    descriptions = (
        Description(
            "canest-0.1",
            "the default of version 0.1: two mixed Kalman filters, linear in the inverse mass",
            "this project, version 0.1",
            options=CanestOptions,
        ),
    )
    valid_is_configured = True

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options = parse(CanestOptions, options)
        #: how much earlier than the samples that end them windows show the vehicle
        self._late_s = SHIFT * STEP_S + facts.filter_delay_s
        self._begin(None, None)

    def _begin(self, mass_kg: float | None, mass_std_kg: float | None) -> None:
        """Set every state to its prior."""
        wide = prior_of(self.facts)
        prior = prior_of(self.facts, mass_kg, mass_std_kg)
        self._prior = wide
        self._X = [list(prior.mean[: at.BASE_STATES]) for _ in range(at.ROADS)]
        self._PP = [np.diag(np.square(prior.std[: at.BASE_STATES])).tolist() for _ in range(at.ROADS)]
        self._PP[at.STRAIGHT][at.CURVATURE][at.CURVATURE] = 0.0
        total = STRAIGHT_M + CURVED_M
        self._weight = [STRAIGHT_M / total, CURVED_M / total]
        self._axle, self._axle_P = list(prior.axle_mean), np.diag(np.square(prior.axle_std)).tolist()
        self._memory = [0.0] * at.MEMORY
        slots = (at.SPEED_VAR, at.SENSED_VAR, at.UNDRIVEN_VAR)
        for slot, noise in zip(slots, prior.noise_start, strict=True):
            self._memory[slot] = noise * noise
        self._memory[at.COARSE_VAR] = self._memory[at.LAST_VAR] = prior.std[at.GRADE] ** 2
        self._memory[at.COARSE_GRADE] = self._memory[at.LAST_GRADE] = prior.mean[at.GRADE]
        self._memory[at.SURPRISED_M] = math.inf
        self._memory[at.LEFT] = 1.0
        self._memory[at.SWING_VAR] = SWING_MPN * SWING_MPN
        self._memory[at.ACCEL_BEFORE] = math.nan
        self._windows = Windows(self._late_s)
        self._status = StatusTracker(self.valid_std)
        # a guess is given out until there is something better, and has no other part in it
        guess = mass_kg or self.facts.initial_mass_kg
        self._memory[at.HELD_U] = 1.0 / guess if guess else prior.mean[at.U]
        start = np.zeros((1, at.OUTPUTS))
        start[0, at.OUT_U], start[0, at.OUT_U_VAR] = self._memory[at.HELD_U], prior.std[at.U] ** 2
        start[0, at.OUT_PROVEN] = 1.0
        start[0, at.OUT_GRADE] = prior.mean[at.GRADE]
        start[0, at.OUT_GRADE_VAR] = prior.std[at.GRADE] ** 2
        self._last = output.known(start, np.zeros(1), self.facts, wide.std[at.U])[0]
        self._since = 0

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples; a sample's estimate uses the windows that end at or before it."""
        windows, ends = self._windows.push(block)
        if windows.shape[1]:
            out = self._filter(windows)
            found = output.known(out, windows[_SPEED], self.facts, self._prior.std[at.U])
            known = np.vstack([self._last, found])
        else:
            known = self._last[None, :]
        self._last = known[-1]
        return self._estimates(known, ends, len(block))

    def _filter(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take windows (columns, w); return the kernel's outputs (w, OUTPUTS).

        The states of an accelerometer begin with its first window, however the samples are cut.
        """
        sensed = np.isfinite(windows[_SENSED]) if len(self._X[0]) < at.STATES else np.zeros(0, np.bool_)
        if not sensed.any():
            return self._run(windows)
        first = int(sensed.argmax())
        before = self._run(windows[:, :first])
        self._grow()
        return np.concatenate((before, self._run(windows[:, first:])))

    def _run(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Run the kernel over windows; return its outputs, as `_filter`."""
        windows = windows[_TAKEN]
        n = windows.shape[1]
        compiled = jit.enabled()
        X: Any = self._X
        PP: Any = self._PP
        axle_P: Any = self._axle_P
        out: Any
        if compiled:
            X, PP, axle_P, out = np.array(X), np.array(PP), np.array(axle_P), np.zeros((n, at.OUTPUTS))
        else:
            out = [[0.0] * at.OUTPUTS for _ in range(n)]
        weight, axle, memory = (state_in(s) for s in (self._weight, self._axle, self._memory))
        kernel.run(
            n,
            np.ascontiguousarray(windows) if compiled else windows.tolist(),
            X,
            PP,
            weight,
            axle,
            axle_P,
            memory,
            *give(np.array(self._prior.std), np.array(self._prior.noise_floor)),
            LOUDEST * self._prior.noise_start[0],
            self._prior.torque_std_Nm,
            self.facts.mass_min_kg,
            self.facts.mass_max_kg,
            state_in([0.0] * len(X[0])),
            out,
        )
        self._weight, self._axle, self._memory = (state_out(s) for s in (weight, axle, memory))
        if compiled:
            self._X, self._PP, self._axle_P = X.tolist(), PP.tolist(), axle_P.tolist()
        return np.asarray(out).reshape(n, at.OUTPUTS)

    def _grow(self) -> None:
        """Make room for the states of an accelerometer, once there is one."""
        mean, std = self._prior.mean, self._prior.std
        for x, P in zip(self._X, self._PP, strict=True):
            for i in range(len(x), at.STATES):
                x.append(mean[i])
                for row in P:
                    row.append(0.0)
                P.append([0.0] * i + [std[i] * std[i]])

    def _estimates(self, known: NDArray[np.float64], ends: NDArray[np.int64], n: int) -> EstimateBlock:
        """Give n samples what was known after their last window, the grade carried on to where they are.

        ends: samples on which the windows end, those of `known` but for its first row.
        """
        last = np.concatenate(([-self._since - 1], ends))
        self._since = n - 1 - int(last[-1])
        table = known.T
        per_tick = table[output.SINE_PER_M] * table[output.SPEED_MPS] * STEP_S
        rows = [*table[: output.SINE_STD + 1], per_tick, last]
        samples = np.diff(np.concatenate(([0], ends, [n])))
        mass, mass_std, sine, grade_std, per_tick, last = np.repeat(rows, samples, axis=1)
        learned = np.repeat(table[output.LEARNED] > 0.0, samples)
        doubtful = (table[output.STANDING_S] > output.UNLOADED_S) | (table[output.PROVEN] == 0.0)
        doubtful = np.repeat(doubtful, samples)
        sine += per_tick * (np.arange(n) - last + self._late_s / STEP_S)
        np.clip(sine, -STEEPEST, STEEPEST, out=sine)
        status = self._status.update(learned & ~doubtful, mass, mass_std)
        status[learned & doubtful] = Status.CONVERGING
        grade = sine / np.sqrt(1.0 - sine * sine)
        if self.facts.initial_mass_kg is None and not learned.all():
            mass, mass_std, grade, grade_std = (
                np.where(learned, column, np.nan) for column in (mass, mass_std, grade, grade_std)
            )
        return EstimateBlock(mass, mass_std, grade, grade_std, status)

    def contradiction(self) -> str:
        """Return what speaks against the numbers: a mass that presses on its bound, a deaf accelerometer."""
        found = [self._beyond_bound(), _DEAF if self._memory[at.DEAF] > 0.0 else ""]
        return "; ".join(doubt for doubt in found if doubt)

    def _beyond_bound(self) -> str:
        if not self._memory[at.LEARNED]:
            return ""
        u, beyond = self._memory[at.HELD_U], self._memory[at.PRESSED]
        u_var = sum(w * P[at.U][at.U] for w, P in zip(self._weight, self._PP, strict=True))
        return beyond_bound(u - beyond, u_var, self.facts)

    def snapshot(self) -> dict[str, Any]:
        """Return the mass with its std, and how well the innovations behave."""
        return {
            "mass_kg": float(self._last[output.MASS_KG]),
            "mass_std_kg": float(self._last[output.MASS_STD_KG]),
            "learned": self._memory[at.LEARNED] > 0.0,
            **self.consistency(),
        }

    def consistency(self) -> dict[str, float]:
        """Return the mean normalised innovation squared (1 when honest) and its runs test (standard normal).

        Runs test: Wald and Wolfowitz (1940), of the innovations' signs; far below -3 means one-signed.
        """
        count, positive = self._memory[at.COUNT], self._memory[at.POSITIVE]
        negative = count - positive
        if count < 20 or not positive or not negative:
            return {"nis": float("nan"), "runs_z": float("nan"), "windows": count}
        expected = 1.0 + 2.0 * positive * negative / count
        variance = (expected - 1.0) * (expected - 2.0) / (count - 1.0)
        return {
            "nis": self._memory[at.NIS_SUM] / count,
            "runs_z": (self._memory[at.RUNS] - expected) / math.sqrt(variance),
            "windows": count,
        }

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:
        """Start from a remembered mass with its standard deviation, widened by an unseen stop."""
        self._begin(mass_kg, math.hypot(mass_std_kg, unseen_std_kg(unseen_s, self.facts)))
        self._memory[at.LEARNED] = 1.0
        self._memory[at.EFFORT] = REMEMBERED
        self._memory[at.BEFORE_U] = 1.0 / mass_kg
        self._last[output.LEARNED] = 1.0
