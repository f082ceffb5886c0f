"""Which candidates this data cannot tell apart: they fit as well, or their regressors are the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from canest.diagnose.candidates import Candidate
from canest.diagnose.fit import chunk_sums
from canest.diagnose.problem import Problem
from canest.frames import FloatColumn, IntColumn

#: an alternative is as good while it leaves no more than the best one by this many standard errors
AS_GOOD_SIGMAS = 2.0
#: and by this share of what the best one leaves
AS_GOOD_SHARE = 0.05
#: or it is equivalent while what it leaves besides is below this share of what the chosen one leaves
EQUIVALENT_SHARE = 0.1
#: and it says nearly all that the chosen one says: what it misses is below this share of it
EQUIVALENT_MISS = 0.05
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
    """Candidates with their whitened regressors (n,), compared with one another."""

    def __init__(self, problem: Problem, offered: Sequence[tuple[Candidate, FloatColumn]]) -> None:
        self._problem, self._offered = problem, list(offered)

    def alike(self, c: Candidate) -> list[Candidate]:
        """Return the candidates whose regressors this data cannot tell from this one's."""
        mine = self._rest(next(column for o, column in self._offered if o.label == c.label), [])
        found = [
            o for o, column in self._offered if o.label != c.label and _mirrors(mine, self._rest(column, []))
        ]
        return sorted(found, key=lambda c: c.rank)

    def instead_of(
        self,
        chosen: Candidate,
        column: FloatColumn,
        without: FloatColumn,
        others: list[FloatColumn],
        best_left: FloatColumn,
        missed: float,
    ) -> list[Candidate]:
        """Return the candidates that do as well in the place of a chosen one.

        column: its regressor at its value; others: those of the other choices; without: the whitened residual
        without it; best_left: the squared held-out residual with it, (n,) each. missed: the sum of the
        squared held-out residual without it.
        """
        best = float(best_left.sum())
        mine = self._rest(column, others)
        found = []
        for c, theirs in self._offered:
            if c.label == chosen.label or not theirs.any():
                continue
            left = np.asarray(self._problem.held_out(without, [*others, theirs]) ** 2)
            worse = float(left.sum()) - best
            nearly = worse < min(EQUIVALENT_SHARE * best, EQUIVALENT_MISS * (missed - best))
            alike = _mirrors(mine, self._rest(theirs, others))
            if alike or nearly or as_good(left, best_left, self._problem.chunk):
                found.append(c)
        return sorted(found, key=lambda c: c.rank)

    def _rest(self, column: FloatColumn, others: list[FloatColumn]) -> FloatColumn:
        """Return what of a column the others (and the nuisances) cannot say."""
        matrix = self._problem.beside_nuisance(others)
        if not matrix.shape[1]:
            return column
        p, *_ = np.linalg.lstsq(matrix, column, rcond=1e-8)
        return np.asarray(column - matrix @ p)


def _mirrors(mine: FloatColumn, theirs: FloatColumn) -> bool:
    """Return whether two regressors are one up to size and sign; never for one that is all zeros."""
    size = np.sqrt((mine @ mine) * (theirs @ theirs))
    return bool(abs(mine @ theirs) > EQUIVALENT_CORRELATION * size)
