"""The evidence for sets of effects: how well each explains the residual, for the number of its parameters.

A set's measure is the Bayesian information criterion,

    n log(left) + k log(n),

where `left` is what the set leaves of the squared residual, k how many effects it has, and n how many
independent observations there are. Seconds of one block of driving share their errors, so n is the number of
seconds over the inflation that their correlation causes. Two sets are compared by the difference: 2 log of
the odds between them.

A fault has a usual size, too: large faults are rarer than small ones. Otherwise two large effects that undo
each other would pass for the explanation of what little they leave.

An effect may come in several forms: a loss in one of the gears, a warm-up of several durations, a load at
one of the stops. They share the odds of one effect. The evidence for a set is therefore its mean over the
forms of its effects: where the best of ten gears fits well and nine do not, it must do so tenfold.

Every vehicle has small errors that nobody declares, and every reference has its own. They have a known spread
and are marginalised: each takes what it can of the residual, at the price of its prior. An effect within
what they may do is therefore no evidence for anything.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import prod

import numpy as np
from scipy.linalg import cho_factor, cho_solve, lstsq
from scipy.special import comb

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.diagnosis.data.least_squares import Matrix
from canest.diagnosis.search.candidates import Candidate

#: sets whose criterion is this close to the best are not separated by the data, and an effect is taken where
#: the criterion is better by this with it: odds of 20
DECISIVE = 6.0
#: an effect that is not there makes a set likelier by chance, by more than this (as 2 log) once in ten times
CHANCE = 2.7
#: effects of one set, beside the reporting delay
MAX_EFFECTS = 5
#: sets of two and more that are extended by one more effect
BEAM = 25


@dataclass(frozen=True)
class ScoredSet:
    """A set of candidates, by their places in the list: its criterion (lower is better), its values.

    forms: what of the criterion is the price for the other forms of its effects.
    """

    members: tuple[int, ...]
    criterion: float
    values: tuple[float, ...]
    forms: float = 0.0


class Evidence:
    """Scores sets of effects on the windows of one problem.

    errors: whitened columns (n, e) of the small errors, per standard deviation. nuisance: (n, m), always
    free. noise: variance of one window; inflation: of the variance of a sum, by correlation within blocks.
    """

    def __init__(self, errors: Matrix, nuisance: Matrix, noise: float, inflation: float) -> None:
        self._errors, self._nuisance = errors, nuisance
        self.noise = noise * inflation  #: variance of a window as if they were independent
        self.observations = max(len(errors) / inflation, 2.0)
        self._prior = cho_factor(errors.T @ errors + self.noise * np.eye(errors.shape[1]))

    def products(self, left: Matrix, right: Matrix) -> Matrix:
        """Return left' W right, where W takes out of both what small errors and nuisances may be."""
        kept = self._beside_errors(left, right)
        if self._nuisance.shape[1]:
            free = self._beside_errors(self._nuisance, self._nuisance)
            a, b = self._beside_errors(left, self._nuisance), self._beside_errors(self._nuisance, right)
            kept = kept - a @ np.linalg.pinv(free, rcond=1e-10, hermitian=True) @ b
        return kept

    def _beside_errors(self, left: Matrix, right: Matrix) -> Matrix:
        if not self._errors.shape[1]:
            return left.T @ right
        return np.asarray(
            left.T @ right - (left.T @ self._errors) @ cho_solve(self._prior, self._errors.T @ right)
        )

    def criterion(self, left: float, parameters: int) -> float:
        """Return the criterion of what is left of the squared residual by so many parameters."""
        n = self.observations
        return float(n * np.log(max(left, 1e-12)) + parameters * np.log(n))

    def of(
        self,
        residual: FloatColumn,
        columns: Sequence[FloatColumn],
        values: Sequence[float],
        scales: Sequence[float],
    ) -> float:
        """Return the criterion of a set by its residual (n,) and its regressors (n,) at its values.

        scales: standard deviations of the values among faults.
        """
        whole = np.column_stack([residual, *columns])
        prices = self.prices(scales)
        at = np.array([1.0, *values])
        pull = np.array([0.0, *prices]) * at
        products = self.products(whole, whole) + np.diag([0.0, *prices])
        products[0, :] += pull
        products[:, 0] += pull
        products[0, 0] += float(pull @ at)
        left, _ = _left(products, tuple(range(1, whole.shape[1])))
        return self.criterion(left, len(columns))

    def prices(self, scales: Sequence[float]) -> FloatColumn:
        """Return what a value of one costs, as squared residual: less likely the larger, (k,)."""
        return np.asarray(self.noise / np.square(np.array(scales, np.float64)))

    def remainder(self, residual: FloatColumn) -> FloatColumn:
        """Return what small errors and nuisances leave of a residual (n,), both at their likeliest."""
        fixed = np.column_stack([self._nuisance, self._errors])
        prior = np.zeros((self._errors.shape[1], fixed.shape[1]))
        prior[:, self._nuisance.shape[1] :] = np.eye(self._errors.shape[1]) * np.sqrt(self.noise)
        stacked = np.vstack([fixed, prior])
        taken, *_ = lstsq(stacked, np.append(residual, np.zeros(len(prior))))
        return np.asarray(residual - fixed @ taken)


