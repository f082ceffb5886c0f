"""The search for the set of effects that explains the residual, and for the sets that do as well.

All single effects, all pairs and the best larger sets are compared by their evidence (`evidence`), first with
straight lines for every effect, then, those that come into question, with values fitted by the model itself.
What is taken must be decisive; what is stated as possible besides need only be as likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.diagnosis.data.least_squares import solve
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen, Tried
from canest.diagnosis.search.evidence import (
    DECISIVE,
    Evidence,
    ScoredSet,
    errors_shown,
    inflation_of,
    likeliest_errors,
    likely_sets,
    price_of,
    without_idle_members,
)
from canest.diagnosis.search.fitted_sets import FittedSet, commonest, widen_by_rivals
from canest.diagnosis.search.joint_fit import TICK_STD_S, JointFit
from canest.diagnosis.search.value_fit import Prior, refine, regressors

#: every engine controller reports late: its cycle of 10 to 50 ms, what it averages over, a gateway. Up to
#: this a delay is no finding, s
USUAL_DELAY_S = 0.15
#: an effect must remove this share of what is left of the held-out variance
MIN_SHARE = 0.03
#: and be so many standard deviations from neutral, all that small errors may do included
MIN_SIGMAS = 1.0
#: a small error that is larger than so many of its spreads, by so many of its standard deviations, is none
LARGEST_SMALL, SIGNIFICANT_SIGMAS = 2.0, 2.0
#: a delay is far from linear: its fit starts from the best of these
DELAY_STARTS_S = (0.0, 0.06, 0.12, 0.2, 0.3, 0.4)
#: sets whose values are fitted by the model, and how far they may be behind along straight lines
MAX_FITTED, SHORTLISTED = 10, 15.0
#: noise and correlation follow from the best set, and the best set from them: so many rounds settle that
_ROUNDS = 3
#: a regressor of which small errors and nuisances leave less than this share cannot be seen
_VISIBLE = 1e-6


@dataclass
class _Offers:
    """The candidates that may be chosen, with their whitened regressors (n,)."""

    candidates: list[Candidate] = field(default_factory=list)
    columns: list[FloatColumn] = field(default_factory=list)

    @property
    def effects(self) -> int:
        """Return how many effects they are, each in one form or more."""
        return len({c.family for c in self.candidates})


class Search(JointFit):
    """A joint fit that chooses by itself what is in it.

    rivals: sets of effects that the data does not separate from the best one, best first. usual_delay: a
    delay of the torque that is no finding, where nothing else was found; None without one. evident: whether
    the data supports some set of effects beyond what small errors do, be it one that could not be taken.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.rivals: list[FittedSet] = []
        self.usual_delay: Chosen | None = None
        self.evident = False

    def all_hidden(self, tried: Sequence[Tried]) -> bool:
        """Return whether some effect would remove a share, and the best of them too little to be noticed."""
        best = max((t.explained for t in tried if not t.candidate.confounded), default=0.0)
        return best >= MIN_SHARE and not self.matters(best * float((self.first_whitened**2).sum()))

    def run(self) -> None:
        """Choose what is decisive, large enough to matter out of sample, and as common as it can be.

        The reporting delay is always in the fit: every engine controller has some, and what is left of
        it would pass for slip or inertia. It stays only when it removes something.
        """
        delay = [c for c in self.candidates if c.is_delay]
        self.prior = Prior(self.small_errors(), self.problem.rows / self.problem.chunks)
        self.chosen = [Chosen(c, self._best_start(c)) for c in delay]
        self.refit()
        residual, columns = self.current()
        offers, evidence, sets = self._linear_sets(residual, columns)
        fitted = [self._fitted(s, offers, evidence) for s in self._shortlist(sets, offers)]
        taken = commonest(fitted)
        self.chosen = [*self.chosen, *(Chosen(c.candidate, c.deviation) for c in taken.chosen)]
        self.refit()
        self._leave_out_errors_not_shown()
        self._add_errors_that_are_not_small()
        best = min(f.criterion for f in fitted)
        self.rivals = sorted((f for f in fitted if f.criterion <= best + DECISIVE), key=lambda f: f.criterion)
        self._prune()
        widen_by_rivals(self.chosen, self.rivals, best)
        self._leave_out_a_usual_delay()

    def without_choice(self) -> Search:
        """Return the same search with nothing selected."""
        bare = super().without_choice()
        bare.rivals = []
        return bare

    def _linear_sets(
        self, residual: FloatColumn, delay: list[FloatColumn]
    ) -> tuple[_Offers, Evidence, list[ScoredSet]]:
        """Return what may be chosen, and its sets along straight lines, best first, without idle members."""
        errors = self.small_errors()
        nuisance = self.problem.beside_nuisance(delay)
        noise, inflation = 1.0, 1.0
        for _ in range(_ROUNDS):
            evidence = Evidence(errors, nuisance, noise, inflation)
            offers = self._visible(evidence)
            sets = likely_sets(evidence, residual, offers.candidates, offers.columns)
            best = sets[0]
            left = residual + sum(
                offers.columns[m] * v for m, v in zip(best.members, best.values, strict=True)
            )
            left = evidence.remainder(left)
            noise, inflation = (
                max(float(left @ left) / len(left), 1e-12),
                inflation_of(left, self.problem.chunk),
            )
        self.prior = Prior(errors, evidence.noise)
        return offers, evidence, without_idle_members(sets, evidence.observations)

    def _visible(self, evidence: Evidence) -> _Offers:
        offers = _Offers()
        for c, column in self.offered:
            if c.confounded or c.is_delay or not column.any():
                continue
            one = column[:, None]
            if float(evidence.products(one, one)[0, 0]) > _VISIBLE * float(column @ column):
                offers.candidates.append(c)
                offers.columns.append(column)
        return offers

    def _shortlist(self, sets: list[ScoredSet], offers: _Offers) -> list[ScoredSet]:
        """Return the sets worth fitting: one of each combination of names, those that may be taken first."""
        best = sets[0].criterion
        by_price = sorted(sets, key=lambda s: s.criterion + price_of(len(s.members), offers.effects))
        short: list[ScoredSet] = []
        seen: set[tuple[str, ...]] = set()
        for s in [*by_price[:4], *(s for s in sets if s.criterion < best + SHORTLISTED)]:
            names = tuple(sorted(offers.candidates[m].effect for m in s.members))
            if names not in seen and len(short) < MAX_FITTED:
                seen.add(names)
                short.append(s)
        return short

    def _fitted(self, s: ScoredSet, offers: _Offers, evidence: Evidence) -> FittedSet:
        """Fit the values of a set by the model itself, the delay as it is."""
        delay = [*self.base, *(c.effect() for c in self.chosen)]
        members = zip(s.members, s.values, strict=True)
        chosen = [Chosen(offers.candidates[m], value) for m, value in members]
        residual_N = refine(self.problem, delay, chosen, self.prior)
        columns = regressors(self.problem, delay, chosen, residual_N)
        values, scales = [c.deviation for c in chosen], [c.candidate.scale for c in chosen]
        criterion = evidence.of(self.problem.whiten(residual_N), columns, values, scales) + s.forms
        price = criterion + price_of(len(chosen), offers.effects)
        return FittedSet(chosen, criterion, price)

    def _leave_out_errors_not_shown(self) -> None:
        """Fit the values again beside those small errors of the vehicle only that this data shows.

        The reference's errors stay: how large they are is known from its own data.
        """
        assert self.prior is not None
        residual, columns = self.current()
        errors, noise = self.prior.errors, self.prior.noise
        of_vehicle = sum(c.label in self._spread for c, _ in self.offered)
        kept = np.arange(errors.shape[1]) >= of_vehicle
        shown = errors_shown(errors, residual, self.problem.beside_nuisance(columns), noise, kept)
        if not shown.all():
            self.prior = Prior(errors[:, shown], noise)
            self.refit()

    def _add_errors_that_are_not_small(self) -> None:
        """Take as an effect what would be a small error, were it not larger than vehicles usually have.

        A wind of 5 m/s beside a dragging brake is no remainder.
        """
        assert self.prior is not None
        residual, columns = self.current()
        own = [c for c, _ in self.offered if c.label in self._spread]
        free = self.problem.beside_nuisance(columns)
        size, std = likeliest_errors(self.small_errors(), residual, free, self.prior.noise)
        added = [
            Chosen(c, value * self._spread[c.label])
            for c, value, uncertain in zip(own, size.tolist(), std.tolist(), strict=False)
            if abs(value) - SIGNIFICANT_SIGMAS * uncertain > LARGEST_SMALL
            and not c.confounded
            and not any(c.repeats(o.candidate) for o in self.chosen)
            and c.possible(value * self._spread[c.label])
        ]
        if added:
            self.chosen += added
            self.refit()

    def _leave_out_a_usual_delay(self) -> None:
        """Choose nothing where all that was found is that torque is reported as late as engines report it.

        The residual stays the one beside this delay: what is left of it is judged, and not the delay.
        """
        if len(self.chosen) == 1 and self.chosen[0].candidate.is_delay:
            (delay,) = self.chosen
            if delay.deviation - delay.std <= USUAL_DELAY_S:
                self.usual_delay, self.chosen = delay, []

    def _best_start(self, c: Candidate) -> float:
        """Return the deviation, of those that a fit may start from, that leaves the smallest residual.

        Small errors may take their part of it, as may a constant: neither is evidence of a delay.
        """
        assert self.prior is not None
        everything = np.ones(self.problem.rows, np.bool_)
        likely = self.prior.beside(everything)
        free = likely(self.problem.beside_nuisance([self.problem.whiten(np.ones(self.problem.rows))]))
        left = []
        for deviation in DELAY_STARTS_S:
            residual_N = self.problem.residual_N([*self.base, c.make(deviation)])
            seen = likely(self.problem.whiten(residual_N))
            left.append(float((solve(seen, free, self.problem.chunk).left ** 2).sum()))
        return DELAY_STARTS_S[int(np.argmin(left))]

    def _prune(self) -> None:
        """Drop what removes nothing that matters out of sample, then rank the rest by what they shift.

        What is dropped was evident all the same, unless it is too small to notice, or small errors and the
        rounding of torque make it: of the actual one and of friction, half a step each.
        """
        while self.chosen:
            self.weigh()
            outside = [c for c in self.chosen if not self._stands_out(c)]
            weakest = outside[0] if outside else min(self.chosen, key=lambda c: c.needed)
            if not outside and weakest.needed >= MIN_SHARE:
                break
            self.chosen.remove(weakest)
            real = self._beyond_small_errors(weakest) or weakest.force_N > self.problem.torque_step_N
            self.evident |= real and weakest.needed > 0.0 and not weakest.candidate.is_delay
            self.refit()
        self.evident |= any(not c.candidate.is_delay for c in self.chosen)
        self.chosen.sort(key=lambda c: -c.shifts)

    def _stands_out(self, c: Chosen) -> bool:
        """Return whether a value is one that a vehicle can have, and small errors alone would not make."""
        return c.candidate.possible(c.deviation) and self._beyond_small_errors(c)

    def _beyond_small_errors(self, c: Chosen) -> bool:
        # a delay there always is, however uncertain; but one below what can be resolved is none
        least = TICK_STD_S if c.candidate.is_delay else MIN_SIGMAS * c.std
        return abs(c.deviation) > least
