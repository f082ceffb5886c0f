"""Extended Kalman filter with states [v, 1/m, sin(beta + beta_mu)] (`ekf`): 2014 paper, eqs. 6-10.

Slips in the paper, put right here: eq. 5b lacks the minus sign of phi_2 (uphill grade slows down, eq. 2 has
it); "100 tan^-1 beta" for the grade in percent is 100 tan beta; "acausal" processing is causal.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from math import sqrt
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from canest import fast
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.columns import Container, give, room, state_in, state_out, take
from canest.estimators.hold import rows_until
from canest.estimators.options import Options, parse
from canest.estimators.regression import (
    FORCE_LIMIT_N,
    SPEED_LIMIT_MPS,
    grade_of,
    grade_std_of,
    secant,
    theta2_of,
    theta2_range,
    usable,
)
from canest.estimators.runs import Runs
from canest.estimators.status import StatusTracker
from canest.estimators.two_parameter import P_LIMIT, SQRT12, VARIANCE_ALPHA, Box, prior_mass_kg
from canest.frames import FloatColumn, IntColumn
from canest.vehicle.samples import GRAVITY_MPS2, RATE_HZ, STEP_S, EstimateBlock, ModelBlock, VehicleFacts

#: process noise adds up to this many ticks without excitation, then P stays (200 s)
WIND_UP_TICKS = 10_000


class EkfOptions(Options):
    """Options of the filter; Q and R are those of one step at ``rate_hz``."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        #: the paper gives no initial P for the filter; this is the one it gives for RLS
        "2014": {"q": (0.1, 1e-5, 25.0), "r": 100.0, "rate_hz": 30.0, "p0": (0.001, 10.0)},
    }

    #: process noise variances of v, (m/s)^2, of 1/m, 1/kg^2, and of sin(beta + beta_mu)
    q: tuple[float, float, float] = (1e-7, 1e-15, 2e-7)
    #: variance of the measured speed, (m/s)^2
    r: float = Field(1e-3, gt=0.0)
    #: rate that q and r belong to; at another rate the same noise densities hold
    rate_hz: float = Field(RATE_HZ, gt=0.0)
    #: initial variances of 1/m and sin(beta + beta_mu); None: from the spread of the bounds
    p0: tuple[float, float] | None = None
    #: grades beyond this are projected back
    grade_limit: float = Field(0.25, gt=0.0, le=1.0)

    @field_validator("q")
    @classmethod
    def _not_negative(cls, q: tuple[float, float, float]) -> tuple[float, float, float]:
        if min(q) < 0.0:
            raise ValueError("three variances, none negative")
        return q


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
        self._noise = (
            options.q[0] * per_tick,
            options.q[1] * per_tick,
            options.q[2] * per_tick,
            options.r / per_tick,
        )
        self._bounds = (box.low[0], box.high[0], box.low[1], box.high[1])
        # however Q and R are scaled, P may hold the start's doubt and what Q adds while nothing is learned
        added = [q * per_tick * WIND_UP_TICKS for q in options.q[1:]]
        self._top = tuple(
            max(P_LIMIT * b, v, a) for b, v, a in zip(box.variance, variance, added, strict=True)
        )
        # v, theta1, theta2, p11, p12, p13, p22, p23, p33, mean innovation^2 / its variance, 1 while fresh
        self.state = [0.0, *theta, 0.0, 0.0, 0.0, variance[0], 0.0, variance[1], 1.0, 1.0]
        self._runs = Runs()
        if noise_of is not None:
            self.state[9], self._runs = noise_of.state[9], copy(noise_of._runs)

    def run(self, rows: Rows, begin: int, end: int) -> FloatColumn:
        """Take rows begin..end; return what is known after each, shape (5, end - begin).

        theta1, theta2, their variances, and the element of P that belongs to theta1.
        """
        part = slice(begin, end)
        out, state = room(end - begin, 6), state_in(self.state)
        columns = give(rows.speed[part], rows.force[part], rows.aero[part], rows.phi2[part], rows.fresh[part])
        ekf_steps(
            *columns,
            STEP_S,
            *self._noise,
            SPEED_LIMIT_MPS,
            *self._bounds,
            *self._top,
            VARIANCE_ALPHA,
            state,
            *out,
        )
        self.state = state_out(state)
        known = np.stack([take(c) for c in (*out[:4], out[2])])
        known[2:4] *= take(out[4]) * self._runs(take(out[5]))
        return known


