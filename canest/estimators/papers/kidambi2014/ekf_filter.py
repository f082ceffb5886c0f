"""One extended Kalman filter with states [v, 1/m, sin(beta + beta_mu)]: 2014 paper, eqs. 6-10.

A slip in the paper, put right here: eq. 5b lacks the minus sign of phi_2 (uphill grade slows down, eq. 2 has
it).
"""

from __future__ import annotations

from copy import copy
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from canest.core import jit
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, STEP_S, ModelBlock
from canest.estimators.autocorrelation import AutocorrelationInflation
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack
from canest.estimators.papers.inverse_mass import Box
from canest.estimators.papers.prior import P_LIMIT, VARIANCE_ALPHA
from canest.estimators.papers.two_parameter import Limits
from canest.estimators.regression import FORCE_LIMIT_N, SPEED_LIMIT_MPS, secant, usable

#: process noise adds up to this many ticks without excitation, then P stays (200 s)
WIND_UP_TICKS = 10_000


class Rows:
    """The samples of a block that the filter runs on, and what it needs of them, shape (k,) each."""

    def __init__(self, block: ModelBlock, before: bool) -> None:
        ok = usable(block)
        fresh = block.restart | ~np.concatenate(([before], ok[:-1]))[: len(ok)]
        #: whether the last sample so far was usable, for the next block's ``before``
        self.after = bool(ok[-1]) if len(ok) else before
        self.at: IntColumn = np.flatnonzero(ok)
        at = self.at
        self.mu: FloatColumn = block.mu[at]
        self.speed: FloatColumn = block.speed_mps[at]
        self.force: FloatColumn = block.force_N[at]
        self.aero: FloatColumn = np.where(np.abs(block.aero_N[at]) < FORCE_LIMIT_N, block.aero_N[at], 0.0)
        self.phi2: FloatColumn = -GRAVITY_MPS2 * secant(self.mu)
        self.fresh: FloatColumn = fresh[at].astype(np.float64)


class Samples(NamedTuple):
    """What the kernel reads, (k,) each: speed, F, drag, phi2, and 1 where the filter starts anew."""

    speed: Container
    force: Container
    aero: Container
    phi2: Container
    fresh: Container


class Noise(NamedTuple):
    """Variances of one step: process noise of v, 1/m, sin(beta + beta_mu), and of the measured speed."""

    q1: float
    q2: float
    q3: float
    r: float


class Filtered(NamedTuple):
    """What the kernel fills, (k,) each: theta, diagonal of P, innovations^2 over variance, innovation."""

    theta1: Container
    theta2: Container
    var1: Container
    var2: Container
    ratio: Container
    innovation: Container


class EkfCore:
    """One filter: theta, covariance and how well its innovations fit them; usable many times side by side."""

    def __init__(
        self,
        options: Any,
        box: Box,
        theta: tuple[float, float],
        variance: tuple[float, float],
        noise_of: EkfCore | None = None,
    ) -> None:
        """Start at theta with the variances; what is known of the noise comes from another filter, if any."""
        per_tick = STEP_S * options.rate_hz
        q = [variance * per_tick for variance in options.q]
        self._noise = Noise(q[0], q[1], q[2], options.r / per_tick)
        # however Q and R are scaled, P may hold the start's variance and what Q adds while nothing is learned
        added = [q * per_tick * WIND_UP_TICKS for q in options.q[1:]]
        tops = [max(P_LIMIT * b, v, a) for b, v, a in zip(box.variance, variance, added, strict=True)]
        self._limits = Limits(box.low[0], box.high[0], box.low[1], box.high[1], tops[0], tops[1])
        # v, theta1, theta2, p11, p12, p13, p22, p23, p33, mean innovation^2 / its variance, 1 while fresh
        self.state = [0.0, *theta, 0.0, 0.0, 0.0, variance[0], 0.0, variance[1], 1.0, 1.0]
        self._inflation = AutocorrelationInflation()
        if noise_of is not None:
            self.state[9], self._inflation = noise_of.state[9], copy(noise_of._inflation)

    def run(self, rows: Rows, begin: int, end: int) -> FloatColumn:
        """Take rows begin..end; return what is known after each, shape (5, end - begin).

        theta1, theta2, their variances, and the element of P that belongs to theta1.
        """
        part = slice(begin, end)
        out, state = outputs(end - begin, 6), state_in(self.state)
        columns = (rows.speed, rows.force, rows.aero, rows.phi2, rows.fresh)
        samples = Samples(*pack(*(column[part] for column in columns)))
        ekf_steps(samples, self._noise, self._limits, state, Filtered(*out))
        self.state = state_out(state)
        known = np.stack([unpack(c) for c in (*out[:4], out[2])])
        known[2:4] *= unpack(out[4]) * self._inflation(unpack(out[5]))
        return known


