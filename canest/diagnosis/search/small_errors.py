"""What the small errors that every vehicle has may do to a value that was fitted without them.

An engine's torque is right within some per cent, some wind always blows, tyres roll as their temperature and
the surface will have it. Too small to be found each, together they move a fitted value by more than its
scatter between blocks of the drive counts, and it is they that make it another value on another day.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.diagnosis.data.least_squares import Matrix
from canest.diagnosis.search.candidates import Candidate


def usual_spread(vehicle: object, candidates: Iterable[Candidate]) -> dict[str, float]:
    """Return effect -> standard deviation among vehicles and days, for what every vehicle has a little of.

    vehicle: the config's, which declares what some are a share of. A factor on all traction is none where the
    mass is free: both together could scale every force to nothing, and with it the residual.
    """
    spreads = {c.effect: c.info.usual_std(vehicle) for c in candidates if not c.confounded}
    return {name: spread for name, spread in spreads.items() if spread > 0.0}


def variance_beside(
    residual: FloatColumn,
    fitted: Matrix,
    chunk: IntColumn,
    small: Mapping[str, FloatColumn],
    spread: Mapping[str, float],
) -> FloatColumn:
    """Return by how much the fitted values vary with the small errors that the fit leaves out (k,).

    residual: whitened (n,); fitted, small: whitened regressors (n, k) and (n,) each. What the data itself
    has of a small error counts: each is fitted to what is left, with its spread as the prior and a chunk as
    one observation, and the values follow by least squares.
    """
    if not small or not fitted.shape[1]:
        return np.zeros(fitted.shape[1])
    scale = np.sqrt((fitted**2).sum(axis=0))
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv(fitted / scale, rcond=1e-8)

    def beside(columns: Matrix) -> Matrix:
        return np.asarray(columns - (fitted / scale) @ (inverse @ columns))

    errors = np.column_stack([spread[name] * column for name, column in small.items()])
    shift = -inverse @ errors / scale[:, None]
    errors, left = beside(errors), beside(residual[:, None])[:, 0]
    noise = max(float(left @ left) / (int(chunk.max()) + 1), 1e-30)
    covariance = np.linalg.inv(np.eye(errors.shape[1]) + errors.T @ errors / noise)
    mean = -covariance @ (errors.T @ left) / noise
    return np.asarray(((shift @ (covariance + np.outer(mean, mean))) * shift).sum(axis=1))
