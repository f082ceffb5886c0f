"""The chosen effects fitted together, and what each of them is worth."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from copy import copy
from typing import Self

import numpy as np

from canest.core.errors import PluginError
from canest.core.frames import BoolColumn, FloatColumn
from canest.core.samples import STEP_S
from canest.diagnosis.data.least_squares import Matrix, solve
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen, Tried
from canest.diagnosis.search.equivalence import Alternatives
from canest.diagnosis.search.evidence import likeliest_errors
from canest.diagnosis.search.small_errors import usual_spread, variance_beside
from canest.diagnosis.search.value_fit import Prior, fit_on, refine, regressors
from canest.vehicle.effects import Effect

#: an effect must remove something that matters: so much residual, as share of the weight (2e-4 is a slope of
#: 0.02 %), and no less than the rounding of the reported torque and friction, half a step
MIN_WEIGHT_SHARE, MIN_TORQUE_STEPS = 2e-4, 0.5
#: windows averaged for the shares: what is gone within seconds shifts neither mass nor grade
SHARE_WINDOWS = 4
#: samples are held from tick to tick (20 ms): no delay is known more finely
TICK_STD_S = STEP_S / 12**0.5
#: a step of an effect that moves no window by this share of the weight moves nothing but rounding
ROUNDING = 1e-9


class JointFit:
    """Carries what is chosen so far with its values, and every candidate's regressor where nothing is."""

    def __init__(
        self,
        problem: Problem,
        base: Sequence[Effect],
        candidates: Sequence[Candidate],
        on_candidate: Callable[[str], None] = lambda _label: None,
    ) -> None:
        self.problem, self.base, self.candidates = problem, list(base), list(candidates)
        self.chosen: list[Chosen] = []
        self._on_candidate = on_candidate
        self.first_residual_N = problem.residual_N(self.base)
        self.first_whitened = problem.whiten(self.first_residual_N)
        self._spread = usual_spread(problem.parts[0].drive.config.vehicle, self.candidates)
        #: what the small errors of every vehicle do, in N per standard deviation (n,) each
        self.small_errors_N: dict[str, FloatColumn] = {}
        #: effects of other packages that fail: name -> how
        self.failed: dict[str, str] = {}
        self.offered = list(self._offer())
        self.candidates = [c for c in self.candidates if c.effect not in self.failed]
        self.alternatives = Alternatives(problem, self.offered, self._spread)
        self.residual_N = self.first_residual_N
        #: the small errors that may be beside the chosen effects; None until the noise is known
        self.prior: Prior | None = None

    def _offer(self) -> Iterator[tuple[Candidate, FloatColumn]]:
        for c in self.candidates:
            if c.effect in self.failed:
                continue
            try:
                yield c, self._regressor(c)
            except PluginError as error:
                self.failed[c.effect] = str(error)

    def _regressor(self, c: Candidate) -> FloatColumn:
        """Return the whitened change of the first residual per unit of a candidate's parameter."""
        self._on_candidate(c.label)
        step = c.info.step
        moved_N = self.problem.residual_N([*self.base, c.make(step)]) - self.first_residual_N
        if np.abs(moved_N).max() < ROUNDING * self.problem.weight_N:
            moved_N[:] = 0.0  # nothing here depends on it (half-shaft torque knows no crank)
        if c.label in self._spread:
            self.small_errors_N[c.label] = self._spread[c.label] * moved_N / step
        return self.problem.whiten(moved_N / step)

    def alone(self) -> list[Tried]:
        """Return what each candidate would do alone, best first."""
        total = float(self.held_out_squares(self.first_whitened, []).sum())
        tried = []
        for c, column in self.offered:
            if not column.any():
                continue
            fit = solve(self.first_whitened, self.problem.beside_nuisance([column]), self.problem.chunk)
            value = float(fit.values[0])
            # what no vehicle can be like explains nothing (a brake that pushes)
            left = (
                float(self.held_out_squares(self.first_whitened, [column]).sum())
                if c.possible(value)
                else total
            )
            beside = self._variance_beside(self.first_whitened, [column], {c.effect})[0]
            std = float(np.sqrt(fit.covariance[0, 0] + beside))
            tried.append(Tried(c, value, std, 1.0 - left / total))
        return sorted(tried, key=lambda t: -t.explained)

    def hidden_N(self) -> float:
        """Return how much residual (RMS) is too little to notice, or may be the torque's rounding."""
        problem = self.problem
        return max(MIN_WEIGHT_SHARE * problem.weight_N, MIN_TORQUE_STEPS * problem.torque_step_N)

    def matters(self, removed: float) -> bool:
        """Return whether a drop of the squared held-out residual is large enough to notice."""
        rms_N = np.sqrt(max(removed, 0.0) / self.problem.rows) * self.problem.unit_N
        return bool(rms_N > self.hidden_N())

    def without_choice(self) -> Self:
        """Return the same search with nothing selected."""
        bare = copy(self)
        bare.chosen, bare.residual_N = [], self.first_residual_N
        return bare

    def refit(self) -> None:
        """Fit all chosen parameters together, from where they are."""
        self.residual_N = refine(self.problem, self.base, self.chosen, self.prior)

    def fit_on(self, rows: BoolColumn) -> tuple[list[Effect], FloatColumn]:
        """Fit the chosen effects on these rows (n,) only; they themselves stay as they are.

        Returns base and refitted effects, and the force (n,) in N that a free mass takes out of the residual.
        """
        return fit_on(self.problem, self.base, self.chosen, rows, self.prior)

    def small_errors(self) -> Matrix:
        """Return the small errors of every vehicle and of the reference, whitened, per standard deviation."""
        small = [self._spread[c.label] * x for c, x in self.offered if c.label in self._spread]
        nothing = np.zeros((self.problem.rows, 0))
        return np.column_stack([nothing, *small, *self.problem.reference_errors().values()])

    def usual_errors_N(self) -> FloatColumn:
        """Return what small errors of vehicle and reference, and a free mass, add to the residual (n,), N.

        Each is at its likeliest beside what is chosen.
        """
        assert self.prior is not None
        residual, columns = self.current()
        problem = self.problem
        size, _ = likeliest_errors(
            self.small_errors(), residual, problem.beside_nuisance(columns), self.prior.noise
        )
        own = [self.small_errors_N[c.label] for c, _ in self.offered if c.label in self._spread]
        found = np.zeros(problem.rows)
        for value, column in zip(size.tolist(), (*own, *problem.reference_errors_N().values()), strict=True):
            found += value * column
        if problem.nuisance.shape[1]:
            left = residual + problem.whiten(found)
            found += problem.nuisance_N @ solve(left, problem.nuisance, problem.chunk).values
        return found

    def current(self) -> tuple[FloatColumn, list[FloatColumn]]:
        """Return the residual at the present values and the chosen effects' regressors there."""
        columns = regressors(self.problem, self.base, self.chosen, self.residual_N)
        return self.problem.whiten(self.residual_N), columns

    def held_out_squares(self, residual: FloatColumn, columns: list[FloatColumn]) -> FloatColumn:
        """Return the squared held-out residual of every window (n,)."""
        return np.asarray(self.problem.held_out(residual, columns) ** 2)

    def weigh(self) -> None:
        """Set what each choice explains, whether the others miss it, and its equivalents."""
        residual, columns = self.current()
        self._widen(residual, columns)
        left = self.problem.held_out(residual, columns)
        first = self.problem.held_out(self.first_whitened, [])
        total, slow_total = float((first**2).sum()), self._slow_sum(first)
        for i, chosen in enumerate(self.chosen):
            others = [c for j, c in enumerate(columns) if j != i]
            rest = [c.effect() for c in self.chosen if c is not chosen]
            without_N = self.problem.residual_N([*self.base, *rest])
            without = self.problem.whiten(without_N)
            missed = self.problem.held_out(without, others)
            missed_sum = float((missed**2).sum())
            more = missed_sum - float((left**2).sum())
            chosen.explained = more / total
            chosen.shifts = (self._slow_sum(missed) - self._slow_sum(left)) / slow_total
            # as a force, since a steady one is small once an uncertain grade is filtered out. A delay there
            # always is: left out because it is small, it would be put down to the others
            chosen.force_N = float(np.sqrt(np.mean((without_N - self.residual_N) ** 2)))
            matters = chosen.candidate.is_delay or chosen.force_N > self.hidden_N()
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
        self._widen(*self.current())

    def _widen(self, residual: FloatColumn, columns: list[FloatColumn]) -> None:
        beside = self._variance_beside(residual, columns, {c.candidate.effect for c in self.chosen})
        for c, variance in zip(self.chosen, beside.tolist(), strict=False):
            finest = TICK_STD_S if c.candidate.is_delay else 0.0
            c.std = float(np.sqrt(c.scatter**2 + variance + finest**2))

    def _variance_beside(
        self, residual: FloatColumn, columns: list[FloatColumn], known: Collection[str]
    ) -> FloatColumn:
        """Return what small errors other than the known effects add to the fitted values' variance."""
        small = {c.effect: x for c, x in self.offered if c.label in self._spread and c.effect not in known}
        matrix = self.problem.beside_nuisance(columns)
        return variance_beside(residual, matrix, self.problem.chunk, small, self._spread)

    def local_matrix(self) -> Matrix:
        """Return the chosen effects' regressors at their values, and the nuisances."""
        return self.problem.beside_nuisance(self.current()[1])

    def held_out_variance(self, *, after: bool) -> float:
        """Return the mean square of the held-out residual (whitened units)."""
        residual, columns = self.current() if after else (self.first_whitened, [])
        return float(self.held_out_squares(residual, columns).mean())
