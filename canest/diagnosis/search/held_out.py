"""Before and after, on parts of the data that the parameters were not fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from canest.core.estimates import Estimates
from canest.core.frames import BoolColumn, FloatColumn, IntColumn, MonotonicClock
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.data.residual_windows import CHUNK_S
from canest.diagnosis.search.choice import Chosen
from canest.diagnosis.search.set_search import Search
from canest.vehicle.effects import Effect
from canest.vehicle.effects.load import added_kg

#: the estimator gets this long before its errors count, s
SETTLE_S = 60.0
BOOTSTRAPS = 400


@dataclass(frozen=True)
class Score:
    """One row of the before-and-after table; None where there is nothing to compare with.

    mass_kg: at the end (of several drives: their mean). mass_error_pct, mass_rms_pct, grade_rms_deg: mean
    and RMS of the errors of all judged samples, those of the mass in motion, positive where the estimate is
    too heavy.
    """

    residual_rms_N: float
    residual_rms_N_std: float
    mass_kg: float | None
    mass_error_pct: float | None
    mass_rms_pct: float | None
    grade_rms_deg: float | None
    #: 95 % confidence intervals by block bootstrap, by the names above
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the contract's keys, and the intervals."""
        return {
            "residual_rms_N": round(self.residual_rms_N, 2),
            "residual_rms_N_std": round(self.residual_rms_N_std, 2),
            "mass_kg": _rounded(self.mass_kg, 1),
            "mass_error_pct": _rounded(self.mass_error_pct, 3),
            "mass_rms_pct": _rounded(self.mass_rms_pct, 3),
            "grade_rms_deg": _rounded(self.grade_rms_deg, 4),
            "interval_95": {k: [float(f"{x:.4g}") for x in v] for k, v in self.intervals.items()},
        }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None or not np.isfinite(value) else round(value, digits)


@dataclass(frozen=True)
class Fold:
    """Effects fitted on one half, the force that a free mass takes there, and the rows to judge them on."""

    effects: list[Effect]
    taken_N: FloatColumn
    judged: BoolColumn


def two_folds(problem: Problem, search: Search) -> list[Fold]:
    """Fit the chosen effects on each half of the data (drives, or blocks of one drive)."""
    unit = problem.drive if len(problem.parts) > 1 else problem.parts[0].windows.chunk
    half = unit % 2 == 1
    folds = []
    for judged in (half, ~half):
        effects, taken_N = search.fit_on(~judged)
        folds.append(Fold(effects, taken_N, judged))
    return folds


def residual_score(
    problem: Problem, folds: Sequence[Fold]
) -> tuple[float, float, tuple[float, float], FloatColumn]:
    """Return held-out residual RMS in N, its standard error, its 95 % interval, and the residual (n,)."""
    left = np.empty(problem.rows)
    for fold in folds:
        residual = problem.residual_N(fold.effects) - fold.taken_N
        left[fold.judged] = residual[fold.judged]
    drawn = _bootstrap(left, problem.chunk)["rms"]
    return float(np.sqrt((left**2).mean())), drawn.std, drawn.interval, left


@dataclass(frozen=True)
class _Drawn:
    """A number with its standard error and 95 % interval, from blocks drawn anew."""

    std: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Step:
    """The held-out residual's RMS, N, once this effect is added to those before it."""

    added: Chosen
    residual_rms_N: float


def steps_to(search: Search, last_N: float) -> list[Step]:
    """Return how the residual falls from choice to choice. last_N: with all of them, as it was judged."""
    steps = []
    for k, added in enumerate(search.chosen[:-1], 1):
        part = copy(search)
        part.chosen = [Chosen(c.candidate, c.deviation) for c in search.chosen[:k]]
        rms_N, *_ = residual_score(search.problem, two_folds(search.problem, part))
        steps.append(Step(added, rms_N))
    return [*steps, *(Step(added, last_N) for added in search.chosen[-1:])]


def _bootstrap(errors: FloatColumn, block: IntColumn) -> dict[str, _Drawn]:
    """Return how certain `rms` and `mean` of errors (n,) are: whole blocks are drawn, with replacement."""
    number = np.unique(block, return_inverse=True)[1]
    sums = [
        np.asarray(np.bincount(number, weights=w), np.float64)
        for w in (np.ones(len(errors)), errors, errors**2)
    ]

    def rms(count: FloatColumn, _total: FloatColumn, square: FloatColumn, axis: int) -> FloatColumn:
        return np.asarray(np.sqrt(square.sum(axis=axis) / count.sum(axis=axis)))

    def mean(count: FloatColumn, total: FloatColumn, _square: FloatColumn, axis: int) -> FloatColumn:
        return np.asarray(total.sum(axis=axis) / count.sum(axis=axis))

    found = {}
    for name, statistic in (("rms", rms), ("mean", mean)):
        if len(sums[0]) < 2:  # one block shows no scatter
            value = float(statistic(sums[0], sums[1], sums[2], -1))
            found[name] = _Drawn(0.0, (value, value))
            continue
        drawn = bootstrap(
            sums, statistic, n_resamples=BOOTSTRAPS, paired=True, vectorized=True, method="percentile",
            rng=np.random.default_rng(0),
        )  # fmt: skip
        low, high = drawn.confidence_interval
        found[name] = _Drawn(float(drawn.standard_error), (float(low), float(high)))
    return found


