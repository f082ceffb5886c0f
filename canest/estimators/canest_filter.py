"""The algebra of one Kalman filter of `canest`: measure, travel, push, begin, open again.

Containers are lists interpreted and arrays compiled; P is a list of rows or a matrix, symmetric throughout.
"""

from __future__ import annotations

import math
from typing import Any

from canest import fast
from canest.estimators.canest_states import (
    BASE_STATES,
    CURVATURE,
    DELAY,
    GRADE,
    HEIGHT,
    SLIP,
    STATES,
    WIND,
    Q,
    U,
)
from canest.estimators.canest_windows import WINDOW_S
from canest.vehicle.samples import GRAVITY_MPS2

Container = Any  #: list interpreted, array compiled

#: innovations beyond this many squared stds count as outliers and weigh less (Huber)
OUTLIER = 9.0


@fast.kernel
def settle_driveline(x: Container, P: Container, w: Container, gain: float) -> None:
    """Do x += gain w, P -= w w' for the states before `FREE`. Written out: the three are most of the work."""
    a, b, c, d, e = w[0], w[1], w[2], w[3], w[4]
    x[0] += gain * a
    x[1] += gain * b
    x[2] += gain * c
    x[3] += gain * d
    x[4] += gain * e
    A, B, C, D, E = P[0], P[1], P[2], P[3], P[4]
    A[0] -= a * a
    A[1] = B[0] = A[1] - a * b
    B[1] -= b * b
    A[2], B[2] = A[2] - a * c, B[2] - b * c
    C[0], C[1] = A[2], B[2]
    C[2] -= c * c
    A[3], B[3], C[3] = A[3] - a * d, B[3] - b * d, C[3] - c * d
    D[0], D[1], D[2] = A[3], B[3], C[3]
    D[3] -= d * d
    A[4], B[4], C[4], D[4] = A[4] - a * e, B[4] - b * e, C[4] - c * e, D[4] - d * e
    E[0], E[1], E[2], E[3] = A[4], B[4], C[4], D[4]
    E[4] -= e * e


@fast.kernel
def settle_road(x: Container, P: Container, w: Container, gain: float) -> None:
    """Do the same for the states from `FREE` to `BASE_STATES`, and for what couples the others to them."""
    a, b, c, d, e, f, g, h = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]
    x[5] += gain * f
    x[6] += gain * g
    x[7] += gain * h
    A, B, C, D, E, F, G, H = P[0], P[1], P[2], P[3], P[4], P[5], P[6], P[7]
    A[5], B[5], C[5], D[5], E[5] = A[5] - a * f, B[5] - b * f, C[5] - c * f, D[5] - d * f, E[5] - e * f
    F[0], F[1], F[2], F[3], F[4] = A[5], B[5], C[5], D[5], E[5]
    F[5] -= f * f
    A[6], B[6], C[6], D[6], E[6] = A[6] - a * g, B[6] - b * g, C[6] - c * g, D[6] - d * g, E[6] - e * g
    F[6] -= f * g
    G[0], G[1], G[2], G[3], G[4], G[5] = A[6], B[6], C[6], D[6], E[6], F[6]
    G[6] -= g * g
    A[7], B[7], C[7], D[7], E[7] = A[7] - a * h, B[7] - b * h, C[7] - c * h, D[7] - d * h, E[7] - e * h
    F[7], G[7] = F[7] - f * h, G[7] - g * h
    H[0], H[1], H[2], H[3], H[4], H[5], H[6] = A[7], B[7], C[7], D[7], E[7], F[7], G[7]
    H[7] -= h * h


@fast.kernel
def settle_sensed(x: Container, P: Container, w: Container, gain: float) -> None:
    """Do the same for the three states of an accelerometer, which come last."""
    i, j, k = w[8], w[9], w[10]
    R, S, T = P[8], P[9], P[10]
    for m in range(BASE_STATES):
        v, row = w[m], P[m]
        row[8], row[9], row[10] = row[8] - v * i, row[9] - v * j, row[10] - v * k
        R[m], S[m], T[m] = row[8], row[9], row[10]
    x[8] += gain * i
    x[9] += gain * j
    x[10] += gain * k
    R[8] -= i * i
    R[9] = S[8] = R[9] - i * j
    S[9] -= j * j
    R[10], S[10] = R[10] - i * k, S[10] - j * k
    T[8], T[9] = R[10], S[10]
    T[10] -= k * k


@fast.kernel
def correct(
    x: Container,
    P: Container,
    w: Container,
    first: int,
    z: float,
    r: float,
    i0: int,
    h0: float,
    i1: int,
    h1: float,
    i2: int,
    h2: float,
    i3: int,
    h3: float,
    i4: int,
    h4: float,
) -> tuple[float, float]:
    """Measure z = h0 x[i0] + ... + h4 x[i4] + noise of variance r; move states from `first` (0 or FREE) on.

    Kalman update in the symmetric form P -= w w', w = P h / sqrt(s); for states before `first` the gain is
    zero and their block of P stays (Schmidt-Kalman). w: scratch, as long as x. Returns the innovation and
    its variance.
    """
    n = len(x)
    rows = zip(P[i0], P[i1], P[i2], P[i3], P[i4])  # noqa: B905 - numba knows no strict
    for i, (a, b, c, d, f) in enumerate(rows):
        w[i] = h0 * a + h1 * b + h2 * c + h3 * d + h4 * f
    s = max(r + h0 * w[i0] + h1 * w[i1] + h2 * w[i2] + h3 * w[i3] + h4 * w[i4], r)
    e = z - h0 * x[i0] - h1 * x[i1] - h2 * x[i2] - h3 * x[i3] - h4 * x[i4]
    root = 1.0 / math.sqrt(max(s, e * e / OUTLIER))
    gain = e * root
    for i in range(n):
        w[i] *= root
    if n >= BASE_STATES:
        if first == 0:
            settle_driveline(x, P, w, gain)
        settle_road(x, P, w, gain)
        if n == STATES:
            settle_sensed(x, P, w, gain)
    else:
        for i in range(n):
            wi = w[i]
            x[i] += gain * wi
            row = P[i]
            for j in range(i + 1):
                row[j] = P[j][i] = row[j] - wi * w[j]
    return e, s


