"""Keeps what a report draws while a log streams by; memory is bounded however long the log is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from canest.core.frames import FloatColumn, IntColumn, MonotonicClock
from canest.core.samples import STEP_S, STEP_US, EstimateBlock, ModelBlock
from canest.grid.grid import GridBlock
from canest.offline.extra_columns import engaged
from canest.report.detail import Detail
from canest.vehicle.residual import residual_N

#: points per curve at most; then every other one goes. All samples are in the detail.
POINTS_MAX = 10_000
#: positions of the track at most
TRACK_MAX = 4_000
FIRST_STRIDE = 10
#: shorter closures are one stroke wide on any screen, but thousands of them would make the page slow
EDGES_MAX = 20_000

#: clock_us: the log's own stamps
COLUMNS = (
    "distance_m", "clock_us",
    "raw_speed_mps", "raw_torque_Nm", "raw_force_N", "accel_mps2", "force_N", "traction_N", "mu",
    "gear",
    "mass_kg", "mass_std_kg", "grade", "grade_std", "status", "gate",
)  # fmt: skip


class Recorder:
    """A pipeline's listener: every tick that is a multiple of the stride, and every change of the gate.

    All stamps are of time that goes on where the log's clock was set back.
    first_us, last_us: stamps of the first and the last sample.
    detail: all samples, packed. track: where the vehicle was.
    """

    def __init__(self) -> None:
        self._monotonic = MonotonicClock()
        self.detail = Detail()
        self.track = Positions()
        self._distance_m = 0.0
        self.first_us: int | None = None
        self.last_us = 0
        self._stride = FIRST_STRIDE
        self._held: list[dict[str, FloatColumn]] = []
        self._stamps: list[IntColumn] = []
        self._points = 0
        self._edges: list[tuple[int, int]] = []
        self._gate = -1
        self._residuals = Whiteness()

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples and their estimates."""
        if not len(samples):
            return
        clock_us = samples.t_us
        samples = replace(samples, t_us=self._monotonic(clock_us))
        if self.first_us is None:
            self.first_us = int(samples.t_us[0])
        self._note_gates(samples)
        self._residuals.push(samples, estimates)
        self.last_us = int(samples.t_us[-1])
        way_m = self._way_m(samples)
        self._push_detail(samples, estimates, way_m)
        keep = np.flatnonzero(samples.t_us // STEP_US % self._stride == 0)
        if not len(keep):
            return
        held = {"distance_m": way_m[keep], "clock_us": clock_us[keep].astype(np.float64)}
        for name in COLUMNS[2:]:
            block = samples if hasattr(samples, name) else estimates
            held[name] = np.asarray(getattr(block, name)[keep], np.float64)
        self._stamps.append(samples.t_us[keep])
        self._held.append(held)
        self._points += len(keep)
        if self._points > POINTS_MAX:
            self._thin()

    def columns(self) -> tuple[IntColumn, dict[str, FloatColumn]]:
        """Return the stamps (n,) and the columns of `COLUMNS`, each (n,)."""
        if not self._stamps:
            return np.empty(0, np.int64), {name: np.empty(0) for name in COLUMNS}
        return np.concatenate(self._stamps), {
            name: np.concatenate([held[name] for held in self._held]) for name in COLUMNS
        }

    def closures(self) -> list[tuple[int, int, int]]:
        """Return every stretch with a closed gate: (first stamp, end stamp, gate code)."""
        ends = [stamp for stamp, _ in self._edges[1:]] + [self.last_us + STEP_US]
        return [(stamp, end, code) for (stamp, code), end in zip(self._edges, ends, strict=True) if code > 0]

    @property
    def whiteness(self) -> Whiteness:
        """Return the residual's statistics over all open samples."""
        return self._residuals

    def _way_m(self, samples: ModelBlock) -> FloatColumn:
        """Return the way driven so far (n,), m; it stands still where the speed is not known."""
        speed = np.where(samples.stopped, 0.0, np.abs(np.nan_to_num(samples.raw_speed_mps)))
        way_m = self._distance_m + np.cumsum(speed) * STEP_S
        self._distance_m = float(way_m[-1])
        return way_m

    def _push_detail(self, samples: ModelBlock, e: EstimateBlock, way_m: FloatColumn) -> None:
        residual = residual_N(e.mass_kg, samples.accel_mps2, e.grade, samples.mu, samples.force_N)
        known = np.where(np.isfinite(samples.raw_force_N), 1.0, np.nan)
        self.detail.push((samples.t_us - (self.first_us or 0)) // STEP_US, {
            "mass_kg": e.mass_kg, "mass_std_kg": e.mass_std_kg, "grade": e.grade, "grade_std": e.grade_std,
            "speed_mps": samples.raw_speed_mps, "torque_Nm": samples.raw_torque_Nm,
            "gear": engaged(samples.gear),
            "traction_N": samples.traction_N * known, "force_N": samples.force_N * known,
            "residual_N": np.where(samples.gate == 0, residual, np.nan),
            "gate": samples.gate.astype(np.float64), "status": e.status.astype(np.float64),
            "distance_m": way_m,
        })  # fmt: skip

    def _note_gates(self, samples: ModelBlock) -> None:
        gate = samples.gate.astype(np.int64)
        before = np.empty(len(gate), np.int64)
        before[0], before[1:] = self._gate, gate[:-1]
        if self.last_us and samples.t_us[0] - self.last_us != STEP_US:
            # nothing is known of the time in between
            self._edges.append((self.last_us + STEP_US, 0))
            before[0] = 0
        for at in np.flatnonzero(gate != before).tolist():
            self._edges.append((int(samples.t_us[at]), int(gate[at])))
        self._gate = int(gate[-1])
        if len(self._edges) > EDGES_MAX:
            self._edges = _without_shortest(self._edges)

    def _thin(self) -> None:
        self._stride *= 2
        stamps, columns = self.columns()
        keep = stamps // STEP_US % self._stride == 0
        self._stamps = [stamps[keep]]
        self._held = [{name: column[keep] for name, column in columns.items()}]
        self._points = int(np.count_nonzero(keep))


