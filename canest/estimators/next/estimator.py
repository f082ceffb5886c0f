"""The estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.next import kernel
from canest.estimators.next import model as at
from canest.estimators.next.accelerometer import Comparison
from canest.estimators.next.constants import CONSTANTS, Constants, gain_std, vehicle_of
from canest.estimators.next.hypotheses import LOADS, MOST
from canest.estimators.next.load import Standing
from canest.estimators.next.model import Bank
from canest.estimators.next.noise import Levels
from canest.estimators.next.report import LEAD_1PM, Report
from canest.estimators.next.sensors import Scratch
from canest.estimators.next.windows import COLUMNS, SHIFT, Windows
from canest.estimators.status import StatusTracker

_NODES = 48
_SENSED = COLUMNS.index("sensed_mps2")
_STEEPEST = 0.33
_UNKNOWN = 0.5
_SILENCE_S = 5.0


class Next(Estimator):
    """Mass and grade as a sum of normal densities over the inverse mass."""

    constants: Constants = CONSTANTS

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self._late_s = SHIFT * STEP_S + facts.filter_delay_s
        self._begin(None, None)

    def _begin(self, mass_kg: float | None, mass_std_kg: float | None) -> None:
        facts, c = self.facts, self.constants
        self._vehicle = v = vehicle_of(facts, c, self._late_s)
        n = at.STATES if facts.has_accelerometer else at.STATES_WITHOUT_ACCELEROMETER
        width = math.log(v.most_u / v.least_u)
        self._nodes = (v.least_u * np.exp((np.arange(_NODES) + 0.5) * width / _NODES))
        u, u_var = v.mean_u, v.var_u
        if mass_kg is not None:
            u = min(max(1.0 / mass_kg, v.least_u), v.most_u)
            u_var = ((mass_std_kg or mass_kg) * u * u) ** 2
        mean, std = np.zeros(at.STATES), np.zeros(at.STATES)
        mean[at.GRADE], std[at.GRADE] = facts.initial_grade or 0.0, c.grade
        std[at.V], std[at.HEIGHT] = 10.0, 1.0
        std[at.WIND], std[at.DELAY], std[at.SLIP] = v.wind_mps * u, c.delay_s * u, c.slip_per_mps2 * u
        std[at.WINDUP] = c.windup_s2 * u
        std[at.ROLLING] = facts.rolling_resistance_accuracy * facts.rolling_resistance
        mean[at.U], std[at.U] = u, math.sqrt(u_var)
        std[at.BIAS] = c.bias_mps2
        pitch = facts.pitch_rad_per_mps2
        mean[at.PITCH] = GRAVITY_MPS2 * (c.pitch_rad_per_mps2 if pitch is None else pitch)
        share = 1.0 if pitch is None else c.pitch_share
        std[at.PITCH] = max(share * abs(mean[at.PITCH]), GRAVITY_MPS2 * 1e-4)
        bank = Bank(np.zeros((MOST, n)), np.zeros((MOST, n, n)), np.zeros(MOST), np.zeros(MOST), np.zeros(MOST), np.zeros(MOST))
        straight = c.straight_m / (c.straight_m + c.curved_m)
        free = 1.0 - c.answered_share
        rough = c.smoothens_m / (c.roughens_m + c.smoothens_m)
        drifts = c.drift_ends_s / (c.drift_begins_s + c.drift_ends_s)
        roads = [(1 - rough) * straight, (1 - rough) * (1 - straight), rough]
        shares = [free * p for p in roads] + [(1 - free) * p for p in roads]
        for mode in range(at.MODES):
            bank.weight[mode] = shares[mode % at.ROADS] * (drifts if mode >= at.ROADS else 1 - drifts)
            bank.mode[mode] = mode
            bank.x[mode] = mean[:n]
            one = std.copy()
            one[at.CURVATURE] = c.curvature_1pm * at.BENDS[mode]
            one[at.RESPONSE] = v.response * at.ANSWERS[mode]
            one[at.RATE] = c.drift_1ps * u * at.DRIFTS[mode]
            bank.P[mode] = np.diag(one[:n] ** 2)
        self._bank = bank
        start = v.speed_loudest_mps / c.loudest
        levels = Levels(start * start, 4.0 * v.sensed_floor_mps2**2, 0.0, 0.0, 0.0)
        guess = mass_kg or facts.initial_mass_kg or 1.0 / math.sqrt(v.least_u * v.most_u)
        report = Report(guess, guess * guess, facts.initial_grade or 0.0, c.grade**2, 0.0, 0.0, 0.0)
        self._carried = kernel.Carried(kernel.Progress(count=float(at.MODES)), Standing(), levels, Comparison(), report)
        self._windows = Windows(self._late_s)
        self._status = StatusTracker(facts.valid_std, bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._gain = gain_std(facts)
        first = np.zeros(kernel.OUTPUTS)
        first[: kernel.OUT_BEND] = report[: kernel.OUT_BEND]
        self._last = first
        self._last_tick: int | None = None
        room = Bank(np.zeros((MOST, n)), np.zeros((MOST, n, n)), *(np.zeros(MOST) for _ in range(4)))
        self._room = room
        self._scratch = Scratch(
            np.zeros(8), np.zeros(n), np.zeros(n), np.zeros(MOST), np.zeros(MOST), np.zeros((4, MOST)), np.zeros(MOST),
            np.zeros(LOADS), np.zeros((at.MODES, at.MODES)),
        )

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples."""
        windows, ends = self._windows.push(block)
        rows = self._run(windows)
        known = np.vstack([self._last, rows])
        self._last = known[-1]
        return self._estimates(known, ends, block)

    def _run(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        n = windows.shape[1]
        if not n:
            return np.zeros((0, kernel.OUTPUTS))
        if self._bank.x.shape[1] <= at.BIAS:
            windows[_SENSED] = np.nan
        out = np.zeros((n, kernel.OUTPUTS))
        self._carried = kernel.run(
            n, np.ascontiguousarray(windows), self._bank, self._room, self._carried, self._scratch, self._nodes, self.constants, self._vehicle, out,
        )
        self._carried = kernel.Carried(*(type(part)(*(float(x) for x in part)) for part in self._carried))
        return out

    def _estimates(self, known, ends, block):
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
        since = np.clip((ticks - last_ticks[rows]) * STEP_S, 0.0, _SILENCE_S)
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
        self.live = known[:, kernel.OUT_LIVE]
        return EstimateBlock(mass, mass_std, grade, grade_std, status)

    def snapshot(self):
        levels = self._carried.levels
        return {"nis": levels.nis_sum / max(levels.windows, 1), "windows": levels.windows, "live": float(np.mean(self.live))}