@jit.kernel
def ekf_steps(samples: Samples, noise: Noise, limits: Limits, state: Container, filtered: Filtered) -> None:
    """2014, eqs. 7-10: predict by Euler (eq. 8, drag at the filter's speed), correct with H = [1 0 0].

    Jacobian row of v: [1 - Ts theta1 dFaero/dv, Ts phi1, Ts phi2]. A fresh row (after a gate) sets v to the
    measurement and forgets what v had to do with the parameters. `var` is P's diagonal, `ratio` the
    mean of the squared innovations over their predicted variance: their product is the variance, so Q and R
    need only be right in proportion.
    """
    v, a, b, p11, p12, p13, p22, p23, p33, fit, first = state
    speed, force, aero, phi2, fresh = samples
    q1, q2, q3, r = noise
    low1, high1, low2, high2, top1, top2 = limits
    theta1, theta2, var1, var2, ratio, innovation = filtered
    for k in range(len(speed)):
        y = speed[k]
        if first > 0.0 or fresh[k] > 0.0:
            first = 0.0
            e = 0.0
            v = y
            p11 = r
            p12 = 0.0
            p13 = 0.0
        else:
            square = y * y
            if square > 1.0:
                drag = aero[k] / square
                f = force[k] + aero[k] - drag * v * v
                a11 = 1.0 - 2.0 * STEP_S * a * drag * v
            else:
                f = force[k]
                a11 = 1.0
            a12 = STEP_S * f
            a13 = STEP_S * phi2[k]
            v += a12 * a + a13 * b
            u1 = a11 * p11 + a12 * p12 + a13 * p13
            u2 = a11 * p12 + a12 * p22 + a13 * p23
            u3 = a11 * p13 + a12 * p23 + a13 * p33
            c = a11 * u1 + a12 * u2 + a13 * u3 + q1
            p22 += q2
            p33 += q3
            s = c + r
            g = 1.0 / s
            e = y - v
            d = e * g
            v += c * d
            if v < -SPEED_LIMIT_MPS:
                v = -SPEED_LIMIT_MPS
            elif v > SPEED_LIMIT_MPS:
                v = SPEED_LIMIT_MPS
            a += u2 * d
            b += u3 * d
            if a < low1:
                a = low1
            elif a > high1:
                a = high1
            if b < low2:
                b = low2
            elif b > high2:
                b = high2
            h = r * g
            p11 = c * h
            p12 = u2 * h
            p13 = u3 * h
            p22 = max(p22 - u2 * u2 * g, 0.0)
            p23 -= u2 * u3 * g
            p33 = max(p33 - u3 * u3 * g, 0.0)
            if p22 > top1:
                h = sqrt(top1 / p22)
                p22 = top1
                p12 *= h
                p23 *= h
            if p33 > top2:
                h = sqrt(top2 / p33)
                p33 = top2
                p13 *= h
                p23 *= h
            fit += VARIANCE_ALPHA * (e * d - fit)
        theta1[k] = a
        theta2[k] = b
        var1[k] = p22
        var2[k] = p33
        ratio[k] = fit
        innovation[k] = e
    state[0] = v
    state[1] = a
    state[2] = b
    state[3] = p11
    state[4] = p12
    state[5] = p13
    state[6] = p22
    state[7] = p23
    state[8] = p33
    state[9] = fit
    state[10] = first
