"""Forward selection by what an effect removes on windows that were not used to fit it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from canest.diagnose.candidates import Candidate
from canest.diagnose.fit import Matrix, chunk_sums, held_out, solve
from canest.diagnose.problem import Problem
from canest.frames import FloatColumn
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
#: an alternative is equivalent while the held-out difference is below this many standard errors
EQUIVALENT_SIGMAS = 2.0
#: and below this share of what is left
EQUIVALENT_SHARE = 0.1
#: or while it says nearly all that the chosen one says: what it misses is below this share of it
EQUIVALENT_MISS = 0.05
#: or while its regressor is the chosen one's mirror image up to this correlation
EQUIVALENT_CORRELATION = 0.998
MAX_EFFECTS = 5
GAUSS_NEWTON_STEPS = 6
#: a delay is far from linear: Gauss-Newton starts from the best of these
DELAY_STARTS_S = (0.0, 0.06, 0.12, 0.2, 0.3, 0.4)


@dataclass
class Chosen:
    """A selected candidate with its fitted deviation from neutral and standard deviation.

    explained: share of the first residual's held-out variance that comes back without it. needed: share
    of what is then left that it removes. equivalent: candidates that would do as well in its place.
    """

    candidate: Candidate
    deviation: float
    std: float = 0.0
    explained: float = 0.0
    needed: float = 0.0
    equivalent: list[Candidate] = field(default_factory=list)

    def sigmas(self) -> float:
        """Return how many standard deviations it is from neutral; 0 at a bound, where nothing is fitted."""
        info = self.candidate.info
        value = info.neutral + self.deviation
        inside = info.low < value < info.high
        return abs(self.deviation) / max(self.std, 1e-30) if inside else 0.0

    def effect(self) -> Effect:
        """Build the effect at its fitted value."""
        return self.candidate.make(self.deviation)


@dataclass(frozen=True)
class Tried:
    """What one candidate alone would do: deviation, std, share of held-out variance removed."""

    candidate: Candidate
    deviation: float
    std: float
    explained: float


class Search:
    """Carries the selection and the regressors at the present linearisation."""

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
        self._columns = {c.label: self._regressor(c, [], self.first_residual_N) for c in self.candidates}
        self.residual_N = self.first_residual_N

    # -- regressors -----------------------------------------------------------------------------------

    def effects(self) -> list[Effect]:
        """Return base and chosen effects."""
        return [*self.base, *(c.effect() for c in self.chosen)]

    def _regressor(self, c: Candidate, with_: Sequence[Effect], residual_N: FloatColumn) -> FloatColumn:
        """Return the whitened change of the residual per unit of a candidate's parameter."""
        self._tick(c.label)
        step = c.info.step
        return self.problem.whiten(
            (self.problem.residual_N([*self.base, *with_, c.make(step)]) - residual_N) / step
        )

    def _matrix(self, columns: Sequence[FloatColumn]) -> Matrix:
        return np.column_stack([*columns, self.problem.nuisance])

    # -- selection ------------------------------------------------------------------------------------

    def alone(self) -> list[Tried]:
        """Return what each candidate would do alone, best first."""
        chunk, total = self.problem.chunk, self._held_out_sum(self._first, [])
        tried = []
        for c in self.candidates:
            column = self._columns[c.label]
            if not column.any():
                continue
            fit = solve(self._first, self._matrix([column]), chunk)
            left = self._held_out_sum(self._first, [column])
            tried.append(
                Tried(c, float(fit.values[0]), float(np.sqrt(fit.covariance[0, 0])), 1.0 - left / total)
            )
        return sorted(tried, key=lambda t: -t.explained)

    def run(self) -> None:
        """Select until nothing more is significant, out of sample, and large enough to matter.

        The reporting delay is always in the fit: every engine controller has some, and what is left of
        it would pass for slip or inertia. It stays only when it is significant.
        """
        delay = [c for c in self.candidates if c.effect == "torque_delay"]
        self.chosen = [Chosen(c, self._best_start(c, DELAY_STARTS_S)) for c in delay]
        self.refit()
        while len(self.chosen) < MAX_EFFECTS:
            best = self._best_addition()
            if best is None:
                break
            self.chosen.append(Chosen(best, 0.0))
            self.refit()
        self._prune()

    def without_choice(self) -> Search:
        """Return the same search with nothing selected."""
        bare = copy(self)
        bare.chosen, bare.residual_N = [], self.first_residual_N
        return bare

    def _left(self, residual: FloatColumn, columns: list[FloatColumn]) -> FloatColumn:
        """Return the squared held-out residual of every window (n,)."""
        return np.asarray(held_out(residual, self._matrix(columns), self.problem.chunk) ** 2)

    def _best_start(self, c: Candidate, deviations: Sequence[float]) -> float:
        """Return the deviation, of those given, that leaves the smallest residual."""
        left = []
        for deviation in deviations:
            residual_N = self.problem.residual_N([*self.base, c.make(deviation)])
            whitened = self.problem.whiten(residual_N)
            # a constant (or a mass) that is wrong besides does not say anything about a delay
            free = np.column_stack([self.problem.whiten(np.ones(self.problem.rows)), self.problem.nuisance])
            left.append(float((solve(whitened, free, self.problem.chunk).left ** 2).sum()))
        return deviations[int(np.argmin(left))]

    def _best_addition(self) -> Candidate | None:
        residual, columns = self._now()
        chunk = self.problem.chunk
        before = self._left(residual, columns)
        total = before.sum()
        options: list[tuple[float, Candidate, FloatColumn]] = []
        for c in self.candidates:
            if c.shadow or self._excluded(c):
                continue
            column = self._columns[c.label]
            if not column.any():
                continue
            matrix = self._matrix([*columns, column])
            left = self._left(residual, [*columns, column])
            share = 1.0 - left.sum() / total
            if share < MIN_SHARE:
                continue
            fit = solve(residual, matrix, chunk)
            at = len(columns)
            value, std = fit.values[at], np.sqrt(fit.covariance[at, at])
            if abs(value) < self._min_sigmas * std or not self._matters(total - left.sum()):
                continue
            if not c.info.low < c.info.neutral + value < c.info.high:
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
            if c.rank < best.rank and self._as_good(left, best_left):
                best, best_left = c, left
        return best

    def _as_good(self, left: FloatColumn, best_left: FloatColumn) -> bool:
        worse = chunk_sums(left - best_left, self.problem.chunk)
        standard_error = np.sqrt(len(worse)) * worse.std(ddof=1) if len(worse) > 1 else np.inf
        return bool(
            worse.sum() <= EQUIVALENT_SIGMAS * standard_error and worse.sum() < 0.05 * best_left.sum()
        )

    def _matters(self, removed: float) -> bool:
        """Return whether a drop of the squared held-out residual is large enough to notice."""
        rms_N = np.sqrt(max(removed, 0.0) / self.problem.rows) * self.problem.unit_N
        least_N = max(MIN_WEIGHT_SHARE * self.problem.weight_N, MIN_TORQUE_STEPS * self.problem.torque_step_N)
        return bool(rms_N > least_N)

    def _excluded(self, c: Candidate) -> bool:
        """Return whether a candidate would say again what is chosen already."""
        for chosen in self.chosen:
            mine, theirs = dict(c.shape), dict(chosen.candidate.shape)
            if chosen.candidate.effect != c.effect:
                continue
            several = (c.effect == "driveline_loss" and "gear" in mine and "gear" in theirs) or (
                c.effect == "switched_load" and mine["signal"] != theirs["signal"]
            )
            if c.label == chosen.candidate.label or not several:
                return True
        return False

    # -- refinement -----------------------------------------------------------------------------------

    def _now(self) -> tuple[FloatColumn, list[FloatColumn]]:
        """Return the residual at the present values and the chosen effects' regressors there."""
        return self.problem.whiten(self.residual_N), [self._local(c) for c in self.chosen]

    def _local(self, chosen: Chosen) -> FloatColumn:
        others = [c.effect() for c in self.chosen if c is not chosen]
        step = chosen.candidate.info.step
        moved = [*self.base, *others, chosen.candidate.make(chosen.deviation + step)]
        return self.problem.whiten((self.problem.residual_N(moved) - self.residual_N) / step)

    def refit(self) -> None:
        """Gauss-Newton on all chosen parameters together (a delay or a wind is not linear)."""
        for _ in range(GAUSS_NEWTON_STEPS):
            self.residual_N = self.problem.residual_N(self.effects())
            residual, columns = self._now()
            fit = solve(residual, self._matrix(columns), self.problem.chunk)
            small = True
            for i, chosen in enumerate(self.chosen):
                change = float(fit.values[i])
                info = chosen.candidate.info
                bounded = np.clip(info.neutral + chosen.deviation + change, info.low, info.high)
                chosen.deviation = float(bounded - info.neutral)
                chosen.std = float(np.sqrt(fit.covariance[i, i]))
                small &= abs(change) < 0.05 * chosen.std
            if small:
                break
        self.residual_N = self.problem.residual_N(self.effects())

    def _prune(self) -> None:
        """Drop what a later choice has made superfluous, then rank the rest by what they explain."""
        while self.chosen:
            self._weigh()
            weakest = min(self.chosen, key=Chosen.sigmas)
            if weakest.sigmas() >= self._min_sigmas:
                weakest = min(self.chosen, key=lambda c: c.needed)
                if weakest.needed >= MIN_SHARE:
                    break
            self.chosen.remove(weakest)
            self.refit()
        self.chosen.sort(key=lambda c: -c.explained)

    def _weigh(self) -> None:
        """Set what each choice explains, whether the others miss it, and its equivalents."""
        residual, columns = self._now()
        left = held_out(residual, self._matrix(columns), self.problem.chunk)
        first = held_out(self._first, self._matrix([]), self.problem.chunk)
        total = self._slow_sum(first)
        for i, chosen in enumerate(self.chosen):
            others = [c for j, c in enumerate(columns) if j != i]
            rest = [c.effect() for c in self.chosen if c is not chosen]
            without = self.problem.whiten(self.problem.residual_N([*self.base, *rest]))
            missed = held_out(without, self._matrix(others), self.problem.chunk)
            chosen.explained = float((self._slow_sum(missed) - self._slow_sum(left)) / total)
            more = float((missed**2).sum() - (left**2).sum())
            chosen.needed = more / float((missed**2).sum()) if self._matters(more) else 0.0
            chosen.equivalent = self._equivalents(i, without, others, residual, columns)

    def _slow_sum(self, left: FloatColumn) -> float:
        """Return the squared sum of a residual averaged over a few windows."""
        chunk = self.problem.chunk
        place = np.arange(len(chunk)) - np.searchsorted(chunk, chunk)
        group = np.unique(chunk * 1000 + place // SHARE_WINDOWS, return_inverse=True)[1]
        means = np.bincount(group, weights=left) / np.bincount(group)
        return float((means[group] ** 2).sum())

    def _equivalents(
        self,
        at: int,
        without: FloatColumn,
        others: list[FloatColumn],
        residual: FloatColumn,
        columns: list[FloatColumn],
    ) -> list[Candidate]:
        """Return the candidates that do as well in the place of the chosen one."""
        best_left = self._left(residual, columns)
        best, missed = float(best_left.sum()), self._held_out_sum(without, others)
        mine = self._rest(columns[at], others)
        found = []
        for c in self.candidates:
            column = self._columns[c.label]
            if c.label == self.chosen[at].candidate.label or not column.any():
                continue
            left = self._left(without, [*others, column])
            theirs = self._rest(column, others)
            alike = abs(mine @ theirs) > EQUIVALENT_CORRELATION * np.sqrt((mine @ mine) * (theirs @ theirs))
            worse = float(left.sum()) - best
            nearly = worse < min(EQUIVALENT_SHARE * best, EQUIVALENT_MISS * (missed - best))
            if alike or nearly or self._as_good(left, best_left):
                found.append(c)
        return sorted(found, key=lambda c: c.rank)

    def _rest(self, column: FloatColumn, others: list[FloatColumn]) -> FloatColumn:
        """Return what of a column the others (and the nuisances) cannot say."""
        matrix = self._matrix(others)
        if not matrix.shape[1]:
            return column
        p, *_ = np.linalg.lstsq(matrix, column, rcond=1e-8)
        return np.asarray(column - matrix @ p)

    def _held_out_sum(self, residual: FloatColumn, columns: list[FloatColumn]) -> float:
        return float(self._left(residual, columns).sum())

    def alike(self, c: Candidate) -> list[Candidate]:
        """Return the candidates whose regressors this data cannot tell from this one's."""
        mine = self._rest(self._columns[c.label], [])
        found = []
        for other in self.candidates:
            theirs = self._rest(self._columns[other.label], [])
            size = np.sqrt((mine @ mine) * (theirs @ theirs))
            if other.label != c.label and size > 0 and abs(mine @ theirs) > EQUIVALENT_CORRELATION * size:
                found.append(other)
        return sorted(found, key=lambda c: c.rank)

    def local_matrix(self) -> Matrix:
        """Return the chosen effects' regressors at their values, and the nuisances."""
        return self._matrix(self._now()[1])

    def fitted_on(self, rows: NDArray[np.bool_]) -> tuple[list[Effect], FloatColumn]:
        """Fit the chosen effects on these rows only.

        Returns base and refitted effects, and the force (n,) in N that a free mass takes out of the residual.
        """
        problem, mine = self.problem, [Chosen(c.candidate, c.deviation) for c in self.chosen]
        chunk = np.unique(problem.chunk[rows], return_inverse=True)[1]
        values = np.zeros(problem.nuisance.shape[1])
        for _ in range(GAUSS_NEWTON_STEPS if mine else 1):
            here = [*self.base, *(c.effect() for c in mine)]
            residual_N = problem.residual_N(here)
            columns = []
            for c in mine:
                others = [o.effect() for o in mine if o is not c]
                moved = [*self.base, *others, c.candidate.make(c.deviation + c.candidate.info.step)]
                columns.append(
                    problem.whiten((problem.residual_N(moved) - residual_N) / c.candidate.info.step)
                )
            matrix = self._matrix(columns)
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
        return [*self.base, *(c.effect() for c in mine)], taken

    def held_out_rms(self, *, after: bool) -> tuple[float, float]:
        """Return the held-out residual's RMS (whitened units) and its standard error by chunk bootstrap."""
        residual, columns = self._now() if after else (self._first, [])
        left = self._left(residual, columns)
        sums = chunk_sums(left, self.problem.chunk)
        counts = chunk_sums(np.ones(len(left)), self.problem.chunk)
        draw = np.random.default_rng(0).integers(0, len(sums), (400, len(sums)))
        resampled = np.sqrt(sums[draw].sum(axis=1) / counts[draw].sum(axis=1))
        return float(np.sqrt(left.mean())), float(resampled.std())
