"""The estimator: samples become windows, windows pass the loop, and its rows become estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S, STEP_US, EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.bounds import beyond_bound, gain_std
from canest.estimators.default import kernel
from canest.estimators.default import model as at
from canest.estimators.default.accelerometer import Comparison
from canest.estimators.default.constants import CONSTANTS, Constants, vehicle_of
from canest.estimators.default.driver import draw_answer
from canest.estimators.default.hypotheses import set_loads
from canest.estimators.default.joining import Joined
from canest.estimators.default.model import LOADS, MODES, MOST, Mixture, Scratch, Space, Window
from canest.estimators.default.noise import first_levels
from canest.estimators.default.report import Report, unknown_load_var
from canest.estimators.default.road_map import LEVEL_STD, RoadUse
from canest.estimators.default.sensors import delay_is_too_long
from canest.estimators.default.windows import COLUMNS, Windows
from canest.estimators.description import Description
from canest.estimators.kernel_arrays import state_in
from canest.estimators.status import StatusTracker
from canest.estimators.windowing import SHIFT

#: masses over which a wide mixture is summed: a factor of 6 of bounds is 4 % from one to the next
_NODES = 48
#: speed for which the first std of the wind takes the error of the drag area, m/s: where drag matters
_USUAL_MPS = 25.0
_SENSED = COLUMNS.index("sensed_mps2")
#: a window, of which compiled code reads the fields by name
_RECORD = np.dtype([(field, np.float64) for field in COLUMNS])
#: sine of the steepest slope given out; no road is steeper than 35 %
_STEEPEST = 0.33
#: std of a mass that nothing speaks for, as a share of it
_UNKNOWN = 0.5
#: without samples for so long nothing is known to be as it was, s
_SILENCE_S = 5.0
_FAULTY = (
    "the accelerometer does not follow the speed's acceleration, and is not used: "
    "another unit, gain, sign or axis, or another pitch than stated?"
)
_APART = (
    "torque and speed seem {:.1f} s apart or more, or the road is too rough: "
    "no mass is valid (effect torque_delay)"
)
_INCONSISTENT = (
    "speed and torque do not go together (normalised innovations squared of {:.1f}, where 1 is consistent): "
    "no mass is valid until they do; is one of them reported late or another signal, "
    "or does a brake or retarder act that nobody reports?"
)


class GaussianSum(Estimator):
    """Mass and grade as a sum of normal densities over the inverse mass (docs/theory.md)."""

    descriptions = (
        Description(
            "canest",
            "sum of Kalman filters over the inverse mass, one per hypothesis of load, road and driver",
            "this project, the default (docs/theory.md)",
        ),
    )
    constants: Constants = CONSTANTS
    valid_is_configured = True

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self._late_s = SHIFT * STEP_S + facts.filter_delay_s
        self._vehicle = v = vehicle_of(facts, self._late_s, self.constants)
        width = math.log(v.most_u / v.least_u)
        self._nodes = (v.least_u * np.exp((np.arange(_NODES) + 0.5) * width / _NODES)).tolist()
        self._gain, grade = gain_std(facts), facts.initial_grade or 0.0
        self._first_sine = grade / math.hypot(1.0, grade)
        self._unknown = self._densities(v.unknown_u, v.unknown_var)
        self._unknown.x[:, at.GRADE] = 0.0  # a start value holds once
        self._begin(v.unknown_u, v.unknown_var)

    def _begin(self, u: float, u_var: float) -> None:
        """Set every density to its prior, for an inverse mass."""
        facts, c, v = self.facts, self.constants, self._vehicle
        self._mixture = self._densities(u, u_var)
        guess = facts.initial_mass_kg or 1.0 / u
        report = Report(guess, guess * guess, self._first_sine, c.grade_std * c.grade_std)
        progress = kernel.Progress(MODES, u, bend_var=c.curvature_std_1pm**2)
        self._carried = kernel.Carried(progress, first_levels(v), Comparison(), report, RoadUse(), Joined())
        self._windows = Windows(
            self._late_s - facts.waits_s, facts.unreported_torque_Nm, facts.knows_retarder
        )
        self._status = StatusTracker(self.valid_std, bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._last = np.zeros(kernel.OUTPUTS)
        self._last[: kernel.OUT_SLOPE] = report[: kernel.OUT_SLOPE]
        self._last_tick = np.empty(0, np.int64)

    def _densities(self, u: float, u_var: float) -> Mixture:
        """Return the prior of every mode, for an inverse mass."""
        mean, std = self._prior(u)
        mix, shares = _room(len(mean)), _mode_shares(self.constants)
        for mode in range(MODES):
            own = std.copy()
            own[at.U] = math.sqrt(u_var)
            own[at.CURVATURE] *= at.BENDS[mode]
            own[at.RATE] *= at.DRIFTS[mode]
            mix.x[mode], mix.P[mode] = mean, np.diag(own * own)
            mix.x[mode, at.RATE] *= at.DRIFTS[mode]
            if at.ANSWERS[mode] > 0.0:
                draw_answer.interpreted(mix, mode, 0.0, u)
            mix.weight[mode], mix.mode[mode] = shares[mode], mode
        return mix

    def _prior(self, u: float) -> tuple[FloatColumn, FloatColumn]:
        """Return mean and std of every state but u, for an inverse mass."""
        facts, c = self.facts, self.constants
        mean, std = np.zeros((2, at.STATES))
        mean[at.GRADE], std[at.GRADE] = self._first_sine, c.grade_std
        mean[at.U] = u
        std[at.V], std[at.HEIGHT] = 10.0, 1.0
        std[at.CURVATURE] = c.curvature_std_1pm
        std[at.WIND] = math.hypot(c.wind_std_mps, 0.5 * _USUAL_MPS * facts.drag_area_accuracy) * u
        mean[at.RATE] = std[at.RATE] = c.drift_1ps * u
        std[at.DELAY], std[at.WINDUP] = c.delay_std_s * u, c.windup_std_s2 * u
        rolling = math.hypot(facts.rolling_resistance_accuracy, c.cold_share) * facts.rolling_resistance
        std[at.ROLLING] = math.hypot(rolling, LEVEL_STD) if facts.has_road_map else rolling
        std[at.OFFSET] = self._vehicle.offset_Nm * u
        std[at.BIAS] = c.bias_std_mps2
        mean[at.PITCH], std[at.PITCH] = self._vehicle.pitch, self._vehicle.pitch_std
        n = at.STATES if facts.has_accelerometer else at.STATES_WITHOUT_ACCELEROMETER
        return mean[:n], std[:n]

    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples; a sample's estimate uses the windows that end at or before it."""
        windows, ends = self._windows.push(block)
        known = np.vstack([self._last, self._run(windows)])
        self._last = known[-1]
        return self._estimates(known, ends, block)

    def _run(self, windows: FloatColumn) -> FloatColumn:
        """Pass windows (columns, w) through the loop; return its rows (w, OUTPUTS)."""
        rows = np.zeros((windows.shape[1], kernel.OUTPUTS))
        if not len(rows):
            return rows
        if not self.facts.has_accelerometer:
            windows[_SENSED] = np.nan
        taken: Any = np.ascontiguousarray(windows.T).view(_RECORD)[:, 0]
        out: Any = rows
        if not jit.enabled():
            taken, out = [Window(*fields) for fields in windows.T.tolist()], rows.tolist()
        mix = self._mixture = _given(self._mixture)
        c, v, space = self.constants, self._vehicle, _space(self._unknown, self._nodes)
        self._carried = kernel.run(len(rows), taken, mix, self._carried, c, v, space, out)
        return np.asarray(out)

    def _estimates(self, known: FloatColumn, ends: NDArray[np.int64], block: ModelBlock) -> EstimateBlock:
        """Give n samples what was known after their last window, the grade carried on to where they are.

        ends: samples on which the windows end, those of `known` but for its first row.
        """
        ticks, facts = block.t_us // STEP_US, self.facts
        last_ticks = np.concatenate((self._last_tick if len(self._last_tick) else ticks[:1], ticks[ends]))
        self._last_tick = last_ticks[-1:]
        rows = np.repeat(np.arange(len(known)), np.diff(ends, prepend=0, append=len(block)))
        mass, mass_var, grade, grade_var, slope, wander, learns, speed = known[rows].T
        since_s, learned = (ticks - last_ticks[rows]) * STEP_S, learns > 0.0
        silent = since_s > _SILENCE_S
        ahead_m = speed * np.clip(since_s, 0.0, _SILENCE_S)
        sine = np.clip(grade + slope * ahead_m, -_STEEPEST, _STEEPEST)
        mass = np.clip(mass, facts.mass_min_kg, facts.mass_max_kg)
        mass_std = np.sqrt(mass_var + (self._gain * mass) ** 2)
        mass_std = np.where(silent, np.maximum(mass_std, _UNKNOWN * mass), mass_std)
        mass_std = np.minimum(mass_std, facts.mass_max_kg)
        status = self._status.update(learned & ~silent, mass, mass_std)
        status[learned & silent] = Status.CONVERGING
        grade = sine / np.sqrt(1.0 - sine * sine)
        grade_std = np.minimum(np.sqrt(grade_var + wander * ahead_m), 1.0)
        if facts.initial_mass_kg is None and not learned.all():
            mass, mass_std, grade, grade_std = (
                np.where(learned, column, np.nan) for column in (mass, mass_std, grade, grade_std)
            )
        return EstimateBlock(mass, mass_std, grade, grade_std, status)

    def snapshot(self) -> dict[str, Any]:
        """Return the mass with its std, and of the innovations the mean square, what lasts, how many."""
        mass, levels = float(self._last[kernel.OUT_MASS]), self._carried.levels
        std = math.sqrt(self._last[kernel.OUT_VAR] + (self._gain * mass) ** 2)
        learned = bool(self._last[kernel.OUT_LEARNED] > 0.0)
        nis = levels.nis_sum / levels.windows if levels.windows else math.nan
        return {
            "mass_kg": mass,
            "mass_std_kg": std,
            "learned": learned,
            "nis": nis,
            "low_nis": levels.low_nis,
            "windows": levels.windows,
        }

    def contradiction(self) -> str:
        """Return what in the samples contradicts the vehicle's facts ('' for nothing)."""
        delay_s, levels = self._carried.progress.delay_s, self._carried.levels
        # where nothing can be learned, it may as well be the speed
        faulty = _FAULTY if self._carried.comparison.faulty and self._last[kernel.OUT_LEARNED] else ""
        too_long = delay_is_too_long.interpreted(delay_s, self.constants)
        apart = _APART.format(abs(delay_s)) if too_long else ""
        unlike = _INCONSISTENT.format(levels.nis) if levels.refuted and not too_long else ""
        return "; ".join(found for found in (self._beyond_bound(), faulty, apart, unlike) if found)

    def _beyond_bound(self) -> str:
        """Return the bound of the mass beyond which the driving leads, in a sentence."""
        if not self._last[kernel.OUT_LEARNED]:
            return ""
        t = _space(self._unknown, []).scratch
        best = set_loads.interpreted(self._mixture, self._carried.progress.alive, t)
        u, u_var = t.loads[3 * best + 1], t.loads[3 * best + 2] / self.constants.likelihood_power
        return beyond_bound(float(u), float(u_var), self.facts)

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:
        """Start from a remembered mass with its standard deviation; unseen time counts as standing."""
        u = min(max(1.0 / mass_kg, self._vehicle.least_u), self._vehicle.most_u)
        own = max(mass_std_kg**2 - (self._gain * mass_kg) ** 2, (1e-3 * mass_kg) ** 2)
        self._begin(u, self.constants.likelihood_power * own * u**4)
        self._last[kernel.OUT_LEARNED] = 1.0
        changed = unknown_load_var.interpreted(mass_kg, unseen_s, False, self.constants, self._vehicle)
        self._last[kernel.OUT_MASS], self._last[kernel.OUT_VAR] = mass_kg, own + changed
        progress = self._carried.progress._replace(learned=True)
        report = self._carried.report._replace(mass_kg=float(mass_kg), mass_var=float(own))
        unseen_s = max(float(unseen_s), self.constants.shortest_stop_s)  # the load may be another
        joined = self._carried.joined._replace(unseen_s=unseen_s)
        self._carried = self._carried._replace(progress=progress, report=report, joined=joined)


