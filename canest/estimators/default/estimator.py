"""The estimator: samples become windows, windows pass the loop, and its rows become estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.bounds import beyond_bound
from canest.estimators.default import kernel
from canest.estimators.default import model as at
from canest.estimators.default.accelerometer import Comparison
from canest.estimators.default.constants import CONSTANTS, Constants, gain_std, vehicle_of
from canest.estimators.default.hypotheses import Filters, Room, moments_of_u, most_probable
from canest.estimators.default.load import Standing
from canest.estimators.default.noise import Levels
from canest.estimators.default.report import LEAD_1PM, Report
from canest.estimators.default.road_map import LEVEL_STD, RoadUse
from canest.estimators.default.sensors import Scratch
from canest.estimators.default.windows import COLUMNS, SHIFT, Windows
from canest.estimators.description import Description
from canest.estimators.options import Options, parse
from canest.estimators.status import StatusTracker

#: densities at most: those of an unknown load, and what was there before
_LOADS = 9
#: masses over which a wide mixture is summed
_NODES = 48
_SENSED = COLUMNS.index("sensed_mps2")
#: sine of the steepest slope given out; no road is steeper than 35 %
_STEEPEST = 0.33
#: std of a mass that nothing speaks for, as a share of it
_UNKNOWN = 0.5
#: without samples for so long nothing is known to be as it was, s
_SILENCE_S = 5.0
_FAULTY = (
    "the accelerometer does not follow the speed's acceleration, and is not used: another unit, sign or axis?"
)


class GaussianSumOptions(Options):
    """None: everything follows from the vehicle's facts and signals."""


