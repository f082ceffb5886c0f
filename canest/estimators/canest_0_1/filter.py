"""The algebra of one Kalman filter of `canest`: measure, travel, push, begin, open again.

Containers are lists interpreted and arrays compiled; P is a list of rows or a matrix, symmetric throughout.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.canest_0_1.states import (
    BASE_STATES,
    CURVATURE,
    DELAY,
    GRADE,
    HEIGHT,
    SLIP,
    WIND,
    WINDUP,
    Q,
    U,
)
from canest.estimators.windowing import WINDOW_S

Container = Any  #: list interpreted, array compiled

#: innovations beyond this many squared stds count as outliers and weigh less (Huber)
OUTLIER = 9.0


@jit.kernel
def settle(x: Container, P: Container, w: Container, root: float, gain: float, first: int) -> None:
    """Do x += gain root w, P -= (root w) (root w)' but for the block of P before `first`, 0 or `FREE`.

    Written out, and states that w does not move are left out: this is most of the work.
    """
    a, b, c, d, e = w[0] * root, w[1] * root, w[2] * root, w[3] * root, w[4] * root
    f, g, h, k = w[5] * root, w[6] * root, w[7] * root, w[8] * root
    A, B, C, D, E, F, G, H, K = P[0], P[1], P[2], P[3], P[4], P[5], P[6], P[7], P[8]
    if first == 0:
        x[0] += gain * a
        A[0] -= a * a
        x[1] += gain * b
        A[1] = B[0] = A[1] - a * b
        B[1] -= b * b
        x[2] += gain * c
        A[2] = C[0] = A[2] - a * c
        B[2] = C[1] = B[2] - b * c
        C[2] -= c * c
        x[3] += gain * d
        A[3] = D[0] = A[3] - a * d
        B[3] = D[1] = B[3] - b * d
        C[3] = D[2] = C[3] - c * d
        D[3] -= d * d
        x[4] += gain * e
        A[4] = E[0] = A[4] - a * e
        B[4] = E[1] = B[4] - b * e
        C[4] = E[2] = C[4] - c * e
        D[4] = E[3] = D[4] - d * e
        E[4] -= e * e
        x[5] += gain * f
        A[5] = F[0] = A[5] - a * f
        B[5] = F[1] = B[5] - b * f
        C[5] = F[2] = C[5] - c * f
        D[5] = F[3] = D[5] - d * f
        E[5] = F[4] = E[5] - e * f
        F[5] -= f * f
    x[6] += gain * g
    A[6] = G[0] = A[6] - a * g
    B[6] = G[1] = B[6] - b * g
    C[6] = G[2] = C[6] - c * g
    D[6] = G[3] = D[6] - d * g
    E[6] = G[4] = E[6] - e * g
    F[6] = G[5] = F[6] - f * g
    G[6] -= g * g
    if h != 0.0:  # a straight has no curvature
        x[7] += gain * h
        A[7] = H[0] = A[7] - a * h
        B[7] = H[1] = B[7] - b * h
        C[7] = H[2] = C[7] - c * h
        D[7] = H[3] = D[7] - d * h
        E[7] = H[4] = E[7] - e * h
        F[7] = H[5] = F[7] - f * h
        G[7] = H[6] = G[7] - g * h
        H[7] -= h * h
    if k != 0.0:  # without altitudes nobody asks for a height
        x[8] += gain * k
        A[8] = K[0] = A[8] - a * k
        B[8] = K[1] = B[8] - b * k
        C[8] = K[2] = C[8] - c * k
        D[8] = K[3] = D[8] - d * k
        E[8] = K[4] = E[8] - e * k
        F[8] = K[5] = F[8] - f * k
        G[8] = K[6] = G[8] - g * k
        H[8] = K[7] = H[8] - h * k
        K[8] -= k * k
    if len(x) > BASE_STATES:
        m, n, r = w[9] * root, w[10] * root, w[11] * root
        M, N, R = P[9], P[10], P[11]
        x[9] += gain * m
        A[9] = M[0] = A[9] - a * m
        B[9] = M[1] = B[9] - b * m
        C[9] = M[2] = C[9] - c * m
        D[9] = M[3] = D[9] - d * m
        E[9] = M[4] = E[9] - e * m
        F[9] = M[5] = F[9] - f * m
        G[9] = M[6] = G[9] - g * m
        H[9] = M[7] = H[9] - h * m
        K[9] = M[8] = K[9] - k * m
        M[9] -= m * m
        x[10] += gain * n
        A[10] = N[0] = A[10] - a * n
        B[10] = N[1] = B[10] - b * n
        C[10] = N[2] = C[10] - c * n
        D[10] = N[3] = D[10] - d * n
        E[10] = N[4] = E[10] - e * n
        F[10] = N[5] = F[10] - f * n
        G[10] = N[6] = G[10] - g * n
        H[10] = N[7] = H[10] - h * n
        K[10] = N[8] = K[10] - k * n
        M[10] = N[9] = M[10] - m * n
        N[10] -= n * n
        x[11] += gain * r
        A[11] = R[0] = A[11] - a * r
        B[11] = R[1] = B[11] - b * r
        C[11] = R[2] = C[11] - c * r
        D[11] = R[3] = D[11] - d * r
        E[11] = R[4] = E[11] - e * r
        F[11] = R[5] = F[11] - f * r
        G[11] = R[6] = G[11] - g * r
        H[11] = R[7] = H[11] - h * r
        K[11] = R[8] = K[11] - k * r
        M[11] = R[9] = M[11] - m * r
        N[11] = R[10] = N[11] - n * r
        R[11] -= r * r


@jit.kernel
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
    a, b, c, d, f = P[i0], P[i1], P[i2], P[i3], P[i4]
    for i in range(n):
        w[i] = h0 * a[i] + h1 * b[i] + h2 * c[i] + h3 * d[i] + h4 * f[i]
    s = max(r + h0 * w[i0] + h1 * w[i1] + h2 * w[i2] + h3 * w[i3] + h4 * w[i4], r)
    e = z - h0 * x[i0] - h1 * x[i1] - h2 * x[i2] - h3 * x[i3] - h4 * x[i4]
    root = 1.0 / math.sqrt(max(s, e * e / OUTLIER))
    gain = e * root
    if n >= BASE_STATES:
        settle(x, P, w, root, gain, first)
    else:
        for i in range(n):
            w[i] *= root
            wi = w[i]
            x[i] += gain * wi
            row = P[i]
            for j in range(i + 1):
                row[j] = P[j][i] = row[j] - wi * w[j]
    return e, s


@jit.kernel
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


@jit.kernel
def widen(P: Container, i: int, variance: float) -> None:
    """Forget state i: only its variance is left."""
    for j in range(len(P)):
        P[i][j] = 0.0
        P[j][i] = 0.0
    P[i][i] = variance


@jit.kernel
def carry(P: Container, i: int, j: int, factor: float) -> None:
    """Do to the covariance what x[i] += factor x[j] does to the states."""
    to, of = P[i], P[j]
    own = to[i] + factor * (2.0 * to[j] + factor * of[j])
    for k in range(len(P)):
        to[k] = P[k][i] = to[k] + factor * of[k]
    to[i] = own


@jit.kernel
def travel(x: Container, P: Container, ds: float, bends: bool, climbs: bool, grade_var: float) -> None:
    """Move `ds` metres along the road: h += ds theta, theta += ds kappa, and what theta gains in variance.

    bends: a straight has no kappa. climbs: without altitudes nobody asks for h.
    """
    if climbs:
        x[HEIGHT] += ds * x[GRADE]
        carry(P, HEIGHT, GRADE, ds)
    if bends:
        x[GRADE] += ds * x[CURVATURE]
        carry(P, GRADE, CURVATURE, ds)
    P[GRADE][GRADE] += grade_var


@jit.kernel
def fade(x: Container, P: Container, i: int, left: float, fresh_var: float) -> None:
    """Let state i forget: `left` of it remains (a first-order Gauss-Markov process in the distance)."""
    x[i] *= left
    row = P[i]
    for j in range(len(P)):
        row[j] *= left
        P[j][i] = row[j]
    row[i] = left * row[i] + fresh_var


@jit.kernel
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
        momentum[j] = P[j][Q] = momentum[j] + (fu * inverse[j] + fg * grade[j] + fw * wind[j])


@jit.kernel
def start(
    x: Container,
    P: Container,
    z: float,
    r: float,
    t: float,
    late: float,
    rate: float,
    rotating: float,
    whole: float,
) -> None:
    """Begin a balance at the measured speed: q = (1 + u J) (z - delta T - sigma z T - noise) - gamma dT/dt"""
    n = len(x)
    hd, hs, hu = -late * whole, -z * t * whole, rotating * z
    x[Q] = z + hd * x[DELAY] + hs * x[SLIP] - rate * x[WINDUP] + hu * x[U]
    delay, slip, windup, inverse = P[DELAY], P[SLIP], P[WINDUP], P[U]
    momentum = P[Q]
    for j in range(1, n):
        momentum[j] = hd * delay[j] + hs * slip[j] - rate * windup[j] + hu * inverse[j]
        P[j][Q] = momentum[j]
    momentum[Q] = r * whole * whole + hd * momentum[DELAY] + hs * momentum[SLIP]
    momentum[Q] += hu * momentum[U] - rate * momentum[WINDUP]


@jit.kernel
def reopen(x: Container, P: Container, prior: Container, std: float, looser: float) -> None:
    """The load may have changed, u by `std`: what is a product with u (windup is none) goes along, less sure.

    looser: share of its prior variance that delay, slip and an accelerometer's bias and pitch gain.
    """
    for i in (U, DELAY, SLIP, WIND):
        for j in (U, DELAY, SLIP, WIND):
            P[i][j] += std * std * (x[i] / x[U]) * (x[j] / x[U])
    for i in range(len(x)):
        if i in (DELAY, SLIP) or i >= BASE_STATES:
            P[i][i] += looser * prior[i] * prior[i]
