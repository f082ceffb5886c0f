"""Forward selection by what an effect removes on windows that were not used to fit it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from copy import copy

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S
from canest.diagnosis.data.least_squares import Matrix, solve
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen, Tried
from canest.diagnosis.search.equivalence import Alternatives, as_good
from canest.diagnosis.search.gauss_newton import refine, regressors
from canest.diagnosis.search.small_errors import usual_spread, variance_beside
from canest.vehicle.effects import Effect

#: an effect must be this many of its own (chunk-robust) standard deviations away from neutral, and more
#: where the mass is free to take its part
MIN_SIGMAS, MIN_SIGMAS_FREE_MASS = 4.0, 6.0
#: and remove this share of what is left of the held-out variance
MIN_SHARE = 0.03
#: and remove something that matters: so much residual, as share of the weight (2e-4 is a slope of 0.02 %),
#: and no less than the rounding of the reported torque and friction, half a step
MIN_WEIGHT_SHARE, MIN_TORQUE_STEPS = 2e-4, 0.5
#: windows averaged for the shares: what is gone within seconds shifts neither mass nor grade
SHARE_WINDOWS = 4
MAX_EFFECTS = 5
#: samples are held from tick to tick (20 ms): no delay is known more finely
TICK_STD_S = STEP_S / 12**0.5
#: a step of an effect that moves no window by this share of the weight moves nothing but rounding
ROUNDING = 1e-9
#: effects that there may be several of -> what tells them apart
SEVERAL_BY = {"driveline_loss": "gear", "switched_load": "signal", "payload_change": "t_s"}
#: a delay is far from linear: Gauss-Newton starts from the best of these
DELAY_STARTS_S = (0.0, 0.06, 0.12, 0.2, 0.3, 0.4)
#: what engine controllers usually take to report, and what is so much more that it may be something else
USUAL_DELAY_S, LONG_DELAY_S = 0.06, 0.12


class Search:
    """Carries what is chosen so far, and every candidate's regressor where nothing is."""

    def __init__(
        self,
        problem: Problem,
        base: Sequence[Effect],
        candidates: Sequence[Candidate],
        tick: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.problem, self.base, self.candidates = problem, list(base), list(candidates)
        self.chosen: list[Chosen] = []
        self._min_sigmas = MIN_SIGMAS if problem.mass_known else MIN_SIGMAS_FREE_MASS
        self._tick = tick
        self.first_residual_N = problem.residual_N(self.base)
        self._first = problem.whiten(self.first_residual_N)
        self._offered = [(c, self._regressor(c)) for c in self.candidates]
        self._spread = usual_spread(problem.parts[0].drive.config)
        self.alternatives = Alternatives(problem, self._offered, self._spread)
        self.residual_N = self.first_residual_N

    def _regressor(self, c: Candidate) -> FloatColumn:
        """Return the whitened change of the first residual per unit of a candidate's parameter."""
        self._tick(c.label)
        step = c.info.step
        moved_N = self.problem.residual_N([*self.base, c.make(step)]) - self.first_residual_N
        if np.abs(moved_N).max() < ROUNDING * self.problem.weight_N:
            moved_N[:] = 0.0  # nothing here depends on it (half-shaft torque knows no crank)
        return self.problem.whiten(moved_N / step)

    # -- selection ------------------------------------------------------------------------------------

    def alone(self) -> list[Tried]:
        """Return what each candidate would do alone, best first."""
        total = float(self._left(self._first, []).sum())
        tried = []
        for c, column in self._offered:
            if not column.any():
                continue
            fit = solve(self._first, self.problem.beside_nuisance([column]), self.problem.chunk)
            value = float(fit.values[0])
            # what no vehicle can be like explains nothing (a brake that pushes)
            left = float(self._left(self._first, [column]).sum()) if c.possible(value) else total
            beside = self._variance_beside(self._first, [column], {c.effect})[0]
            std = float(np.sqrt(fit.covariance[0, 0] + beside))
            tried.append(Tried(c, value, std, 1.0 - left / total))
        return sorted(tried, key=lambda t: -t.explained)

    def hidden_N(self) -> float:
        """Return how much residual (RMS) is too little to notice, or may be the torque's rounding."""
        problem = self.problem
        return max(MIN_WEIGHT_SHARE * problem.weight_N, MIN_TORQUE_STEPS * problem.torque_step_N)

    def all_hidden(self, tried: Sequence[Tried]) -> bool:
        """Return whether some effect would remove a share, and the best of them too little to be told."""
        best = max((t.explained for t in tried if not t.candidate.shadow), default=0.0)
        return best >= MIN_SHARE and not self._matters(best * float((self._first**2).sum()))

    def run(self) -> None:
        """Select until nothing more is significant, out of sample, and large enough to matter.

        The reporting delay is always in the fit: every engine controller has some, and what is left of
        it would pass for slip or inertia. It stays only when it is significant.
        """
        delay = [c for c in self.candidates if c.effect == "torque_delay"]
        self.chosen = [Chosen(c, self._best_start(c, DELAY_STARTS_S)) for c in delay]
        self.refit()
        self._add()
        if any(c.deviation > LONG_DELAY_S for c in self.chosen if c.candidate in delay):
            self._or_from([Chosen(c, USUAL_DELAY_S) for c in delay])
        loads = [c for c, column in self._offered if c.effect == "payload_change" and column.any()]
        if len(loads) > 1:
            self._or_from([Chosen(c, USUAL_DELAY_S) for c in delay], [Chosen(c, 0.0) for c in loads])

    def _or_from(self, start: list[Chosen], loads: Sequence[Chosen] = ()) -> None:
        """Select anew from another start, where nothing is fitted yet; what leaves less out of sample stays.

        A delay that takes all it can passes for slip and inertia too, and then leaves them nothing. A load
        that comes and goes looks like no single change of it, but like a loss of torque.
        """
        first, left = (self.chosen, self.residual_N), self._left(*self._now())
        self.chosen = [*start, *loads]
        if loads:
            self.refit()
            self._prune()
        else:
            self.residual_N = self.problem.residual_N([*self.base, *(c.effect() for c in start)])
        self._add()
        if as_good(left, self._left(*self._now()), self.problem.chunk):
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
            left, mine = self._left(*self._now()), self.chosen[place].candidate
            taken = {c.candidate.effect for c in self.chosen}
            for c in self.chosen[place].equivalent:
                if c.rank >= mine.rank or c.shadow or c.effect in taken:
                    continue
                self.chosen = [Chosen(o.candidate, o.deviation) for o in now[0]]
                self.chosen[place] = Chosen(c, 0.0)
                self.refit()
                possible = c.possible(self.chosen[place].deviation)
                if possible and as_good(self._left(*self._now()), left, self.problem.chunk):
                    self._weigh()
                    break
                self.chosen, self.residual_N = now

    def without_choice(self) -> Search:
        """Return the same search with nothing selected."""
        bare = copy(self)
        bare.chosen, bare.residual_N = [], self.first_residual_N
        return bare

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
        residual, columns = self._now()
        total = self._left(residual, columns).sum()
        options: list[tuple[float, Candidate, FloatColumn]] = []
        for c, column in self._offered:
            if c.shadow or self._excluded(c) or not column.any():
                continue
            left = self._left(residual, [*columns, column])
            share = 1.0 - left.sum() / total
            if share < MIN_SHARE:
                continue
            fit = solve(residual, self.problem.beside_nuisance([*columns, column]), self.problem.chunk)
            at = len(columns)
            value, std = fit.values[at], np.sqrt(fit.covariance[at, at])
            if abs(value) < self._min_sigmas * std or not self._matters(total - left.sum()):
                continue
            if not c.possible(value):
                continue  # it fits, but no vehicle is like that
            options.append((float(share), c, left))
        if not options:
            return None
        options.sort(key=lambda o: -o[0])
        return self._most_plausible(options)

    def _most_plausible(self, options: list[tuple[float, Candidate, FloatColumn]]) -> Candidate:
        """Return, of the options as good as the best one, the commonest."""
        _, best, best_left = options[0]
        for _, c, left in options[1:]:
            if c.rank < best.rank and as_good(left, best_left, self.problem.chunk):
                best, best_left = c, left
        return best

    def _matters(self, removed: float) -> bool:
        """Return whether a drop of the squared held-out residual is large enough to notice."""
        rms_N = np.sqrt(max(removed, 0.0) / self.problem.rows) * self.problem.unit_N
        return bool(rms_N > self.hidden_N())

    def _excluded(self, c: Candidate) -> bool:
        """Return whether a candidate would say again what is chosen already."""
        for chosen in self.chosen:
            if chosen.candidate.effect != c.effect:
                continue
            key = SEVERAL_BY.get(c.effect, "")
            mine, theirs = dict(c.shape).get(key), dict(chosen.candidate.shape).get(key)
            if mine is None or theirs is None or mine == theirs:
                return True
        return False

    # -- pruning --------------------------------------------------------------------------------------

    def _prune(self) -> None:
        """Drop what a later choice has made superfluous, then rank the rest by what they shift."""
        while self.chosen:
            self._weigh()
            weakest = min(self.chosen, key=Chosen.sigmas)
            if weakest.sigmas() >= self._min_sigmas:
                weakest = min(self.chosen, key=lambda c: c.needed)
                if weakest.needed >= MIN_SHARE:
                    break
            self.chosen.remove(weakest)
            self.refit()
        self.chosen.sort(key=lambda c: -c.shifts)

    def _weigh(self) -> None:
        """Set what each choice explains, whether the others miss it, and its equivalents."""
        residual, columns = self._now()
        self._widen(residual, columns)
        left = self.problem.held_out(residual, columns)
        first = self.problem.held_out(self._first, [])
        total, slow_total = float((first**2).sum()), self._slow_sum(first)
        for i, chosen in enumerate(self.chosen):
            others = [c for j, c in enumerate(columns) if j != i]
            rest = [c.effect() for c in self.chosen if c is not chosen]
            without = self.problem.whiten(self.problem.residual_N([*self.base, *rest]))
            missed = self.problem.held_out(without, others)
            missed_sum = float((missed**2).sum())
            more = missed_sum - float((left**2).sum())
            chosen.explained = more / total
            chosen.shifts = (self._slow_sum(missed) - self._slow_sum(left)) / slow_total
            # a delay there always is: left out because it is small, it would be put down to the others
            matters = chosen.candidate.effect == "torque_delay" or self._matters(more)
            chosen.needed = more / missed_sum if matters else 0.0
            chosen.equivalent = self.alternatives.instead_of(
                chosen.candidate, columns[i], residual, without, others, left**2, missed_sum
            )

    def _slow_sum(self, left: FloatColumn) -> float:
        """Return the squared sum of a residual averaged over a few windows."""
        chunk = self.problem.chunk
        place = np.arange(len(chunk)) - np.searchsorted(chunk, chunk)
        group = np.unique(chunk * 1000 + place // SHARE_WINDOWS, return_inverse=True)[1]
        means = np.bincount(group, weights=left) / np.bincount(group)
        return float((means[group] ** 2).sum())

    def widen(self) -> None:
        """Add to every choice's standard deviation what the small errors of every vehicle do to its value."""
        self._widen(*self._now())

    def _widen(self, residual: FloatColumn, columns: list[FloatColumn]) -> None:
        beside = self._variance_beside(residual, columns, {c.candidate.effect for c in self.chosen})
        for c, variance in zip(self.chosen, beside.tolist(), strict=False):
            finest = TICK_STD_S if c.candidate.effect == "torque_delay" else 0.0
            c.std = float(np.sqrt(c.scatter**2 + variance + finest**2))

    def _variance_beside(
        self, residual: FloatColumn, columns: list[FloatColumn], known: Collection[str]
    ) -> FloatColumn:
        """Return what small errors other than the known effects add to the fitted values' variance."""
        small = {c.effect: x for c, x in self._offered if c.label in self._spread and c.effect not in known}
        matrix = self.problem.beside_nuisance(columns)
        return variance_beside(residual, matrix, self.problem.chunk, small, self._spread)

    # -- the fit as it stands -------------------------------------------------------------------------

    def refit(self) -> None:
        """Fit all chosen parameters together, from where they are."""
        self.residual_N = refine(self.problem, self.base, self.chosen)

    def _now(self) -> tuple[FloatColumn, list[FloatColumn]]:
        """Return the residual at the present values and the chosen effects' regressors there."""
        columns = regressors(self.problem, self.base, self.chosen, self.residual_N)
        return self.problem.whiten(self.residual_N), columns

    def _left(self, residual: FloatColumn, columns: list[FloatColumn]) -> FloatColumn:
        """Return the squared held-out residual of every window (n,)."""
        return np.asarray(self.problem.held_out(residual, columns) ** 2)

    def local_matrix(self) -> Matrix:
        """Return the chosen effects' regressors at their values, and the nuisances."""
        return self.problem.beside_nuisance(self._now()[1])

    def held_out_variance(self, *, after: bool) -> float:
        """Return the mean square of the held-out residual (whitened units)."""
        residual, columns = self._now() if after else (self._first, [])
        return float(self._left(residual, columns).mean())