def _left(products: Matrix, members: tuple[int, ...]) -> tuple[float, FloatColumn]:
    """Return what is left of column 0 beside the members, and their values."""
    if not members:
        return float(products[0, 0]), np.empty(0)
    places = list(members)
    wanted = products[places, 0]
    scale = np.sqrt(np.maximum(np.diag(products)[places], 1e-30))
    inverse = np.linalg.pinv(
        products[np.ix_(places, places)] / np.outer(scale, scale), rcond=1e-9, hermitian=True
    )
    values = -(inverse @ (wanted / scale)) / scale
    return float(products[0, 0] + wanted @ values), values


def price_of(members: int, offered: int) -> float:
    """Return by how much a set's criterion must be better than that of no effect, to be taken.

    Each effect must be decisive. And of many more pairs than effects, the best one is better by chance: the
    extended criterion of Chen and Chen (2008) counts the sets of a size.
    """
    if not members:
        return 0.0
    return DECISIVE * members + 2.0 * float(np.log(comb(offered, members) / offered))


def inflation_of(left: FloatColumn, chunk: IntColumn) -> float:
    """Return by how much the correlation of a residual (n,) within blocks inflates a variance, at least 1."""
    sums = np.bincount(chunk, weights=left)
    longest = float(np.bincount(chunk).max())
    return float(np.clip((sums**2).sum() / max(float(left @ left), 1e-30), 1.0, longest))


def errors_shown(
    errors: Matrix, residual: FloatColumn, free: Matrix, noise: float, kept: BoolColumn
) -> BoolColumn:
    """Return which small errors the data shows (e,): those without which it would be less likely.

    errors: whitened (n, e), per standard deviation; residual: (n,); free: (n, k), what is fitted beside them.
    noise: variance of one window; kept: errors (e,) that stay in any case. Every combination of the others is
    tried: they are few. An error that is not there would only add scatter to the values fitted beside it.
    """
    basis = np.linalg.qr(free)[0]
    whole = np.column_stack([residual, errors])
    whole = whole - basis @ (basis.T @ whole)
    products = whole.T @ whole / noise

    def likelihood(places: list[int]) -> float:
        at = [i + 1 for i in places]
        inner = np.eye(len(at)) + products[np.ix_(at, at)]
        pull = products[at, 0]
        return float(0.5 * (pull @ np.linalg.solve(inner, pull) - np.linalg.slogdet(inner)[1]))

    own = np.flatnonzero(~kept).tolist()
    subsets = (list(some) for size in range(len(own) + 1) for some in combinations(own, size))
    always = np.flatnonzero(kept).tolist()
    return np.isin(np.arange(len(kept)), max((always + some for some in subsets), key=likelihood))


