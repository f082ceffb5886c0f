"""The road of a drive from altitude and accelerometer: Kalman filter and RTS smoother, one step a second.

State x = [altitude, sin(beta), accelerometer bias, pitch]:

    altitude_k+1 = altitude_k + v dt sin(beta);  sin(beta) a random walk in distance;
    accelerometer = a + g sin(beta) + bias + g pitch a   (2014 paper, eq. 3, with its pitch correction).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ

#: noise of a navigation receiver's altitude, m, when its own scatter does not say
MIN_ALTITUDE_STD_M = 0.3
#: an accelerometer's share of vibration that is left in one second, m/s2
ACCELEROMETER_STD_MPS2 = 0.04
#: bias of a vehicle's accelerometer, m/s2, and body pitch, rad per m/s2: prior spread
BIAS_STD_MPS2, PITCH_STD = 0.3, 0.01
#: what is not known of a road: how high it lies, m, and how steep it is
_ALTITUDE_STD_M, _SLOPE_STD = 100.0, 0.05
STEP_TICKS = round(RATE_HZ)  #: ticks per smoother step: one second


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


def smooth(
    fresh: BoolColumn,
    speed: FloatColumn,
    accel: FloatColumn,
    extra: FloatColumn,
    altitude: FloatColumn,
    altitude_std: float,
    walk: FloatColumn,
    pitch: float | None,
) -> tuple[float, FloatColumn, float]:
    """Return log likelihood, sin(beta) (k,) and its median standard deviation; one step is one second.

    fresh: steps after a gap: nobody knows where the road has led.
    """
    n = len(speed)
    known = altitude[np.isfinite(altitude)]
    x = np.array([known[0] if len(known) else 0.0, 0.0, 0.0, 0.01 if pitch is None else pitch])
    pitch_std = PITCH_STD if pitch is None else 0.3 * max(pitch, 0.003)
    P = np.diag([_ALTITUDE_STD_M**2, _SLOPE_STD**2, BIAS_STD_MPS2**2, pitch_std**2])
    xs, Ps = np.empty((n, 4)), np.empty((n, 4, 4))
    before_x, before_P, Fs = np.empty((n, 4)), np.empty((n, 4, 4)), np.empty((n, 4, 4))
    likelihood = 0.0
    for k in range(n):
        F = np.eye(4)
        F[0, 1] = 0.0 if fresh[k] else speed[k]
        x, P = F @ x, F @ P @ F.T
        if fresh[k]:
            P[0, 0] += _ALTITUDE_STD_M**2
            P[1, 1] += _SLOPE_STD**2
        P[1, 1] += walk[k]
        P[0, 0] += 0.01
        before_x[k], before_P[k], Fs[k] = x, P, F
        if np.isfinite(altitude[k]):
            x, P, ll = _update(x, P, np.array([1.0, 0, 0, 0]), altitude[k], altitude_std**2)
            likelihood += ll
        if np.isfinite(extra[k]):
            h = np.array([0, GRAVITY_MPS2, 1.0, GRAVITY_MPS2 * accel[k]])
            x, P, ll = _update(x, P, h, extra[k], ACCELEROMETER_STD_MPS2**2 + (0.05 * accel[k]) ** 2)
            likelihood += ll
        xs[k], Ps[k] = x, P
    for k in range(n - 2, -1, -1):
        C = Ps[k] @ Fs[k + 1].T @ np.linalg.inv(before_P[k + 1])
        xs[k] += C @ (xs[k + 1] - before_x[k + 1])
        Ps[k] += C @ (Ps[k + 1] - before_P[k + 1]) @ C.T
    return likelihood, xs[:, 1], float(np.sqrt(np.median(Ps[:, 1, 1])))


def _update(
    x: FloatColumn, P: FloatColumn, h: FloatColumn, y: float, r: float
) -> tuple[FloatColumn, FloatColumn, float]:
    """Take one scalar measurement y = h x + noise of variance r (Joseph form); also its log likelihood."""
    s = float(h @ P @ h) + r
    K = P @ h / s
    A = np.eye(len(x)) - np.outer(K, h)
    innovation = float(y - h @ x)
    return (
        x + K * innovation,
        A @ P @ A.T + r * np.outer(K, K),
        -0.5 * (innovation**2 / s + float(np.log(s))),
    )