class EkfBase(ChunkedEstimator):
    """What `ekf` and `ekf-select` share: options, bounds, start, numbers out."""

    wants_excitation_gate = True
    Options: ClassVar[type[EkfOptions]] = EkfOptions

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self.options: Any = parse(self.Options, options)
        low2, high2 = theta2_range(self.options.grade_limit)
        self.box = Box((1.0 / facts.mass_max_kg, low2), (1.0 / facts.mass_min_kg, high2))
        self._tracker = StatusTracker(bounds_kg=(facts.mass_min_kg, facts.mass_max_kg))
        self._confirmed = self._before = False
        self._begin(prior_mass_kg(facts), None)

    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        grade = self.facts.initial_grade or 0.0
        theta = self.box.clip((1.0 / mass_kg, theta2_of(grade, self.facts.rolling_resistance)))
        variance = self.options.p0 or self.box.variance
        if std_kg is not None:
            variance = (min(variance[0], (std_kg / mass_kg**2) ** 2), variance[1])
        self._start(theta, variance)
        start = np.array([[theta[0]], [theta[1]], [variance[0]], [variance[1]]])
        self._held = self._numbers(start, np.array([self.facts.rolling_resistance]))

    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        raise NotImplementedError

    def _numbers(self, known: FloatColumn, mu: FloatColumn) -> FloatColumn:
        """Return mass, its std, grade, its std from theta and its variances (first order), shape (4, k)."""
        theta1, theta2, var1, var2 = known
        prior1, prior2 = self.box.variance
        std1, std2 = np.sqrt(np.minimum(var1, prior1)), np.sqrt(np.minimum(var2, prior2))
        mass = np.clip(1.0 / theta1, self.facts.mass_min_kg, self.facts.mass_max_kg)
        grade = grade_of(theta2, mu, self.options.grade_limit)
        mass_std = np.minimum(std1 * mass * mass, (self.facts.mass_max_kg - self.facts.mass_min_kg) / SQRT12)
        return np.stack((mass, mass_std, grade, grade_std_of(grade, theta2, std2)))

    def _hold(self, at: IntColumn, numbers: FloatColumn, n: int) -> EstimateBlock:
        """Return one estimate per sample: that of the last row at or before it."""
        all_numbers = np.concatenate((self._held, numbers), axis=1)
        count = rows_until(at, n)
        mass, mass_std, grade, grade_std = all_numbers[:, count]
        learned = self._confirmed | (count > 0)
        self._held = all_numbers[:, -1:]
        self._confirmed = self._confirmed or len(at) > 0
        return EstimateBlock(mass, mass_std, grade, grade_std, self._tracker.update(learned, mass, mass_std))

    def snapshot(self) -> dict[str, Any]:
        """Return the mass and its standard deviation, where there is a confirmed one."""
        mass, std = float(self._held[0, 0]), float(self._held[1, 0])
        return {"mass_kg": mass, "mass_std_kg": std} if self._confirmed else {}

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:
        """Start from a remembered mass and its (already widened) standard deviation."""
        self._begin(mass_kg, mass_std_kg)


class Ekf(EkfBase):
    """One extended Kalman filter; paused while a gate is closed, restarted at the measured speed after it."""

    names = ("ekf",)

    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        self._core = EkfCore(self.options, self.box, theta, variance)

    def _update(self, block: ModelBlock) -> EstimateBlock:
        rows = Rows(block, self._before)
        self._before = rows.after
        known = self._core.run(rows, 0, len(rows.at))
        return self._hold(rows.at, self._numbers(known[:4], rows.mu), len(block))


@fast.kernel
def ekf_steps(
    speed: Container,
    force: Container,
    aero: Container,
    phi2: Container,
    fresh: Container,
    step: float,
    q1: float,
    q2: float,
    q3: float,
    noise: float,
    top_speed: float,
    low1: float,
    high1: float,
    low2: float,
    high2: float,
    top1: float,
    top2: float,
    alpha: float,
    state: Container,
    theta1: Container,
    theta2: Container,
    var1: Container,
    var2: Container,
    ratio: Container,
    innovation: Container,
) -> None:
    """2014, eqs. 7-10: predict by Euler (eq. 8, drag at the filter's speed), correct with H = [1 0 0].

    Jacobian row of v: [1 - Ts theta1 dFaero/dv, Ts phi1, Ts phi2]. A fresh row (after a gate) sets v to the
    measurement and forgets what v had to do with the parameters. `var` is P's diagonal, `ratio` the
    mean of the squared innovations over their predicted variance: their product is the variance, so Q and R
    need only be right in proportion.
    """
    v, a, b, p11, p12, p13, p22, p23, p33, fit, first = state
    for k in range(len(speed)):
        y = speed[k]
        if first > 0.0 or fresh[k] > 0.0:
            first = 0.0
            e = 0.0
            v = y
            p11 = noise
            p12 = 0.0
            p13 = 0.0
        else:
            square = y * y
            if square > 1.0:
                drag = aero[k] / square
                f = force[k] + aero[k] - drag * v * v
                a11 = 1.0 - 2.0 * step * a * drag * v
            else:
                f = force[k]
                a11 = 1.0
            a12 = step * f
            a13 = step * phi2[k]
            v += a12 * a + a13 * b
            u1 = a11 * p11 + a12 * p12 + a13 * p13
            u2 = a11 * p12 + a12 * p22 + a13 * p23
            u3 = a11 * p13 + a12 * p23 + a13 * p33
            c = a11 * u1 + a12 * u2 + a13 * u3 + q1
            p22 += q2
            p33 += q3
            s = c + noise
            g = 1.0 / s
            e = y - v
            d = e * g
            v += c * d
            if v < -top_speed:
                v = -top_speed
            elif v > top_speed:
                v = top_speed
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
            h = noise * g
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
            fit += alpha * (e * d - fit)
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
