"""The values of the chosen effects, fitted together: Gauss-Newton on all windows, or on some of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from canest.diagnose.choice import Chosen
from canest.diagnose.fit import solve
from canest.diagnose.problem import Problem
from canest.frames import BoolColumn, FloatColumn
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
    for _ in range(STEPS):
        residual_N = problem.residual_N(effects_with(base, chosen))
        columns = regressors(problem, base, chosen, residual_N)
        fit = solve(problem.whiten(residual_N), problem.beside_nuisance(columns), problem.chunk)
        small = True
        for i, c in enumerate(chosen):
            change = float(fit.values[i])
            info = c.candidate.info
            bounded = np.clip(info.neutral + c.deviation + change, info.low, info.high)
            c.deviation = float(bounded - info.neutral)
            c.scatter = c.std = float(np.sqrt(fit.covariance[i, i]))
            small &= abs(change) < SMALL_STEP * c.scatter
        if small:
            break
    return problem.residual_N(effects_with(base, chosen))


def fit_on(
    problem: Problem, base: Sequence[Effect], chosen: Sequence[Chosen], rows: BoolColumn
) -> tuple[list[Effect], FloatColumn]:
    """Fit the chosen effects on these rows (n,) only; they themselves stay as they are.

    Returns base and refitted effects, and the force (n,) in N that a free mass takes out of the residual.
    """
    mine = [Chosen(c.candidate, c.deviation) for c in chosen]
    chunk = np.unique(problem.chunk[rows], return_inverse=True)[1]
    values = np.zeros(problem.nuisance.shape[1])
    for _ in range(STEPS if mine else 1):
        residual_N = problem.residual_N(effects_with(base, mine))
        matrix = problem.beside_nuisance(regressors(problem, base, mine, residual_N))
        if not matrix.shape[1]:
            break
        fit = solve(problem.whiten(residual_N)[rows], matrix[rows], chunk)
        for c, change in zip(mine, fit.values[: len(mine)].tolist(), strict=True):
            info = c.candidate.info
            c.deviation = float(
                np.clip(c.deviation + change, info.low - info.neutral, info.high - info.neutral)
            )
        values = fit.values[len(mine) :]
    taken = -problem.nuisance_N @ values if len(values) else np.zeros(problem.rows)
    return effects_with(base, mine), taken
