"""The evidence for sets of effects: how well each explains the residual, for the number of its parameters.

A set's measure is the Bayesian information criterion,

    n log(left) + k log(n),

where `left` is what the set leaves of the squared residual, k how many effects it has, and n how many
independent observations there are. Seconds of one block of driving share their errors, so n is the number of
seconds over the inflation that their correlation causes. Two sets are told apart by the difference: 2 log of
the odds between them.

Every vehicle has small errors that nobody declares, and every reference has its own. They have a known spread
and are marginalised: each takes what it can of the residual, at the price of its prior. An effect within
what they may do is therefore no evidence for anything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from canest.core.frames import FloatColumn, IntColumn
from canest.diagnosis.data.least_squares import Matrix

#: sets whose criterion is this close to the best are not told apart by the data (odds of 20)
AS_LIKELY = 6.0
#: an effect is taken where the criterion is better by this with it (odds of 150: "very strong")
DECISIVE = 10.0
#: sets of each size that are extended by one more effect
BEAM = 40


@dataclass(frozen=True)
class ScoredSet:
    """A set of candidates, by their places in the offered list: its criterion (lower is better), its values."""

    members: tuple[int, ...]
    criterion: float
    values: tuple[float, ...]


class Evidence:
    """Scores sets of effects on the windows of one problem.

    errors: whitened columns (n, e) of the small errors, per standard deviation. nuisance: (n, m), always
    free. chunk: block of each window.
    """

    def __init__(self, errors: Matrix, nuisance: Matrix, chunk: IntColumn, noise: float, inflation: float):
        self._errors, self._nuisance = errors, nuisance
        self.observations = max(len(chunk) / inflation, 2.0)
        self._prior = cho_factor(errors.T @ errors + noise * inflation * np.eye(errors.shape[1]))

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
        return left.T @ right - (left.T @ self._errors) @ cho_solve(self._prior, self._errors.T @ right)

    def criterion(self, left: float, parameters: int) -> float:
        """Return the criterion of what is left of the squared residual by so many parameters."""
        n = self.observations
        return float(n * np.log(max(left, 1e-12)) + parameters * np.log(n))

    def of(self, residual: FloatColumn, columns: Sequence[FloatColumn]) -> float:
        """Return the criterion of a set by its residual (n,) and its regressors (n,) at its values."""
        whole = np.column_stack([residual, *columns])
        products = self.products(whole, whole)
        left, _ = _left(products, tuple(range(1, whole.shape[1])))
        return self.criterion(left, len(columns))


def _left(products: Matrix, members: tuple[int, ...]) -> tuple[float, FloatColumn]:
    """Return what is left of column 0 beside the members, and their values."""
    if not members:
        return float(products[0, 0]), np.empty(0)
    places = list(members)
    wanted = products[places, 0]
    scale = np.sqrt(np.maximum(np.diag(products)[places], 1e-30))
    inverse = np.linalg.pinv(products[np.ix_(places, places)] / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    values = -(inverse @ (wanted / scale)) / scale
    return float(products[0, 0] + wanted @ values), values


def inflation_of(left: FloatColumn, chunk: IntColumn) -> float:
    """Return by how much the correlation of a residual (n,) within blocks inflates a variance, at least 1."""
    sums = np.bincount(chunk, weights=left)
    longest = float(np.bincount(chunk).max())
    return float(np.clip((sums**2).sum() / max(float(left @ left), 1e-30), 1.0, longest))
