"""Batch least squares (`batch-ls`): 2005, eq. 5, solved again after every row from running sums."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.estimators.description import Description
from canest.estimators.papers.two_parameter import TwoParameter, TwoParameterOptions


class BatchLs(TwoParameter):
    """All rows since the start weigh the same; causal, since the estimate at k solves eq. 5 with n = k.

    The covariance is sigma^2 (sum phi phi^T)^-1 with sigma^2 = V / (n - 2). The spread of the bounds (or what
    was saved) joins as prior rows, which is what the numbers are made of until there is excitation; they
    keep their own variance, however small sigma is.
    """

    descriptions = (
        Description(
            "batch-ls", "least squares over everything so far", "2005, eq. 5", options=TwoParameterOptions
        ),
    )

    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        determinant = p[0] * p[2] - p[1] * p[1]
        n11, n12, n22 = p[2] / determinant, -p[1] / determinant, p[0] / determinant
        b1, b2 = n11 * theta[0] + n12 * theta[1], n12 * theta[0] + n22 * theta[1]
        # columns: n11, n12, n22, b1, b2, sum of y^2, rows counted as two for the two prior rows
        squares = theta[0] * b1 + theta[1] * b2
        self._sums = np.array([[n11], [n12], [n22], [b1], [b2], [squares], [0.0]])
        self._first_variance = variance

    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        terms = np.stack((phi1 * phi1, phi1 * phi2, phi2 * phi2, phi1 * y, phi2 * y, y * y, np.ones(len(y))))
        sums = np.cumsum(np.concatenate((self._sums, terms), axis=1), axis=1)[:, 1:]
        self._sums = sums[:, -1:]
        n11, n12, n22, b1, b2, squares, count = sums
        determinant = np.maximum(n11 * n22 - n12 * n12, 1e-12 * n11 * n22)
        low, high = self.box.low, self.box.high
        theta1 = np.clip((n22 * b1 - n12 * b2) / determinant, low[0], high[0])
        theta2 = np.clip((n11 * b2 - n12 * b1) / determinant, low[1], high[1])
        # of the clipped parameters too: sum of (y - phi theta)^2
        twice = 2.0 * (theta1 * b1 + theta2 * b2)
        quadratic = n11 * theta1 * theta1 + 2.0 * n12 * theta1 * theta2 + n22 * theta2 * theta2
        loss = np.maximum(squares - twice + quadratic, 0.0)
        # two rows' worth of the start's variance keeps sigma^2 sensible for the first rows
        variance = (loss + 2.0 * self._first_variance) / (count + 2.0)
        p = (n22 / determinant, -n12 / determinant, n11 / determinant)
        return np.stack((theta1, theta2, *self._variances(*p, variance)))
