"""The road of a drive from altitude and accelerometer: one sparse least-squares problem, one step a second.

Unknown are altitude and sin(beta) of every second, and the accelerometer's bias and pitch of the whole drive:

    altitude_k+1 = altitude_k + v dt sin(beta);  sin(beta) a random walk in distance;
    accelerometer = a + g sin(beta) + bias + g pitch a   (2014 paper, eq. 3, with its pitch correction).

The seconds couple with their neighbours alone, so their normal equations are banded: scipy solves them in a
time that grows with the length of the drive. It gives what a Kalman smoother would, with less.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ
from canest.diagnosis.data.least_squares import Matrix

#: noise of a navigation receiver's altitude, m, when its own scatter does not show it
MIN_ALTITUDE_STD_M = 0.3
#: an accelerometer's share of vibration that is left in one second, m/s2
ACCELEROMETER_STD_MPS2 = 0.04
#: bias of a vehicle's accelerometer, m/s2, and body pitch, rad per m/s2: prior spread
BIAS_STD_MPS2, PITCH_STD = 0.3, 0.01
#: what is not known of a road: how high it lies, m, and how steep it is
_ALTITUDE_STD_M, _SLOPE_STD = 100.0, 0.05
#: how far a road's altitude strays from its slope in a second, m
_ROUGHNESS_M = 0.1
STEP_TICKS = round(RATE_HZ)  #: ticks per smoother step: one second
#: so many seconds, evenly spread, show the standard deviation of a whole drive
_SECONDS_JUDGED = 200
_BAND = 2  #: the unknowns are altitude, slope, altitude, slope ...: two apart at most in one equation


#: second, which of its unknowns, factor
_Term = tuple[IntColumn, str, float | FloatColumn]


@dataclass(frozen=True)
class SmoothedRoad:
    """What is known of a drive's road: sin(beta) (k,), its median standard deviation, the log likelihood.

    bias_std_mps2, pitch_std: how well the accelerometer's bias and the body's pitch (rad per m/s2) are known.
    """

    sin_beta: FloatColumn
    std: float
    log_likelihood: float
    bias_std_mps2: float
    pitch_std: float


def whole_seconds(begins: BoolColumn) -> tuple[IntColumn, BoolColumn]:
    """Return the first tick of each whole second (k,), and which of them follow another across a gap.

    begins: where the log begins, or goes on after a gap (n,).
    """
    edges = np.flatnonzero(begins)
    bounds = pairwise([*edges.tolist(), len(begins)])
    first = np.concatenate([np.arange(a, b - STEP_TICKS + 1, STEP_TICKS) for a, b in bounds])
    fresh = np.isin(first, edges)
    fresh[:1] = False  # what lies before it was too short for a second
    return first, fresh


def on_ticks(values: FloatColumn, first: IntColumn, fresh: BoolColumn, n: int) -> FloatColumn:
    """Return what was found for each second on every tick (n,), drawn through no gap."""
    ticks, centres = np.arange(n), first + 0.5 * (STEP_TICKS - 1)
    column = np.empty(n)
    edges = np.flatnonzero(fresh).tolist()
    starts = [0, *first[edges].tolist(), n]
    for (begin, end), (a, b) in zip(pairwise([0, *edges, len(first)]), pairwise(starts), strict=True):
        column[a:b] = np.interp(ticks[a:b], centres[begin:end], values[begin:end])
    return column


def altitude_noise_m(altitude: FloatColumn, speed: FloatColumn) -> float:
    """Return the altitude's noise from its second differences (a road has none at one second)."""
    moving = altitude[(speed > 1.0) & np.isfinite(altitude)]
    if len(moving) < 10:
        return 10.0
    second = np.diff(moving, 2)
    return max(float(1.4826 * np.median(np.abs(second)) / np.sqrt(6.0)), MIN_ALTITUDE_STD_M)


def pitch_std_of(declared: float | None) -> float:
    """Return how well the body's pitch is known before a drive, rad per m/s2."""
    return PITCH_STD if declared is None else 0.3 * max(declared, 0.003)


def smooth(
    fresh: BoolColumn,
    speed: FloatColumn,
    accel: FloatColumn,
    extra: FloatColumn,
    altitude: FloatColumn,
    altitude_std: float,
    walk: FloatColumn,
    pitch: float | None,
) -> SmoothedRoad:
    """Return the likeliest road; one step is one second, every column is (k,).

    fresh: steps after a gap: nobody knows where the road has led. extra: accelerometer less acceleration.
    walk: variance that sin(beta) gains in a step. pitch: as declared, or None.
    """
    known = altitude[np.isfinite(altitude)]
    altitude = altitude - (known[0] if len(known) else 0.0)
    equations = _Equations(len(speed))
    equations.road(fresh, speed, walk)
    seen = np.flatnonzero(np.isfinite(altitude))
    equations.add([(seen, "altitude", 1.0)], altitude[seen], altitude_std)
    at = np.flatnonzero(np.isfinite(extra))
    scatter = np.hypot(ACCELEROMETER_STD_MPS2, 0.05 * accel[at])
    of_drive = np.column_stack([np.ones(len(at)), GRAVITY_MPS2 * accel[at]])
    equations.add([(at, "slope", GRAVITY_MPS2)], extra[at], scatter, of_drive)
    equations.add([], np.array([0.0]), BIAS_STD_MPS2, np.array([[1.0, 0.0]]))
    equations.add(
        [], np.array([0.01 if pitch is None else pitch]), pitch_std_of(pitch), np.array([[0.0, 1.0]])
    )
    return equations.solve()


