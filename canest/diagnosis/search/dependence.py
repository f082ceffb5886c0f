"""What the residual depends on: speed, torque, gear, time, distance, curvature, and what causes an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import STEP_S
from canest.diagnosis.data.drive import Run
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.choice import Chosen

BINS = 12
#: fewer windows than this do not make a bin's mean
MIN_IN_BIN = 5


@dataclass(frozen=True)
class Cause:
    """A quantity, one value per window (n,): NaN where it is not known."""

    label: str
    values: FloatColumn


@dataclass(frozen=True)
class Binned:
    """Means of a residual over bins of a quantity: centres, means, standard errors (k,)."""

    centre: FloatColumn
    mean: FloatColumn
    std: FloatColumn


def causes(problem: Problem) -> dict[str, Cause]:
    """Return what the residual may depend on, by name; quantities that this data lacks are left out."""
    found = {name: Cause(label, _windowed(problem, column)) for name, (label, column) in _QUANTITIES.items()}
    return {name: c for name, c in found.items() if _varies(c)}


def cause_of(problem: Problem, chosen: Chosen, force_N: FloatColumn) -> Cause:
    """Return the cause of one effect; where there is no single one, the force (n,) that the effect gives."""
    effect = chosen.effect()
    quantity = _QUANTITIES.get(effect.caused_by) or _OF_EFFECTS.get(effect.caused_by)
    if quantity is not None:
        label, column = quantity
        cause = Cause(label, _windowed(problem, column))
        if _varies(cause):
            return cause
    signal = effect.signal
    if signal is not None:
        values = _windowed(problem, lambda run: run.signals.get(signal, np.full(len(run.open), np.nan)))
        cause = Cause(signal, values)
        if _varies(cause):
            return cause
    return Cause(f"force that {effect.name} gives, N", force_N)


def _varies(cause: Cause) -> bool:
    return np.unique(cause.values[np.isfinite(cause.values)]).size > 1


def binned(x: FloatColumn, y: FloatColumn, chunk: IntColumn) -> Binned:
    """Average y over quantile bins of x (over its values where there are few), errors by chunks."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y, chunk = x[known], y[known], chunk[known]
    bins = bin_numbers(x)
    rows = []
    for number in np.unique(bins):
        inside = bins == number
        if inside.sum() < MIN_IN_BIN:
            continue
        mean = y[inside].mean()
        # windows of one chunk share their errors: their deviations add up before they are squared
        sums = np.bincount(chunk[inside], weights=y[inside] - mean)
        rows.append((np.median(x[inside]), mean, np.sqrt((sums**2).sum()) / inside.sum()))
    table = np.array(rows).reshape(-1, 3)
    return Binned(*table.T)


def bin_numbers(x: FloatColumn) -> IntColumn:
    """Return the bin of each value (n,): quantiles, or the values themselves where there are few."""
    values = np.unique(x)
    if len(values) <= BINS:
        return np.asarray(np.searchsorted(values, x), np.int64)
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1]))
    return np.asarray(np.searchsorted(edges, x, side="right"), np.int64)


def depends(x: FloatColumn, y: FloatColumn) -> float:
    """Return the share of y's mean square that its means over bins of x explain (adjusted for their number).

    A constant force counts as well: the share is of the mean square, not of the variance.
    """
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if len(y) < 2 * BINS or not y.any():
        return 0.0
    bins = np.unique(bin_numbers(x), return_inverse=True)[1]
    counts = np.bincount(bins)
    means = np.bincount(bins, weights=y) / counts
    left = float(((y - means[bins]) ** 2).sum()) / max(len(y) - len(counts), 1)
    return float(np.clip(1.0 - left / float((y**2).mean()), 0.0, 1.0))


def _windowed(problem: Problem, column: Callable[[Run], FloatColumn]) -> FloatColumn:
    return np.concatenate([p.windows.mean(column(p.run)) for p in problem.parts])


def _distance_km(run: Run) -> FloatColumn:
    return np.asarray(np.cumsum(np.nan_to_num(run.samples.speed_mps)) * STEP_S * 1e-3)


def _curvature_1pkm(run: Run) -> FloatColumn:
    m = run.samples
    return np.abs(m.yaw_rate_radps) / np.maximum(m.speed_mps, 1.0) * 1e3


def _lateral_mps2(run: Run) -> FloatColumn:
    return np.abs(run.samples.yaw_rate_radps * run.samples.speed_mps)


_Quantity = tuple[str, Callable[[Run], FloatColumn]]
#: name -> label and column (ticks,) of what every residual is drawn over
_QUANTITIES: dict[str, _Quantity] = {
    "speed": ("speed, km/h", lambda run: run.samples.speed_mps * 3.6),
    "torque": ("net torque, N m", lambda run: run.torque_Nm),
    "gear": ("gear", lambda run: run.gear),
    "time": ("time since the start, s", lambda run: run.t_s),
    "distance": ("distance, km", _distance_km),
    "curvature": ("curvature, 1/km", _curvature_1pkm),
}
#: the same, of causes that only an effect names
_OF_EFFECTS: dict[str, _Quantity] = {
    "lateral_acceleration": ("lateral acceleration, m/s²", _lateral_mps2),
}