def likeliest_errors(
    errors: Matrix, residual: FloatColumn, free: Matrix, noise: float
) -> tuple[FloatColumn, FloatColumn]:
    """Return the likeliest small errors and their standard deviations (e,) each, per usual spread.

    Arguments as for `errors_shown`. The residual is what they leave if they are not in the model.
    """
    basis = np.linalg.qr(free)[0]
    mine = errors - basis @ (basis.T @ errors)
    covariance = np.linalg.inv(np.eye(errors.shape[1]) + mine.T @ mine / noise)
    return -covariance @ (mine.T @ residual) / noise, np.sqrt(np.diag(covariance))


def likely_sets(
    evidence: Evidence, residual: FloatColumn, candidates: Sequence[Candidate], columns: Sequence[FloatColumn]
) -> list[ScoredSet]:
    """Return sets of candidates, best first: every single one, every pair, and the best larger ones.

    residual: whitened (n,); columns: whitened regressors (n,), one per candidate. A set whose value no
    vehicle can have, or that has an effect twice, is left out.
    """
    whole = np.column_stack([residual, *columns])
    prices = evidence.prices([c.scale for c in candidates])
    products = evidence.products(whole, whole) + np.diag([0.0, *prices])
    left, _ = _left(products, ())
    found = [ScoredSet((), evidence.criterion(left, 0), ())]
    last = found
    for size in range(1, MAX_EFFECTS + 1):
        grown: dict[tuple[int, ...], ScoredSet] = {}
        for base in last if size <= 2 else last[:BEAM]:
            for new, c in enumerate(candidates):
                members = tuple(sorted((*base.members, new)))
                if members in grown or any(c.repeats(candidates[m]) for m in base.members):
                    continue
                left, values = _left(products, tuple(m + 1 for m in members))
                if all(candidates[m].possible(v) for m, v in zip(members, values.tolist(), strict=True)):
                    criterion = evidence.criterion(left, size)
                    grown[members] = ScoredSet(members, criterion, tuple(values.tolist()))
        last = sorted(grown.values(), key=lambda s: s.criterion)
        found += last
    return sorted(_averaged_over_forms(found, candidates), key=lambda s: s.criterion)


def _averaged_over_forms(sets: Sequence[ScoredSet], candidates: Sequence[Candidate]) -> list[ScoredSet]:
    """Return the sets, each with the price by which the best form of its effects has the mean's criterion.

    Forms that no vehicle can have, and those of larger sets that were not looked at, are no evidence.
    """
    groups: dict[tuple[tuple[str, bool], ...], list[ScoredSet]] = {}
    for s in sets:
        groups.setdefault(tuple(sorted(candidates[m].family for m in s.members)), []).append(s)
    found = []
    for families, forms in groups.items():
        possible = prod(_forms(candidates, family, times) for family, times in Counter(families).items())
        criteria = np.array([s.criterion for s in forms])
        odds = np.exp(-0.5 * (criteria - criteria.min())).sum()
        price = 2.0 * float(np.log(possible / odds))
        found += [replace(s, criterion=s.criterion + price, forms=price) for s in forms]
    return found


def _forms(candidates: Sequence[Candidate], family: tuple[str, bool], times: int) -> int:
    """Return in how many forms an effect may be in a set so many times (a loss in two of the gears)."""
    mine = [c for c in candidates if c.family == family]
    return sum(not any(a.repeats(b) for a, b in combinations(some, 2)) for some in combinations(mine, times))


def without_idle_members(sets: Sequence[ScoredSet], observations: float) -> list[ScoredSet]:
    """Return the sets in which the data speaks for every effect, be it little.

    Without it the set would be less likely by more than chance makes of an effect that is not there.
    """
    by_members = {s.members: s.criterion for s in sets}
    price = float(np.log(observations)) - CHANCE

    def idle(s: ScoredSet) -> bool:
        smaller = (tuple(m for m in s.members if m != gone) for gone in s.members)
        return any(by_members.get(members, np.inf) + price <= s.criterion for members in smaller)

    return [s for s in sets if not idle(s)]