class _Equations:
    """Weighted equations in two unknowns per second (and a second before the first), and two of the drive."""

    def __init__(self, seconds: int) -> None:
        self._seconds = seconds
        self._local: list[sparse.csr_array] = []
        self._of_drive: list[Matrix] = []
        self._wanted: list[FloatColumn] = []
        self._log_scale = 0.0

    def add(
        self,
        terms: list[_Term],
        wanted: FloatColumn,
        std: float | FloatColumn,
        of_drive: Matrix | None = None,
    ) -> None:
        """Add equations: the sum of terms and what the drive's two unknowns give is `wanted` (r,) within std.

        terms: second (-1 is the one before the first), which of its unknowns, and the factor.
        """
        rows, weight = len(wanted), 1.0 / np.broadcast_to(std, len(wanted))
        local = sparse.csr_array((rows, 2 * (self._seconds + 1)))
        for second, which, factor in terms:
            column = 2 * (second + 1) + (which == "slope")
            entries = np.broadcast_to(factor, rows) * weight
            local = local + sparse.csr_array((entries, (np.arange(rows), column)), shape=local.shape)
        self._local.append(local)
        whole = np.zeros((rows, 2)) if of_drive is None else of_drive
        self._of_drive.append(whole * weight[:, None])
        self._wanted.append(wanted * weight)
        self._log_scale -= 2.0 * float(np.log(weight).sum())

    def road(self, fresh: BoolColumn, speed: FloatColumn, walk: FloatColumn) -> None:
        """Add how altitude and slope go on from second to second, and what is known before the first."""
        before, now = np.arange(self._seconds) - 1, np.arange(self._seconds)
        nothing = np.zeros(self._seconds)
        climbed = np.where(fresh, 0.0, speed)
        stray = np.sqrt(_ROUGHNESS_M**2 + fresh * _ALTITUDE_STD_M**2)
        rises: list[_Term] = [(now, "altitude", 1.0), (before, "altitude", -1.0), (before, "slope", -climbed)]
        self.add(rises, nothing, stray)
        bends = np.sqrt(walk + fresh * _SLOPE_STD**2)
        self.add([(now, "slope", 1.0), (before, "slope", -1.0)], nothing, bends)
        start = np.array([-1])
        self.add([(start, "altitude", 1.0)], nothing[:1], _ALTITUDE_STD_M)
        self.add([(start, "slope", 1.0)], nothing[:1], _SLOPE_STD)

    def solve(self) -> SmoothedRoad:
        """Solve the banded part, and the two unknowns of the drive by their Schur complement."""
        A, B = sparse.vstack(self._local).tocsr(), np.vstack(self._of_drive)
        y = np.concatenate(self._wanted)
        normal = (A.T @ A).todia()
        band = np.zeros((_BAND + 1, A.shape[1]))
        for i in range(_BAND + 1):
            band[i, : A.shape[1] - i] = normal.diagonal(-i)
        factor = (cholesky_banded(band, lower=True), True)
        coupling = A.T @ B
        from_coupling = cho_solve_banded(factor, coupling)
        schur = B.T @ B - coupling.T @ from_coupling
        from_data = cho_solve_banded(factor, A.T @ y)
        of_drive = np.linalg.solve(schur, B.T @ y - coupling.T @ from_data)
        local = from_data - from_coupling @ of_drive
        left = y - A @ local - B @ of_drive
        log_det = 2.0 * float(np.log(factor[0][0]).sum()) + float(np.linalg.slogdet(schur)[1])
        covariance = np.linalg.inv(schur)
        bias_std, pitch_std = np.sqrt(np.diag(covariance)).tolist()
        return SmoothedRoad(
            local[3::2],
            self._slope_std(factor, from_coupling, covariance),
            -0.5 * (float(left @ left) + log_det + self._log_scale),
            bias_std,
            pitch_std,
        )

    def _slope_std(self, factor: tuple[Matrix, bool], from_coupling: Matrix, covariance: Matrix) -> float:
        """Return the median standard deviation of sin(beta)."""
        step = max(1, self._seconds // _SECONDS_JUDGED)
        places = 3 + 2 * np.arange(0, self._seconds, step)
        units = np.zeros((len(from_coupling), len(places)))
        units[places, np.arange(len(places))] = 1.0
        own = cho_solve_banded(factor, units)[places, np.arange(len(places))]
        shared = from_coupling[places]
        return float(np.sqrt(np.median(own + ((shared @ covariance) * shared).sum(axis=1))))
