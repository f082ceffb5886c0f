"""The values of the chosen effects, fitted together within their bounds, on all windows or some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import svd
from scipy.optimize import least_squares

from canest.core.frames import BoolColumn, FloatColumn
from canest.diagnosis.data.least_squares import Matrix, solve
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.choice import Chosen
from canest.vehicle.effects import Effect

#: the fit ends where a step gains less than this share of the squared residual, or after so many
SMALL_GAIN, MAX_STEPS = 1e-3, 8
#: regressors cost a run of the model each: they hold while no parameter has moved by more than so many steps
_SAME_REGRESSORS = 0.5
#: a start at a bound is moved inside by this share of the parameter's step
_INSIDE = 1e-3


@dataclass(frozen=True)
class Prior:
    """What may be in the residual beside the chosen effects: whitened columns (n, e), per standard deviation.

    noise: variance of one window; against it every column's price is weighed.
    """

    errors: Matrix
    noise: float

    def beside(self, rows: BoolColumn) -> Callable[[Matrix], Matrix]:
        """Return what takes out of columns on these rows (k, ...) what the errors may be."""
        basis, size, _ = svd(self.errors[rows], full_matrices=False)
        taken = 1.0 - np.sqrt(self.noise / (size**2 + self.noise))
        return lambda columns: columns - (basis * taken) @ (basis.T @ columns)


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


def refine(
    problem: Problem, base: Sequence[Effect], chosen: Sequence[Chosen], prior: Prior | None = None
) -> FloatColumn:
    """Fit all chosen parameters together, in place (a delay or a wind is not linear).

    prior: the small errors that may be beside them. Returns the residual at their values (n,), in N, not
    whitened.
    """
    _fit(problem, base, chosen, np.ones(problem.rows, np.bool_), prior)
    return problem.residual_N(effects_with(base, chosen))


def fit_on(
    problem: Problem,
    base: Sequence[Effect],
    chosen: Sequence[Chosen],
    rows: BoolColumn,
    prior: Prior | None = None,
) -> tuple[list[Effect], FloatColumn]:
    """Fit the chosen effects on these rows (n,) only; they themselves stay as they are.

    Returns base and refitted effects, and the force (n,) in N that a free mass takes out of the residual.
    """
    mine = [Chosen(c.candidate, c.deviation) for c in chosen]
    values = _fit(problem, base, mine, rows, prior)
    taken = -problem.nuisance_N @ values if len(values) else np.zeros(problem.rows)
    return effects_with(base, mine), taken


def _fit(
    problem: Problem,
    base: Sequence[Effect],
    chosen: Sequence[Chosen],
    rows: BoolColumn,
    prior: Prior | None,
) -> FloatColumn:
    """Fit the chosen parameters on these rows, in place; return the values of the nuisances.

    The nuisances are linear: at any values of the parameters they take what they can of the residual, so
    that only the parameters are searched for. They count in steps, which makes them alike in size.
    """
    chunk = np.unique(problem.chunk[rows], return_inverse=True)[1]
    if chosen:
        _search_values(problem, base, chosen, rows, prior)
    residual_N = problem.residual_N(effects_with(base, chosen))
    matrix = problem.beside_nuisance(regressors(problem, base, chosen, residual_N))[rows]
    if not matrix.shape[1]:
        return np.zeros(0)
    # a last, linear step would leave the bounds: the parameters stay, the nuisances and stds are taken
    fit = solve(problem.whiten(residual_N)[rows], matrix, chunk)
    for i, c in enumerate(chosen):
        c.scatter = c.std = float(np.sqrt(fit.covariance[i, i]))
    return solve(problem.whiten(residual_N)[rows], problem.nuisance[rows], chunk).values


def _search_values(
    problem: Problem,
    base: Sequence[Effect],
    chosen: Sequence[Chosen],
    rows: BoolColumn,
    prior: Prior | None,
) -> None:
    """Set the values that leave the smallest squared residual on these rows, each within its bounds."""
    infos = [c.candidate.info for c in chosen]
    steps = np.array([i.step for i in infos])
    low, high = (np.array([getattr(i, end) - i.neutral for i in infos]) / steps for end in ("low", "high"))
    likely = prior.beside(rows) if prior is not None and prior.errors.size else lambda columns: columns
    free = np.linalg.qr(likely(problem.nuisance[rows]))[0]
    # a large fault is less likely than a small one
    noise = 0.0 if prior is None else prior.noise
    price = np.sqrt(noise) * steps / np.array([c.candidate.scale for c in chosen])

    def beside(column: Matrix) -> Matrix:
        column = likely(column)
        return np.asarray(column - free @ (free.T @ column))

    def put(values: FloatColumn) -> FloatColumn:
        for c, value, step in zip(chosen, values.tolist(), steps.tolist(), strict=True):
            c.deviation = value * step
        return problem.residual_N(effects_with(base, chosen))

    def left(values: FloatColumn) -> FloatColumn:
        return np.concatenate((beside(problem.whiten(put(values))[rows]), price * values))

    at, known = np.full(len(chosen), np.inf), np.zeros((0, 0))

    def slope(values: FloatColumn) -> Matrix:
        nonlocal at, known
        if np.abs(values - at).max() > _SAME_REGRESSORS:
            columns = regressors(problem, base, chosen, put(values))
            changed = beside(np.column_stack(columns)[rows] * steps)
            at, known = values.copy(), np.vstack((changed, np.diag(price)))
        return known

    start = np.clip(
        [c.deviation / s for c, s in zip(chosen, steps, strict=True)], low + _INSIDE, high - _INSIDE
    )
    found = least_squares(
        left, start, slope, (low, high), x_scale="jac", ftol=SMALL_GAIN, xtol=1e-6, max_nfev=MAX_STEPS
    )
    put(found.x)