@fast.kernel
def hold_within(x: Container, P: Container, i: int, least: float, most: float) -> float:
    """Move state i back between its bounds, and with it what is correlated (parameter projection).

    Returns how far it was moved.
    """
    beyond: float = min(max(x[i], least), most) - x[i]
    if beyond != 0.0 and P[i][i] > 0.0:
        share = beyond / P[i][i]
        for j in range(len(x)):
            x[j] += share * P[i][j]
        x[i] = min(max(x[i], least), most)
    return beyond


@fast.kernel
def widen(P: Container, i: int, variance: float) -> None:
    """Forget state i: only its variance is left."""
    for j in range(len(P)):
        P[i][j] = 0.0
        P[j][i] = 0.0
    P[i][i] = variance


@fast.kernel
def carry(P: Container, i: int, j: int, factor: float) -> None:
    """Do to the covariance what x[i] += factor x[j] does to the states."""
    to, of = P[i], P[j]
    own = to[i] + factor * (2.0 * to[j] + factor * of[j])
    for k in range(len(P)):
        to[k] += factor * of[k]
        P[k][i] = to[k]
    to[i] = own


@fast.kernel
def travel(
    x: Container, P: Container, ds: float, bends: bool, climbs: bool, grade_var: float, height_var: float
) -> None:
    """Move `ds` metres along the road: h += ds theta, theta += ds kappa, and what they gain in variance.

    bends: a straight has no kappa. climbs: without altitudes nobody asks for h.
    """
    if climbs:
        x[HEIGHT] += ds * x[GRADE]
        carry(P, HEIGHT, GRADE, ds)
        P[HEIGHT][HEIGHT] += height_var
    if bends:
        x[GRADE] += ds * x[CURVATURE]
        carry(P, GRADE, CURVATURE, ds)
    P[GRADE][GRADE] += grade_var


@fast.kernel
def fade(x: Container, P: Container, i: int, left: float, fresh_var: float) -> None:
    """Let state i forget: `left` of it remains (a first-order Gauss-Markov process in the distance)."""
    x[i] *= left
    row = P[i]
    for j in range(len(P)):
        row[j] *= left
        P[j][i] = row[j]
    row[i] = left * row[i] + fresh_var


@fast.kernel
def push(x: Container, P: Container, force: float, roll: float, drag: float, noise: float) -> None:
    """Add a window's momentum per mass: dq = dt (u F - g mu - g theta - c omega) + noise."""
    n = len(x)
    fu = WINDOW_S * force
    fg = -WINDOW_S * GRAVITY_MPS2
    fw = -WINDOW_S * drag
    x[Q] += fu * x[U] + fg * x[GRADE] + fw * x[WIND] - WINDOW_S * roll
    momentum, inverse, grade, wind = P[Q], P[U], P[GRADE], P[WIND]
    momentum[Q] += 2.0 * (fu * momentum[U] + fg * momentum[GRADE] + fw * momentum[WIND]) + noise
    momentum[Q] += fu * (fu * inverse[U] + 2.0 * (fg * inverse[GRADE] + fw * inverse[WIND]))
    momentum[Q] += fg * (fg * grade[GRADE] + 2.0 * fw * grade[WIND]) + fw * fw * wind[WIND]
    for j in range(1, n):
        momentum[j] += fu * inverse[j] + fg * grade[j] + fw * wind[j]
        P[j][Q] = momentum[j]


@fast.kernel
def start(
    x: Container, P: Container, z: float, r: float, t: float, late: float, rotating: float, whole: float
) -> None:
    """Begin a balance at the measured speed: q = z + u J z - (1 + u J) (delta T + sigma z T + noise r)."""
    n = len(x)
    hd, hs, hu = -late * whole, -z * t * whole, rotating * z
    x[Q] = z + hd * x[DELAY] + hs * x[SLIP] + hu * x[U]
    delay, slip, inverse = P[DELAY], P[SLIP], P[U]
    momentum = P[Q]
    for j in range(1, n):
        momentum[j] = hd * delay[j] + hs * slip[j] + hu * inverse[j]
        P[j][Q] = momentum[j]
    momentum[Q] = r * whole * whole + hd * momentum[DELAY] + hs * momentum[SLIP] + hu * momentum[U]


@fast.kernel
def reopen(x: Container, P: Container, prior: Container, std: float, looser: float) -> None:
    """The load may have changed, u by `std`: what is a product with u goes along, less sure than before.

    looser: share of its prior variance that delay, slip and an accelerometer's bias and pitch gain.
    """
    for i in (U, DELAY, SLIP, WIND):
        for j in (U, DELAY, SLIP, WIND):
            P[i][j] += std * std * (x[i] / x[U]) * (x[j] / x[U])
    for i in range(len(x)):
        if i in (DELAY, SLIP) or i >= BASE_STATES:
            P[i][i] += looser * prior[i] * prior[i]