class GaussianSum(Estimator):
    """Mass and grade as a sum of normal densities over the inverse mass (docs/theory.md)."""

    descriptions = (
        Description(
            "canest",
            "sum of Kalman filters over the inverse mass, one per hypothesis of load, road and driver",
            "this project, the default (docs/theory.md)",
            options=GaussianSumOptions,
        ),
    )
    constants: Constants = CONSTANTS

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options = parse(GaussianSumOptions, options)
        self._late_s = SHIFT * STEP_S + facts.filter_delay_s
        self._begin(None, None)

    def _begin(self, mass_kg: float | None, mass_std_kg: float | None) -> None:
        """Set every density to its prior."""
        facts, c = self.facts, self.constants
        self._vehicle = v = vehicle_of(facts, c)
        n = at.STATES if facts.has_accelerometer else at.STATES_WITHOUT_ACCELEROMETER
        width = math.log(v.most_u / v.least_u)
        steps = np.arange(c.load.banks) + 0.5
        self._centres = (v.least_u * np.exp(steps * width / c.load.banks)).tolist()
        self._nodes = (v.least_u * np.exp((np.arange(_NODES) + 0.5) * width / _NODES)).tolist()
        mean, std = self._prior(c)
        self._prior_var = np.square(std[:n]).tolist()
        centres, spread = self._centres, [c.load.spread * u * width / c.load.banks for u in self._centres]
        if mass_kg is not None:
            u = min(max(1.0 / mass_kg, v.least_u), v.most_u)
            centres, spread = [u], [(mass_std_kg or mass_kg) * u * u]
        x = np.zeros((_LOADS, at.MODES, n))
        P = np.zeros((_LOADS, at.MODES, n, n))
        times_u = [i for i in (at.WIND, at.DELAY, at.SLIP, at.WINDUP, at.LAG) if i < n]
        for k, (u, u_std) in enumerate(zip(centres, spread, strict=True)):
            one = std[:n].copy()
            one[times_u] *= u
            one[at.U] = u_std
            x[k] = mean[:n]
            x[k, :, at.U] = u
            P[k] = np.diag(one * one)
        P[:, [at.STRAIGHT_FREE, at.STRAIGHT_ANSWERED], at.CURVATURE, at.CURVATURE] = 0.0
        P[:, [at.STRAIGHT_FREE, at.CURVED_FREE], at.RESPONSE, at.RESPONSE] = 0.0
        straight = c.road.straight_m / (c.road.straight_m + c.road.curved_m)
        road = np.array([straight, 1.0 - straight])
        free = 1.0 - c.driver.answered_share
        mode = np.tile(np.concatenate((free * road, (1.0 - free) * road)), (_LOADS, 1))
        weight = np.zeros(_LOADS)
        weight[: len(centres)] = 1.0 / len(centres)
        self._filters = Filters(
            *(a.tolist() for a in (x, P, mode, weight, np.zeros(_LOADS), np.zeros(_LOADS)))
        )
        start = v.speed_loudest_mps / c.noise.loudest
        sensed_var = 4.0 * v.sensed_floor_mps2 * v.sensed_floor_mps2
        levels = Levels(start * start, sensed_var, 0.0, 0.0, 0.0, c.road.roughness_1pm, 0.0, 0.0, 0.0)
        guess = mass_kg or facts.initial_mass_kg or 1.0 / math.sqrt(v.least_u * v.most_u)
        report = Report(guess, guess * guess, facts.initial_grade or 0.0, c.prior.grade**2, 0.0, 0.0, 0.0)
        self._carried = kernel.Carried(kernel.Progress(), Standing(), levels, Comparison(), report, RoadUse())
        self._windows = Windows(self._late_s)
        bounds = (facts.mass_min_kg, facts.mass_max_kg)
        self._status = StatusTracker(facts.valid_std, bounds_kg=bounds)
        self._gain = gain_std(facts)
        first = np.zeros(kernel.OUTPUTS)
        first[: kernel.OUT_BEND] = report[: kernel.OUT_BEND]
        self._last = first
        self._last_tick: int | None = None

    def _prior(self, c: Constants) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and std of every state; those times u for u = 1."""
        facts, v = self.facts, self._vehicle
        mean, std = np.zeros(at.STATES), np.zeros(at.STATES)
        mean[at.GRADE], std[at.GRADE] = facts.initial_grade or 0.0, c.prior.grade
        std[at.Q], std[at.HEIGHT] = 10.0, 1.0
        std[at.CURVATURE], std[at.RESPONSE] = c.road.curvature_1pm, v.response
        std[at.WIND], std[at.DELAY] = v.wind_mps, c.prior.delay_s
        std[at.SLIP], std[at.WINDUP] = c.prior.slip_per_mps2, c.prior.windup_s2
        std[at.ROLLING] = facts.rolling_resistance_accuracy * facts.rolling_resistance
        if facts.has_road_map:
            std[at.ROLLING] = math.hypot(std[at.ROLLING], LEVEL_STD)
        std[at.BIAS], std[at.LAG] = c.prior.bias_mps2, c.prior.lag_s
        pitch = facts.pitch_rad_per_mps2
        mean[at.PITCH] = GRAVITY_MPS2 * (c.prior.pitch_rad_per_mps2 if pitch is None else pitch)
        share = 1.0 if pitch is None else c.prior.pitch_share
        std[at.PITCH] = max(share * abs(mean[at.PITCH]), GRAVITY_MPS2 * 1e-4)
        return mean, std

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples; a sample's estimate uses the windows that end at or before it."""
        windows, ends = self._windows.push(block)
        rows = self._run(windows)
        known = np.vstack([self._last, rows])
        self._last = known[-1]
        return self._estimates(known, ends, block)

    def _run(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pass windows (columns, w) through the loop; return its rows (w, OUTPUTS)."""
        n = windows.shape[1]
        if not n:
            return np.zeros((0, kernel.OUTPUTS))
        give: Any = np.array if jit.enabled() else (lambda a: np.asarray(a).tolist())
        filters = Filters(*(np.array(a) if jit.enabled() else a for a in self._filters))
        size = len(self._prior_var)
        if size <= at.BIAS:  # the vehicle's facts name no accelerometer
            windows[_SENSED] = np.nan
        vector, matrix = np.zeros(size), np.zeros((size, size))
        scratch = Scratch(*(give(vector) for _ in range(3)))
        room = Room(give(vector), give(matrix), give(vector), give(matrix), give(vector))
        out = give(np.zeros((n, kernel.OUTPUTS)))
        self._carried = kernel.run(
            n, np.ascontiguousarray(windows) if jit.enabled() else windows.tolist(), filters, self._carried,
            scratch, room, give(np.zeros(at.MODES)), give(np.zeros(_LOADS)), give(np.zeros(_LOADS)),
            give(self._centres), give(self._nodes), give(self._prior_var),
            self.facts.rolling_resistance_accuracy, self.constants, self._vehicle, out,
        )  # fmt: skip
        if jit.enabled():
            self._filters = Filters(*(a.tolist() for a in filters))
            self._carried = _plain(self._carried)
        return np.asarray(out)

    def _estimates(
        self, known: NDArray[np.float64], ends: NDArray[np.int64], block: ModelBlock
    ) -> EstimateBlock:
        """Give n samples what was known after their last window, the grade carried on to where they are.

        ends: samples on which the windows end, those of `known` but for its first row.
        """
        n = len(block)
        ticks = block.t_us // STEP_US
        first = int(ticks[0]) if n and self._last_tick is None else self._last_tick or 0
        last_ticks = np.concatenate(([first], ticks[ends]))
        if len(ends):
            self._last_tick = int(last_ticks[-1])
        elif self._last_tick is None and n:
            self._last_tick = first
        counts = np.diff(np.concatenate(([0], ends, [n])))
        rows = np.repeat(np.arange(len(known)), counts)
        table = known[rows].T
        since = np.clip((ticks - last_ticks[rows]) * STEP_S, 0.0, _SILENCE_S) + self._late_s
        ahead_m = table[kernel.OUT_SPEED] * since
        sine = np.clip(table[kernel.OUT_GRADE] + table[kernel.OUT_BEND] * ahead_m, -_STEEPEST, _STEEPEST)
        grade_std = np.minimum(np.sqrt(table[kernel.OUT_GRADE_VAR] + (LEAD_1PM * ahead_m) ** 2), 1.0)
        facts = self.facts
        mass = np.clip(table[kernel.OUT_MASS], facts.mass_min_kg, facts.mass_max_kg)
        mass_std = np.sqrt(table[kernel.OUT_VAR] + (self._gain * mass) ** 2)
        learned = table[kernel.OUT_LEARNED] > 0.0
        silent = (ticks - last_ticks[rows]) * STEP_S > _SILENCE_S
        mass_std = np.where(silent, np.maximum(mass_std, _UNKNOWN * mass), mass_std)
        mass_std = np.minimum(mass_std, facts.mass_max_kg)
        status = self._status.update(learned & ~silent, mass, mass_std)
        status[learned & silent] = Status.CONVERGING
        grade = sine / np.sqrt(1.0 - sine * sine)
        if facts.initial_mass_kg is None and not learned.all():
            mass, mass_std, grade, grade_std = (
                np.where(learned, column, np.nan) for column in (mass, mass_std, grade, grade_std)
            )
        return EstimateBlock(mass, mass_std, grade, grade_std, status)

    def snapshot(self) -> dict[str, Any]:
        """Return the mass with its std, and how well the innovations behave."""
        mass = float(self._last[kernel.OUT_MASS])
        std = math.sqrt(self._last[kernel.OUT_VAR] + (self._gain * mass) ** 2)
        learned = bool(self._last[kernel.OUT_LEARNED] > 0.0)
        return {"mass_kg": mass, "mass_std_kg": std, "learned": learned, **self.consistency()}

    def contradiction(self) -> str:
        """Return what in the samples contradicts the vehicle's facts ('' for nothing)."""
        faulty = _FAULTY if self._carried.comparison.faulty > 0.0 else ""
        return "; ".join(found for found in (self._beyond_bound(), faulty) if found)

    def _beyond_bound(self) -> str:
        """Return the bound of the mass beyond which the driving leads, in a sentence."""
        if not self._last[kernel.OUT_LEARNED]:
            return ""
        u, var = moments_of_u.interpreted(self._filters, most_probable.interpreted(self._filters.weight))
        return beyond_bound(u, var, self.facts)

    def consistency(self) -> dict[str, float]:
        """Return the mean normalised innovation squared (1 when honest), and over how many windows."""
        levels = self._carried.levels
        nis = levels.nis_sum / levels.windows if levels.windows else float("nan")
        return {"nis": nis, "windows": levels.windows}

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass with its (already widened) standard deviation."""
        self._begin(mass_kg, mass_std_kg)
        self._last[kernel.OUT_LEARNED] = 1.0
        self._last[kernel.OUT_MASS], self._last[kernel.OUT_VAR] = mass_kg, mass_std_kg**2
        self._carried = self._carried._replace(progress=self._carried.progress._replace(learned=1.0))


def _plain(carried: kernel.Carried) -> kernel.Carried:
    """Return what is carried as plain Python numbers."""
    return kernel.Carried(*(type(part)(*(float(x) for x in part)) for part in carried))  # type: ignore[arg-type]