def _mode_shares(c: Constants) -> list[float]:
    """Return the prior probability of every mode: that of road, driver and load."""
    rough = c.rough_length_m / (c.smooth_length_m + c.rough_length_m)
    straight = c.straight_length_m / (c.straight_length_m + c.curved_length_m)
    drifts = c.drift_duration_s / (c.steady_duration_s + c.drift_duration_s)
    roads = ((1.0 - rough) * straight, (1.0 - rough) * (1.0 - straight), rough)
    drivers = (1.0 - c.answered_share, c.answered_share)
    return [load * driver * road for load in (1.0 - drifts, drifts) for driver in drivers for road in roads]


def _room(n: int) -> Mixture:
    """Return a mixture of n states with nothing in it."""
    A = np.zeros((MOST, n, n + 1))
    return Mixture(A[:, :, n], A[:, :, :n], A, *([zero] * MOST for zero in (0, 0, 0.0, 0.0)))


def _given(mix: Mixture) -> Mixture:
    """Return a mixture with columns as the kernels take them."""
    return Mixture(*mix[:3], *(state_in(column) for column in mix[3:]))


def _space(prior: Mixture, nodes: list[float]) -> Space:
    n = prior.x.shape[1]
    sizes = (4 * MOST, n + 1, MOST, MOST, 3 * LOADS, MODES * LOADS * MOST, MOST, MOST, MOST)
    f, K, e, s, loads, share, *columns = (state_in([0.0] * size) for size in sizes)
    scratch = Scratch(f, K, tuple(columns), e, s, loads)
    return Space(scratch, share, _given(_room(n)), _given(prior), state_in(nodes))
