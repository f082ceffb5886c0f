"""The values of the chosen effects, fitted together: Gauss-Newton on all windows, or on some of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn
from canest.diagnosis.data.least_squares import Fit, Matrix, solve
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.choice import Chosen
from canest.vehicle.effects import Effect

STEPS = 6
#: a step this small, in standard deviations of every parameter, is the last
SMALL_STEP = 0.05


def effects_with(base: Sequence[Effect], chosen: Sequence[Chosen]) -> list[Effect]:
    """Return base and chosen effects."""
    return [*base, *(c.effect() for c in chosen)]


def regressors(
    problem: Problem, base: Sequence[Effect], chosen: Sequence[Chosen], residual_N: FloatColumn
) -> list[FloatColumn]:
    """Return the whitened change of the residual per unit of each chosen parameter, at its value (n,) each.

    residual_N: the residual (n,) with all of them at their values, not whitened.
    """
    columns = []
    for c in chosen:
        others = [o.effect() for o in chosen if o is not c]
        step = c.candidate.info.step
        moved = [*base, *others, c.candidate.make(c.deviation + step)]
        columns.append(problem.whiten((problem.residual_N(moved) - residual_N) / step))
    return columns


def refine(problem: Problem, base: Sequence[Effect], chosen: Sequence[Chosen]) -> FloatColumn:
    """Fit all chosen parameters together, in place (a delay or a wind is not linear).

    Returns the residual at their values (n,), in N, not whitened.
    """
    _fit(problem, base, chosen, np.ones(problem.rows, np.bool_))
    return problem.residual_N(effects_with(base, chosen))


def fit_on(
    problem: Problem, base: Sequence[Effect], chosen: Sequence[Chosen], rows: BoolColumn
) -> tuple[list[Effect], FloatColumn]:
    """Fit the chosen effects on these rows (n,) only; they themselves stay as they are.

    Returns base and refitted effects, and the force (n,) in N that a free mass takes out of the residual.
    """
    mine = [Chosen(c.candidate, c.deviation) for c in chosen]
    values = _fit(problem, base, mine, rows)
    taken = -problem.nuisance_N @ values if len(values) else np.zeros(problem.rows)
    return effects_with(base, mine), taken


def _fit(problem: Problem, base: Sequence[Effect], chosen: Sequence[Chosen], rows: BoolColumn) -> FloatColumn:
    """Fit the chosen parameters on these rows, in place; return the values of the nuisances.

    Regressors cost a run of the model each. So the ones from before are tried first: where they see nothing
    left to move, new ones would not either.
    """
    chunk = np.unique(problem.chunk[rows], return_inverse=True)[1]
    matrix: Matrix | None = None
    values = np.zeros(problem.nuisance.shape[1])
    for _ in range(STEPS):
        residual_N = problem.residual_N(effects_with(base, chosen))
        whitened = problem.whiten(residual_N)[rows]
        if matrix is not None:
            fit = solve(whitened, matrix, chunk)
            if _is_small(fit, chosen):
                break
        matrix = problem.beside_nuisance(regressors(problem, base, chosen, residual_N))[rows]
        if not matrix.shape[1]:
            break
        fit = solve(whitened, matrix, chunk)
        last = _is_small(fit, chosen)
        for i, c in enumerate(chosen):
            info = c.candidate.info
            bounded = np.clip(info.neutral + c.deviation + fit.values[i], info.low, info.high)
            c.deviation = float(bounded - info.neutral)
            c.scatter = c.std = float(np.sqrt(fit.covariance[i, i]))
        values = fit.values[len(chosen) :]
        if last:
            break
    return values


def _is_small(fit: Fit, chosen: Sequence[Chosen]) -> bool:
    """Return whether a step moves no parameter by what counts."""
    n = len(chosen)
    return bool((np.abs(fit.values[:n]) < SMALL_STEP * np.sqrt(np.diag(fit.covariance)[:n])).all())
