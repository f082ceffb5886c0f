"""Forward selection by what an effect removes on windows that were not used to fit it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from canest.core.frames import FloatColumn
from canest.diagnosis.data.least_squares import solve
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen, Tried
from canest.diagnosis.search.equivalence import as_good
from canest.diagnosis.search.joint_fit import JointFit

#: an effect must be this many of its own (chunk-robust) standard deviations away from neutral, and more
#: where the mass is free to take its part
MIN_SIGMAS, MIN_SIGMAS_FREE_MASS = 4.0, 6.0
#: and remove this share of what is left of the held-out variance
MIN_SHARE = 0.03
MAX_EFFECTS = 5
#: a delay is far from linear: Gauss-Newton starts from the best of these
DELAY_STARTS_S = (0.0, 0.06, 0.12, 0.2, 0.3, 0.4)
#: what engine controllers usually take to report, and what is so much more that it may be something else
USUAL_DELAY_S, LONG_DELAY_S = 0.06, 0.12


class Search(JointFit):
    """A joint fit that chooses by itself what is in it."""

    @property
    def _min_sigmas(self) -> float:
        return MIN_SIGMAS if self.problem.mass_known else MIN_SIGMAS_FREE_MASS

    def all_hidden(self, tried: Sequence[Tried]) -> bool:
        """Return whether some effect would remove a share, and the best of them too little to be noticed."""
        best = max((t.explained for t in tried if not t.candidate.confounded), default=0.0)
        return best >= MIN_SHARE and not self.matters(best * float((self.first_whitened**2).sum()))

    def run(self) -> None:
        """Select until nothing more is significant, out of sample, and large enough to matter.

        The reporting delay is always in the fit: every engine controller has some, and what is left of
        it would pass for slip or inertia. It stays only when it is significant.
        """
        delay = [c for c in self.candidates if c.is_delay]
        self.chosen = [Chosen(c, self._best_start(c, DELAY_STARTS_S)) for c in delay]
        self.refit()
        self._add()
        if any(c.deviation > LONG_DELAY_S for c in self.chosen if c.candidate in delay):
            self._try_from([Chosen(c, USUAL_DELAY_S) for c in delay])
        loads = [c for c, column in self.offered if c.is_load and column.any()]
        if len(loads) > 1:
            self._try_from([Chosen(c, USUAL_DELAY_S) for c in delay], [Chosen(c, 0.0) for c in loads])

    def _try_from(self, start: list[Chosen], loads: Sequence[Chosen] = ()) -> None:
        """Select anew from another start, where nothing is fitted yet; what leaves less out of sample stays.

        A delay that takes all it can passes for slip and inertia too, and then leaves them nothing. A load
        that comes and goes looks like no single change of it, but like a loss of torque.
        """
        first, left = (self.chosen, self.residual_N), self.held_out_squares(*self.current())
        self.chosen = [*start, *loads]
        if loads:
            self.refit()
            self._prune()
        else:
            self.residual_N = self.problem.residual_N([*self.base, *(c.effect() for c in start)])
        self._add()
        if as_good(left, self.held_out_squares(*self.current()), self.problem.chunk):
            self.chosen, self.residual_N = first

    def _add(self) -> None:
        """Add the best effect until none is good enough, then drop what is superfluous."""
        while len(self.chosen) < MAX_EFFECTS:
            best = self._best_addition()
            if best is None:
                break
            self.chosen.append(Chosen(best, 0.0))
            self.refit()
        self._prune()
        self._exchange()

    def _exchange(self) -> None:
        """Put a commoner equivalent in the place of a choice where, fitted, it does as well.

        A choice was made between straight lines; a wind is none, and its neighbours are.
        """
        for place in range(len(self.chosen)):
            now = self.chosen, self.residual_N
            left, mine = self.held_out_squares(*self.current()), self.chosen[place].candidate
            taken = {c.candidate.effect for c in self.chosen}
            for c in self.chosen[place].equivalent:
                if c.rarity >= mine.rarity or c.confounded or c.effect in taken:
                    continue
                self.chosen = [Chosen(o.candidate, o.deviation) for o in now[0]]
                self.chosen[place] = Chosen(c, 0.0)
                self.refit()
                possible = c.possible(self.chosen[place].deviation)
                if possible and as_good(self.held_out_squares(*self.current()), left, self.problem.chunk):
                    self.weigh()
                    break
                self.chosen, self.residual_N = now

    def _best_start(self, c: Candidate, deviations: Sequence[float]) -> float:
        """Return the deviation, of those given, that leaves the smallest residual."""
        left = []
        for deviation in deviations:
            residual_N = self.problem.residual_N([*self.base, c.make(deviation)])
            whitened = self.problem.whiten(residual_N)
            # a constant (or a mass) that is wrong besides does not say anything about a delay
            free = self.problem.beside_nuisance([self.problem.whiten(np.ones(self.problem.rows))])
            left.append(float((solve(whitened, free, self.problem.chunk).left ** 2).sum()))
        return deviations[int(np.argmin(left))]

    def _best_addition(self) -> Candidate | None:
        """Return what removes most of what is left, None where nothing is significant and large enough."""
        residual, columns = self.current()
        total = self.held_out_squares(residual, columns).sum()
        options: list[tuple[float, Candidate, FloatColumn]] = []
        for c, column in self.offered:
            if c.confounded or any(c.repeats(o.candidate) for o in self.chosen) or not column.any():
                continue
            left = self.held_out_squares(residual, [*columns, column])
            share = 1.0 - left.sum() / total
            if share < MIN_SHARE:
                continue
            fit = solve(residual, self.problem.beside_nuisance([*columns, column]), self.problem.chunk)
            at = len(columns)
            value, std = fit.values[at], np.sqrt(fit.covariance[at, at])
            if abs(value) < self._min_sigmas * std or not self.matters(total - left.sum()):
                continue
            if not c.possible(value):
                continue  # it fits, but no vehicle is like that
            options.append((float(share), c, left))
        if not options:
            return None
        options.sort(key=lambda o: -o[0])
        return self._commonest(options)

    def _commonest(self, options: list[tuple[float, Candidate, FloatColumn]]) -> Candidate:
        """Return, of the options as good as the best one, the commonest."""
        _, best, best_left = options[0]
        for _, c, left in options[1:]:
            if c.rarity < best.rarity and as_good(left, best_left, self.problem.chunk):
                best, best_left = c, left
        return best

    def _prune(self) -> None:
        """Drop what a later choice has made superfluous, then rank the rest by what they shift."""
        while self.chosen:
            self.weigh()
            weakest = min(self.chosen, key=Chosen.sigmas)
            if weakest.sigmas() >= self._min_sigmas:
                weakest = min(self.chosen, key=lambda c: c.needed)
                if weakest.needed >= MIN_SHARE:
                    break
            self.chosen.remove(weakest)
            self.refit()
        self.chosen.sort(key=lambda c: -c.shifts)
