"""Dynamic grade observer with a fixed mass (`dgo`): 2014 paper, eqs. 11-13, after McIntyre et al. (2009).

Slips in the paper: eq. 13 as printed equates e' + e, not its derivative, to the right-hand side, and adds
k2 sgn(e), which would drive the error away. With d = phi2 theta2 and the error r = e' + e, the observer
    v^' = phi1 / m + d^,    d^' = (k1 + 1) (e' + e) + k2 sgn(e)
gives r' = d' - (k1 + 1) r - k2 sgn(e) + e', which decays for k2 above the rate of d. That is what runs here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2, STEP_S, EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.bounds import unseen_std_kg
from canest.estimators.chunked import ChunkedEstimator
from canest.estimators.description import Description, option
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack
from canest.estimators.options import Options
from canest.estimators.papers.inverse_mass import GRADE_LIMIT_TEXT
from canest.estimators.papers.kidambi2014.ekf_filter import Rows
from canest.estimators.papers.prior import SQRT12, VARIANCE_ALPHA, prior_mass_kg, prior_mass_std_kg
from canest.estimators.regression import grade_of, grade_std_of, theta2_of, theta2_range
from canest.estimators.sample_hold import rows_until


class DgoOptions(Options):
    """Observer gains."""

    k1: float = option(3.0, "observer gain", unit="1/s", ge=0.0, le=40.0)
    k2: float = option(0.05, "above the fastest change of g sin(β) to follow", unit="m/s³", ge=0.0, le=10.0)
    grade_limit: float = option(0.25, GRADE_LIMIT_TEXT, unit="ratio", gt=0.0, le=1.0)


class Gains(NamedTuple):
    """Gains of the observer and bounds of d^ (m/s2), as the kernel takes them."""

    k1: float
    k2: float
    low: float
    high: float


class Dgo(ChunkedEstimator):
    """Grade from the speed that a vehicle of the given mass should have; the mass is never estimated.

    The grade's standard deviation joins what an error of the assumed mass does (d theta2 = phi1 / g d(1/m))
    and the observer's own velocity error.
    """

    descriptions = (
        Description(
            "dgo",
            "grade observer for a mass that is given",
            "2014, eqs. 11-13",
            needs=("speed", "torque", "estimator.initial_mass_kg (else the middle of the bounds)"),
            options=DgoOptions,
        ),
    )
    estimates_mass = False

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        known = facts.initial_mass_kg is not None
        spread = prior_mass_std_kg(facts)
        self._assume(prior_mass_kg(facts), 0.05 * prior_mass_kg(facts) if known else spread)
        grade = facts.initial_grade or 0.0
        self._held = np.array([[grade], [self.options.grade_limit / SQRT12]])
        theta2 = theta2_of(grade, facts.rolling_resistance)
        # v^, d^, e of the last row, mean square of e, 1 while fresh
        self._state = [0.0, -GRAVITY_MPS2 * theta2, 0.0, 0.0, 1.0]
        self._seen = self._before = False

    def _assume(self, mass_kg: float, std_kg: float) -> None:
        self._mass_kg = min(max(mass_kg, self.facts.mass_min_kg), self.facts.mass_max_kg)
        self._mass_std_kg = std_kg

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:
        """Assume a saved mass."""
        self._assume(mass_kg, math.hypot(mass_std_kg, unseen_std_kg(unseen_s, self.facts)))

    def _update(self, block: ModelBlock) -> EstimateBlock:
        rows, n = Rows(block, self._before), len(block)
        self._before = rows.after
        low, high = theta2_range(self.options.grade_limit)
        out, state = outputs(len(rows.at), 2), state_in(self._state)
        columns = pack(rows.speed, rows.force / self._mass_kg, rows.fresh)
        gains = Gains(self.options.k1, self.options.k2, -GRAVITY_MPS2 * high, -GRAVITY_MPS2 * low)
        observe(*columns, gains, state, *out)
        self._state = state_out(state)
        theta2 = np.clip(unpack(out[0]) / rows.phi2, low, high)
        grade = grade_of(theta2, rows.mu, self.options.grade_limit)
        by_mass = rows.force / GRAVITY_MPS2 * (self._mass_std_kg / self._mass_kg**2)
        by_speed = (self.options.k1 + 1.0) / GRAVITY_MPS2 * np.sqrt(unpack(out[1]))
        std = grade_std_of(grade, theta2, np.sqrt(by_mass * by_mass + by_speed * by_speed))
        numbers = np.concatenate(
            (self._held, np.stack((grade, np.minimum(std, self.options.grade_limit)))), axis=1
        )
        count = rows_until(rows.at, n)
        seen = self._seen | (count > 0)
        self._held, self._seen = numbers[:, -1:], self._seen or len(rows.at) > 0
        status = np.where(seen, Status.CONVERGING, Status.UNESTIMATED).astype(np.uint8)
        mass, mass_std = np.full(n, self._mass_kg), np.full(n, self._mass_std_kg)
        return EstimateBlock(mass, mass_std, numbers[0, count], numbers[1, count], status)


@jit.kernel
def observe(
    speed: Container,
    thrust: Container,
    fresh: Container,
    gains: Gains,
    state: Container,
    road: Container,
    square: Container,
) -> None:
    """The observer, Euler at the tick; thrust is phi1 / m, road is d^ = phi2 theta2, square the mean of e^2.

    e' dt is the difference of e, so d^ needs no derivative. A fresh row (after a gate) sets v^ to the speed.
    """
    v, d, e, s, first = state
    k1, k2, low, high = gains
    for k in range(len(speed)):
        y = speed[k]
        if first > 0.0 or fresh[k] > 0.0:
            first = 0.0
            v = y
            e = 0.0
        else:
            v += STEP_S * (thrust[k] + d)
            now = y - v
            push = (k1 + 1.0) * (now - e + STEP_S * now)
            if now > 0.0:
                push += k2 * STEP_S
            elif now < 0.0:
                push -= k2 * STEP_S
            d += push
            if d < low:
                d = low
            elif d > high:
                d = high
            e = now
            s += VARIANCE_ALPHA * (e * e - s)
        road[k] = d
        square[k] = s
    state[0] = v
    state[1] = d
    state[2] = e
    state[3] = s
    state[4] = first
