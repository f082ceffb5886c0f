"""Whether what was found explains the residual, by what is left of it."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.data.whitening import WINDOW_NOISE_MPS2
from canest.diagnosis.search.held_out import Score
from canest.diagnosis.search.joint_fit import MIN_TORQUE_STEPS
from canest.diagnosis.search.set_search import Search

#: what is left may wander this much (share of weight) and still count as explained: a slope of 0.04 %
SMALL_REMAINDER = 4e-4
#: standard deviations of the grade's error that a remainder may be, and still be that
USUAL_SIGMAS = 2.0
#: shares of the first residual's variance that make a verdict
EXPLAINED_SHARE, PARTLY_SHARE = 0.95, 0.2
#: more of the first residual than this, as RMS, is never called explained, whatever it looks like
LARGE_SHARE_LEFT = 0.5


def verdict_of(problem: Problem, search: Search, before: Score, after: Score) -> str:
    """Return `explained`, `partly`, `unexplained` or `nothing-to-explain`."""
    small = little_left(problem, search)
    if not search.chosen:
        nothing = small or (within_usual(problem, search) and not search.evident)
        return "nothing-to-explain" if nothing else "unexplained"
    left = after.residual_rms_N / max(before.residual_rms_N, 1e-9)
    if after.residual_rms_N <= _noise_N(problem) or (
        left <= LARGE_SHARE_LEFT and (small or 1.0 - left**2 >= EXPLAINED_SHARE)
    ):
        return "explained"
    return "partly" if 1.0 - left**2 >= PARTLY_SHARE else "unexplained"


def within_usual(problem: Problem, search: Search) -> bool:
    """Return whether small errors, as every drive has them, leave no more than the grade's error."""
    left_N = search.residual_N + search.usual_errors_N()
    return _wanders_N(problem, left_N) <= max(SMALL_REMAINDER * problem.weight_N, grade_part_N(problem))


def grade_part_N(problem: Problem) -> float:
    """Return what the error of the grade's reference may make of a remainder, N."""
    return USUAL_SIGMAS * float(np.sqrt((problem.grade_error_N() ** 2).mean()))


def _noise_N(problem: Problem) -> float:
    """Return the RMS, N, of what is noise in any case: one second's scatter, and the torque's rounding."""
    scatter_N = WINDOW_NOISE_MPS2 * problem.weight_N / GRAVITY_MPS2
    return float(np.hypot(scatter_N, problem.torque_step_N / np.sqrt(12.0)))


def _remainder_N(problem: Problem, search: Search) -> float:
    """Return how much the remainder wanders from chunk to chunk, in N."""
    return _wanders_N(problem, search.residual_N + _mass_part_N(problem, search))


def _wanders_N(problem: Problem, left: FloatColumn) -> float:
    """Return how much a residual (n,) wanders from chunk to chunk, N: noise averages out, causes do not."""
    sums = np.bincount(problem.chunk, weights=left)
    counts = np.maximum(np.bincount(problem.chunk), 1)
    means = sums / counts
    noise = left.var() / counts
    return float(np.sqrt(max(np.mean(means**2 - noise), 0.0)))


def little_left(problem: Problem, search: Search) -> bool:
    """Return whether the remainder wanders by no more than a small slope, or the rounding of torque, does."""
    rounding_N = MIN_TORQUE_STEPS * problem.torque_step_N
    return _remainder_N(problem, search) < max(SMALL_REMAINDER * problem.weight_N, rounding_N)


def _mass_part_N(problem: Problem, search: Search) -> FloatColumn:
    if problem.mass_known:
        return np.zeros(problem.rows)
    _, taken = search.fit_on(np.ones(problem.rows, np.bool_))
    return -taken
