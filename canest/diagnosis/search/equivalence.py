"""Which candidates this data cannot separate: they fit as well, or their regressors are the same.

As well: as they stand, or with the small errors that every vehicle has and that nobody can rule out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.diagnosis.data.least_squares import chunk_sums, held_out, solve
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.candidates import Candidate

#: an alternative is as good while it leaves no more than the best one by this many standard errors
AS_GOOD_SIGMAS = 2.0
#: and by this share of what the best one leaves
AS_GOOD_SHARE = 0.05
#: or it is equivalent while what it leaves besides is below this share of what the chosen one leaves
EQUIVALENT_SHARE = 0.1
#: and it explains nearly all that the chosen effect explains: the rest is below this share of it
EQUIVALENT_MISS = 0.05
#: or it explains this much of what the chosen effect explains, and with small errors it fits as well
EQUIVALENT_PART = 0.9
#: or while its regressor is the chosen one's mirror image up to this correlation
EQUIVALENT_CORRELATION = 0.998


def as_good(left: FloatColumn, best_left: FloatColumn, chunk: IntColumn) -> bool:
    """Return whether one squared held-out residual (n,) is as good as the best one (n,)."""
    worse = chunk_sums(left - best_left, chunk)
    standard_error = np.sqrt(len(worse)) * worse.std(ddof=1) if len(worse) > 1 else np.inf
    return bool(
        worse.sum() <= AS_GOOD_SIGMAS * standard_error and worse.sum() < AS_GOOD_SHARE * best_left.sum()
    )


class Alternatives:
    """Candidates with their whitened regressors (n,), compared with one another.

    spread: effect -> standard deviation of the small error of its kind that any vehicle may have.
    """

    def __init__(
        self,
        problem: Problem,
        offered: Sequence[tuple[Candidate, FloatColumn]],
        spread: Mapping[str, float],
    ) -> None:
        self._problem, self._offered = problem, list(offered)
        self._errors = [spread[c.label] * column for c, column in offered if c.label in spread]

    def alike(self, c: Candidate) -> list[Candidate]:
        """Return the candidates whose regressors this data cannot separate from this one's."""
        mine = self._rest(next(column for o, column in self._offered if o.label == c.label), [])
        found = [
            o for o, column in self._offered if o.label != c.label and _mirrors(mine, self._rest(column, []))
        ]
        return sorted(found, key=lambda c: c.rarity)

    def instead_of(
        self,
        chosen: Candidate,
        column: FloatColumn,
        residual: FloatColumn,
        without: FloatColumn,
        others: list[FloatColumn],
        best_left: FloatColumn,
        missed: float,
    ) -> list[Candidate]:
        """Return the candidates that do as well in the place of a chosen one.

        column: its regressor at its value; others: those of the other choices; residual, without: the
        whitened residual with and without it; best_left: the squared held-out residual with it, (n,) each.
        missed: the sum of the squared held-out residual without it.
        """
        best, chunk = float(best_left.sum()), self._problem.chunk
        best_allowing = self._left_allowing(residual, [*others, column], best)
        mine = self._rest(column, others)
        found = []
        for c, theirs in self._offered:
            if c.label == chosen.label or not theirs.any():
                continue
            fit = solve(without, self._problem.beside_nuisance([theirs, *others]), chunk)
            if not c.possible(float(fit.values[0])):
                continue  # no vehicle is like that
            left = np.asarray(self._problem.held_out(without, [*others, theirs]) ** 2)
            worse = float(left.sum()) - best
            nearly = worse < min(EQUIVALENT_SHARE * best, EQUIVALENT_MISS * (missed - best))
            alike = _mirrors(mine, self._rest(theirs, others))
            beside_errors = self._left_allowing(without, [*others, theirs], best)
            allowing = as_good(beside_errors, best_allowing, chunk)
            # what a delay leaves may be small errors: what takes more of these is no evidence of a delay
            plainly = (nearly or as_good(left, best_left, chunk)) and (allowing or not chosen.is_delay)
            if alike or plainly or (allowing and worse < (1.0 - EQUIVALENT_PART) * (missed - best)):
                found.append(c)
        return sorted(found, key=lambda c: c.rarity)

    def _left_allowing(self, residual: FloatColumn, columns: list[FloatColumn], best: float) -> FloatColumn:
        """Return the squared held-out residual (n,) with small errors beside the columns.

        best: what the best choice leaves; a chunk of it counts as one observation against their spread.
        """
        matrix = self._problem.beside_nuisance([*columns, *self._errors])
        places = len(columns) + np.arange(len(self._errors))
        prior = np.zeros((len(self._errors), matrix.shape[1]))
        prior[np.arange(len(places)), places] = np.sqrt(best / self._problem.chunks)
        return np.asarray(held_out(residual, matrix, self._problem.chunk, prior) ** 2)

    def _rest(self, column: FloatColumn, others: list[FloatColumn]) -> FloatColumn:
        """Return the part of a column that the others (and the nuisances) cannot explain."""
        matrix = self._problem.beside_nuisance(others)
        if not matrix.shape[1]:
            return column
        p, *_ = np.linalg.lstsq(matrix, column, rcond=1e-8)
        return np.asarray(column - matrix @ p)


def _mirrors(mine: FloatColumn, theirs: FloatColumn) -> bool:
    """Return whether two regressors are one up to size and sign; never for one that is all zeros."""
    size = np.sqrt((mine @ mine) * (theirs @ theirs))
    return bool(abs(mine @ theirs) > EQUIVALENT_CORRELATION * size)
