"""Before and after, on parts of the data that the parameters were not fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canest.diagnose.problem import Problem
from canest.diagnose.search import Search
from canest.diagnose.windows import CHUNK_S
from canest.frames import BoolColumn, FloatColumn
from canest.pipeline import Estimates
from canest.vehicle.effects import Effect

#: the estimator gets this long before its errors count, s
SETTLE_S = 60.0


@dataclass(frozen=True)
class Score:
    """One row of the before-and-after table; None where there is nothing to compare with."""

    residual_rms_N: float
    residual_rms_N_std: float
    mass_kg: float | None
    mass_error_pct: float | None
    mass_rms_pct: float | None
    grade_rms_deg: float | None

    def to_json(self) -> dict[str, float | None]:
        """Return the contract's keys."""
        return {
            "residual_rms_N": round(self.residual_rms_N, 2),
            "residual_rms_N_std": round(self.residual_rms_N_std, 2),
            "mass_kg": _rounded(self.mass_kg, 1),
            "mass_error_pct": _rounded(self.mass_error_pct, 3),
            "mass_rms_pct": _rounded(self.mass_rms_pct, 3),
            "grade_rms_deg": _rounded(self.grade_rms_deg, 4),
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
    if len(problem.parts) > 1:
        half = problem.drive % 2 == 1
    else:
        half = problem.parts[0].windows.chunk % 2 == 1
    folds = []
    for judged in (half, ~half):
        effects, taken_N = search.fitted_on(~judged)
        folds.append(Fold(effects, taken_N, judged))
    return folds


def residual_score(problem: Problem, folds: Sequence[Fold]) -> tuple[float, float, FloatColumn]:
    """Return held-out residual RMS in N, its standard error (chunk bootstrap), and the residual (n,)."""
    left = np.empty(problem.rows)
    for fold in folds:
        residual = problem.residual_N(fold.effects) - fold.taken_N
        left[fold.judged] = residual[fold.judged]
    sums = np.bincount(problem.chunk, weights=left**2)
    counts = np.bincount(problem.chunk)
    draw = np.random.default_rng(0).integers(0, len(sums), (400, len(sums)))
    boot = np.sqrt(sums[draw].sum(axis=1) / counts[draw].sum(axis=1))
    return float(np.sqrt((left**2).mean())), float(boot.std()), left


def estimator_score(
    problem: Problem, folds: Sequence[Fold]
) -> tuple[dict[str, float | None], list[Estimates]]:
    """Return the estimator's errors on judged ticks, and one drive's estimates per drive (first fold)."""
    mass_errors, grade_errors, last = [], [], []
    shown: list[Estimates] = []
    for i, part in enumerate(problem.parts):
        for fold in folds:
            if len(problem.parts) > 1 and not fold.judged[problem.drive == i].any():
                continue
            e = part.drive.estimate(fold.effects)
            if len(shown) == i:
                shown.append(e)
            t = (e.t_us - e.t_us[0]) * 1e-6
            counted = (t > SETTLE_S) & np.isfinite(e.mass_kg)
            if len(problem.parts) == 1:
                odd = (t // CHUNK_S).astype(np.int64) % 2 == 1
                counted &= odd == bool(fold.judged[part.windows.chunk % 2 == 1].all())
            if np.isfinite(e.mass_kg).any():
                last.append(float(e.mass_kg[np.isfinite(e.mass_kg)][-1]))
            reference = part.reference
            if reference.mass_kg is not None:
                true = np.interp(e.t_us, part.run.samples.t_us, reference.mass_kg)
                mass_errors.append((e.mass_kg / true - 1.0)[counted])
            if reference.grade is not None:
                true = np.interp(e.t_us, part.run.samples.t_us, reference.grade)
                wrong = np.degrees(np.arctan(e.grade) - np.arctan(true))
                grade_errors.append(wrong[counted & np.isfinite(wrong)])
    mass = np.concatenate(mass_errors) if mass_errors else np.empty(0)
    grade = np.concatenate(grade_errors) if grade_errors else np.empty(0)
    return {
        "mass_kg": float(np.mean(last)) if last else None,
        "mass_error_pct": float(abs(mass.mean()) * 100) if len(mass) else None,
        "mass_rms_pct": float(np.sqrt((mass**2).mean()) * 100) if len(mass) else None,
        "grade_rms_deg": float(np.sqrt((grade**2).mean())) if len(grade) else None,
    }, shown


def score(problem: Problem, folds: Sequence[Fold]) -> tuple[Score, FloatColumn, list[Estimates]]:
    """Return one row of the table, the held-out residual per window, and estimates for the figures."""
    rms, std, left = residual_score(problem, folds)
    numbers, shown = estimator_score(problem, folds)
    return Score(rms, std, **numbers), left, shown