class Positions:
    """Where the vehicle was: a pipeline's listener for ticks, one position per second or fewer."""

    def __init__(self) -> None:
        self._monotonic = MonotonicClock()
        self._held: list[FloatColumn] = []  #: (3, n): stamp, latitude, longitude
        self._stride = 50

    def __call__(self, ticks: GridBlock) -> None:
        """Take the next ticks."""
        t_us = self._monotonic(ticks.t_us)
        roles = [ticks.values.get(role) for role in ("latitude", "longitude")]
        if roles[0] is None or roles[1] is None:
            return
        keep = (t_us // STEP_US % self._stride == 0) & np.isfinite(roles[0]) & np.isfinite(roles[1])
        self._held.append(np.array([t_us[keep], roles[0][keep], roles[1][keep]], np.float64))
        if sum(part.shape[1] for part in self._held) > TRACK_MAX:
            self._stride *= 2
            held = self.columns()
            self._held = [held[:, held[0] // STEP_US % self._stride == 0]]

    def columns(self) -> FloatColumn:
        """Return stamps, us, latitudes and longitudes, deg: (3, n)."""
        return np.concatenate(self._held, axis=1) if self._held else np.empty((3, 0))


def _without_shortest(edges: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Drop the shorter half of the stretches; their time goes to the stretch before."""
    spans = np.diff([stamp for stamp, _ in edges])
    limit = np.median(spans)
    keep = [True, *(spans[1:] > limit).tolist(), True]
    return [edge for edge, kept in zip(edges, keep, strict=True) if kept]


class Whiteness:
    """Force residual m (a + g sin + g mu cos) - F with the estimate of the sample: its size and colour.

    White residuals mean that the model explains what can be explained; runs of one sign mean that it lacks
    something (or that the estimator lags).
    """

    #: residuals one second apart: the Butterworth's own correlation has died away
    LAG_US = 1_000_000

    def __init__(self) -> None:
        self.count = self.runs = self.positive = 0
        self.square_N2 = self.lagged_N2 = self.paired_N2 = 0.0
        self._last: tuple[int, float] | None = None

    def push(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take open samples, one per second."""
        at = (samples.gate == 0) & (samples.t_us % self.LAG_US == 0) & np.isfinite(estimates.mass_kg)
        if not at.any():
            return
        r = residual_N(
            estimates.mass_kg[at],
            samples.accel_mps2[at],
            estimates.grade[at],
            samples.mu[at],
            samples.force_N[at],
        )
        for stamp, value in zip(samples.t_us[at].tolist(), r.tolist(), strict=True):
            if value != value:  # noqa: PLR0124 - NaN
                continue
            self.count += 1
            self.positive += value > 0
            self.square_N2 += value * value
            before = self._last
            if before is not None and stamp - before[0] == self.LAG_US:
                self.lagged_N2 += value * before[1]
                self.paired_N2 += 0.5 * (value * value + before[1] * before[1])
            # a gap ends no run: what is tested is the order of the signs, whenever each was seen
            self.runs += before is None or (value > 0) != (before[1] > 0)
            self._last = stamp, value

    @property
    def rms_N(self) -> float:
        """Root mean square of the residual, N."""
        return float((self.square_N2 / self.count) ** 0.5) if self.count else float("nan")

    @property
    def correlation(self) -> float:
        """Correlation of residuals one second apart, of those that have such a neighbour; 0 is white."""
        return self.lagged_N2 / self.paired_N2 if self.paired_N2 > 0 else float("nan")

    @property
    def runs_z(self) -> float:
        """Runs test of the sequence of all signs (Wald and Wolfowitz 1940); below -2: too few changes.

        Standard normal where every order of the signs is as likely.
        """
        n, up = self.count, self.positive
        down = n - up
        if up < 2 or down < 2:
            return float("nan")
        mean = 2.0 * up * down / n + 1
        variance = (mean - 1) * (mean - 2) / (n - 1)
        return float((self.runs - mean) / variance**0.5) if variance > 0 else float("nan")