class _Errors:
    """An estimator's errors on judged ticks, in blocks that count as independent.

    An estimator keeps an error for minutes, so that a block is a drive, or a minute where there is one drive.
    """

    def __init__(self, blocks_of: str) -> None:
        self._by_drive = blocks_of == "drives"
        self._errors: list[FloatColumn] = []
        self._blocks: list[IntColumn] = []

    def add(self, error: FloatColumn, t_s: FloatColumn, counted: BoolColumn, drive: int) -> None:
        counted = counted & np.isfinite(error)
        minute = (
            np.zeros(counted.sum(), np.int64) if self._by_drive else (t_s[counted] // 60.0).astype(np.int64)
        )
        self._errors.append(error[counted])
        self._blocks.append(minute + 1_000_000 * drive)

    def numbers(self, scale: float) -> tuple[dict[str, float | None], dict[str, tuple[float, float]]]:
        """Return `rms` and `mean`, and their intervals; None and nothing without errors."""
        errors = np.concatenate(self._errors) * scale if self._errors else np.empty(0)
        if not len(errors):
            return {"rms": None, "mean": None}, {}
        drawn = _bootstrap(errors, np.concatenate(self._blocks))
        of_all: dict[str, float | None] = {
            "rms": float(np.sqrt((errors**2).mean())),
            "mean": float(errors.mean()),
        }
        return of_all, {name: d.interval for name, d in drawn.items()}


def score(problem: Problem, folds: Sequence[Fold]) -> tuple[Score, FloatColumn, list[Estimates]]:
    """Return one row of the table, the held-out residual per window, and estimates for the figures.

    The estimates are one drive's each, made with the effects of the fold that judges it (of a single drive:
    the first fold).
    """
    residual_N, std_N, interval_N, left = residual_score(problem, folds)
    several = len(problem.parts) > 1
    mass, grade = (_Errors("drives" if several else "minutes") for _ in range(2))
    last: list[float] = []
    shown: list[Estimates] = []
    for i, part in enumerate(problem.parts):
        for fold in folds:
            if several and not fold.judged[problem.drive == i].any():
                continue
            e = part.drive.estimate(fold.effects)
            if len(shown) == i:
                shown.append(e)
            passed_us = MonotonicClock()(e.t_us)
            t = (passed_us - passed_us[0]) * 1e-6
            counted = (t > SETTLE_S) & np.isfinite(e.mass_kg)
            if not several and not fold.judged.all():
                odd = (t // CHUNK_S).astype(np.int64) % 2 == 1
                counted &= odd == bool(fold.judged[part.windows.chunk % 2 == 1].all())
            if np.isfinite(e.mass_kg).any():
                last.append(float(e.mass_kg[np.isfinite(e.mass_kg)][-1]))
            reference = part.reference  # which is of what the ticks show, not of when they are
            ticks_us = MonotonicClock()(part.run.samples.t_us) - round(part.run.behind_s * 1e6)
            if reference.mass_kg is not None:
                carried_kg = reference.mass_kg + added_kg(fold.effects, part.run.samples.t_us)
                true = np.interp(passed_us, ticks_us, carried_kg)
                # no driving shows a load that changes at rest before the vehicle moves again
                moves = np.interp(passed_us, ticks_us, ~part.run.samples.stopped) > 0.5
                mass.add(e.mass_kg / true - 1.0, t, counted & moves, i)
            if reference.grade is not None:
                true = np.interp(passed_us, ticks_us, reference.grade)
                grade.add(np.degrees(np.arctan(e.grade) - np.arctan(true)), t, counted, i)
    (mass_pct, mass_95), (grade_deg, grade_95) = mass.numbers(100.0), grade.numbers(1.0)
    intervals = {"residual_rms_N": interval_N}
    for key, of, name in (
        ("mass_error_pct", mass_95, "mean"),
        ("mass_rms_pct", mass_95, "rms"),
        ("grade_rms_deg", grade_95, "rms"),
    ):
        if name in of:
            intervals[key] = of[name]
    row = Score(
        residual_N, std_N, float(np.mean(last)) if last else None,
        mass_pct["mean"], mass_pct["rms"], grade_deg["rms"], intervals,
    )  # fmt: skip
    return row, left, shown
