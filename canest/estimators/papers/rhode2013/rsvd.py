"""The singular value decomposition kept up to date row by row, without U (2013, Alg. 3 and 4)."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack

#: sweeps of Jacobi rotations per row; the matrix is almost diagonal, two or three are enough
MAX_SWEEPS = 12
#: columns count as orthogonal below this cosine
ORTHOGONAL = 1e-15


class State(NamedTuple):
    """What the kernel carries on: singular values (q,), V (q * q,), A^T A (n * n,), sum of weights (1,)."""

    s: Container
    v: Container
    gram: Container
    weight: Container


class Decompositions(NamedTuple):
    """What the kernel fills for each row: X (n), smallest singular value, A^T A (n * n), sum of weights."""

    x: Container
    smallest: Container
    gram: Container
    weight: Container


class Rsvd:
    """S and V of the weighted rows so far, with A^T A and the sum of weights for the covariance.

    V is square from the start (identity, S = 0), so the part of a row outside V (Alg. 3 lines 5-6) is only
    ever round-off, and the branch with truncation (lines 8-9) is the one that always runs.

    forgetting: weight of a row against the next *in squares*, as in RLS. Slip in the 2013 paper: its lambda
    scales rows and so is the square root of an RLS lambda; its 0.997 is 0.997^2 here.
    """

    def __init__(self, n: int, forgetting: float) -> None:
        q = n + 1
        self.n, self.forgetting = n, forgetting
        self._state = [[0.0] * q, np.eye(q).ravel().tolist(), [0.0] * (n * n), [0.0]]

    def add(self, z: FloatColumn) -> tuple[FloatColumn, FloatColumn, FloatColumn, FloatColumn]:
        """Take rows [A B], shape (k, q).

        Returns, after each row: X = -V12 / V22, (k, n), inf when not generic; the smallest singular value,
        (k,); A^T A, (k, n, n); the sum of the weights, (k,).
        """
        n, k = self.n, len(z)
        (rows,) = pack(z)
        found = Decompositions(*(outputs(k * size, 1)[0] for size in (n, 1, n * n, 1)))
        state = State(*(state_in(c) for c in self._state))
        work = state_in([0.0] * ((n + 1) * (n + 2)))
        append_rows(rows, k, n + 1, self.forgetting, state, work, found)
        self._state = [state_out(c) for c in state]
        x, smallest, gram, weight = (unpack(c) for c in found)
        return x.reshape(k, n), smallest, gram.reshape(k, n, n), weight


@jit.kernel
def orthogonalise(m: Container, v: Container, q: int) -> None:
    """Rotate pairs of columns of ``m`` until all are orthogonal (one-sided Jacobi), and those of ``v`` alike.

    m: q columns of length q + 1, v: q columns of length q, both column after column.
    """
    h = q + 1
    sweep = 0
    busy = True
    while busy and sweep < MAX_SWEEPS:
        busy = False
        sweep += 1
        for i in range(q - 1):
            ci = i * h
            for j in range(i + 1, q):
                cj = j * h
                alpha = 0.0
                beta = 0.0
                gamma = 0.0
                for r in range(h):
                    p = m[ci + r]
                    o = m[cj + r]
                    alpha += p * p
                    beta += o * o
                    gamma += p * o
                if abs(gamma) > ORTHOGONAL * sqrt(alpha * beta):
                    busy = True
                    zeta = (beta - alpha) / (2.0 * gamma)
                    if zeta >= 0.0:
                        t = 1.0 / (zeta + sqrt(1.0 + zeta * zeta))
                    else:
                        t = -1.0 / (sqrt(1.0 + zeta * zeta) - zeta)
                    c = 1.0 / sqrt(1.0 + t * t)
                    d = c * t
                    for r in range(h):
                        p = m[ci + r]
                        o = m[cj + r]
                        m[ci + r] = c * p - d * o
                        m[cj + r] = d * p + c * o
                    vi = i * q
                    vj = j * q
                    for r in range(q):
                        p = v[vi + r]
                        o = v[vj + r]
                        v[vi + r] = c * p - d * o
                        v[vj + r] = d * p + c * o


@jit.kernel
def append_rows(
    rows: Container,
    count: int,
    q: int,
    forgetting: float,
    state: State,
    m: Container,
    found: Decompositions,
) -> None:
    """2013, Alg. 3 and 4 for ``count`` rows; v and m are stored column after column.

    M = [lambda S; a^T] with a = V^T z (Alg. 3 lines 3-4) has q columns of length q + 1. Rotating pairs of
    columns until all are orthogonal (one-sided Jacobi) gives M Q = P N: the new singular values are the
    columns' lengths, and the same rotations applied to V give V Q (line 12). P, and so U, is never formed.
    """
    s, v, g, w = state
    x, small, gram, weight = found
    scale = sqrt(forgetting)
    n = q - 1
    h = q + 1
    for k in range(count):
        base = k * q
        for j in range(q):
            a = 0.0
            for i in range(q):
                a += v[j * q + i] * rows[base + i]
                m[j * h + i] = 0.0
            m[j * h + j] = scale * s[j]
            m[j * h + q] = a
        orthogonalise(m, v, q)
        last = 0
        for j in range(q):
            a = 0.0
            for r in range(h):
                a += m[j * h + r] * m[j * h + r]
            s[j] = sqrt(a)
            if s[j] < s[last]:
                last = j
        small[k] = s[last]
        v22 = v[last * q + n]
        for i in range(n):
            x[k * n + i] = -v[last * q + i] / v22 if abs(v22) > 1e-150 else 1e150
            for j in range(n):
                a = g[i * n + j] * forgetting + rows[base + i] * rows[base + j]
                g[i * n + j] = a
                gram[(k * n + i) * n + j] = a
        w[0] = w[0] * forgetting + 1.0
        weight[k] = w[0]
