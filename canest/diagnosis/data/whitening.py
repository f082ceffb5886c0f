"""Whitening: an unknown grade, whose error decays over distance, is filtered out of every column."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.drive_part import DrivePart
from canest.diagnosis.data.least_squares import Matrix

#: what is left of speed quantisation and oscillation in a one-second mean, as specific force (m/s2)
WINDOW_NOISE_MPS2 = 0.004


class GradeFilter:
    """The scalar Kalman filter of one drive's grade error, a force that decays over distance.

    Its gains depend on no measurement. Its recursion is therefore a linear system with two diagonals, which
    is solved for any number of columns at once.

    std_N: standard deviations of the innovations (n,).
    """

    def __init__(self, part: DrivePart) -> None:
        noise = (WINDOW_NOISE_MPS2 * part.mass_w) ** 2
        self._unknown = part.reference.sin_beta_std > 0.0
        if not self._unknown:
            self.std_N: FloatColumn = np.sqrt(noise)
            return
        spread = (part.reference.sin_beta_std * GRAVITY_MPS2 * part.mass_w) ** 2
        passed_m = np.diff(part.windows.t_s, prepend=part.windows.t_s[:1]) * part.speed_mps
        keep = np.exp(-passed_m / part.reference.correlation_m)
        variance, gains, innovation = float(spread[0]), np.empty(len(keep)), np.empty(len(keep))
        for k, (kept, wide, white) in enumerate(
            zip(keep.tolist(), spread.tolist(), noise.tolist(), strict=True)
        ):
            variance = kept * kept * variance + (1.0 - kept * kept) * wide
            innovation[k] = variance + white
            gains[k] = variance / innovation[k]
            variance *= 1.0 - gains[k]
        self.std_N = np.sqrt(innovation)
        self._taken = keep[1:] * gains[:-1]
        self._bands = np.ones((2, len(keep)))
        self._bands[1, :-1] = -keep[1:] * (1.0 - gains[:-1])

    def innovations(self, columns_N: Matrix) -> Matrix:
        """Return the normalised innovations of columns in N, (n,) or (n, k), in the same shape."""
        columns = columns_N.reshape(len(columns_N), -1)
        if self._unknown:
            seen = np.zeros(columns.shape)
            seen[1:] = self._taken[:, None] * columns[:-1]
            columns = columns - solve_banded((1, 0), self._bands, seen)
        return np.asarray(columns / self.std_N[:, None]).reshape(columns_N.shape)
