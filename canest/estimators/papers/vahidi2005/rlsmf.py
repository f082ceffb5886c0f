"""Recursive least squares with multiple forgetting, of the 2005 paper (`rlsmf`) and the 2013 one (`rlsmf-n`).

Slips in the 2005 paper: eqs. 15-16 lack the regressor inside the second sum (the normal equations 14 have
it); the recursion 17-23 that follows is right, and it is what runs here. The 25 Hz cut-off of section 5.2
is the Nyquist frequency of its 50 Hz sampling, where no digital Butterworth exists.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.description import Description, option
from canest.estimators.kernel_arrays import Container, pack, state_in, state_out
from canest.estimators.papers.prior import VARIANCE_ALPHA
from canest.estimators.papers.two_parameter import Known, Limits, TwoParameter, TwoParameterOptions


class RlsmfOptions(TwoParameterOptions):
    """Options of both forms."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "2005-simulation": {"forgetting_mass": 1.0, "forgetting_grade": 0.8},
        #: section 5.1 integrates; how far back its t0 is, is not given, so the window is this project's
        "2005-experiment": {
            "forgetting_mass": 0.95,
            "forgetting_grade": 0.4,
            "regression": "integrated",
        },
        "2014": {"forgetting_mass": 0.995, "forgetting_grade": 0.95, "p0": (0.001, 10.0)},
    }

    forgetting_mass: float = option(0.999, "λ₁, of 1/M", gt=0.0, le=1.0)
    forgetting_grade: float = option(0.99, "λ₂, of sin(β + β_mu)", gt=0.0, le=1.0)


class Forgetting(NamedTuple):
    """Whether covariances shrink by the joint gain (2013) or each by its own (2005), and 1 / lambda_i."""

    joint: bool
    inverse1: float
    inverse2: float


class Rlsmf(TwoParameter):
    """Two parameters, two forgetting factors (2005, eqs. 17-23; 2013, Alg. 7), projected (2013, Alg. 8).

    `rlsmf` updates each covariance by its own gain (eqs. 17-18), `rlsmf-n` by the joint gain (Alg. 7,
    line 4); the parameters move by the joint gain L_new (eq. 23) in both.
    """

    descriptions = (
        Description(
            "rlsmf",
            "multiple forgetting, each covariance by its own gain",
            "2005, eqs. 17-23",
            options=RlsmfOptions,
        ),
        Description(
            "rlsmf-n",
            "multiple forgetting, by the joint gain, with parameter projection",
            "2013, Alg. 7 and 8",
            options=RlsmfOptions,
        ),
    )
    wants_excitation_gate = True

    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        o = self.options
        inverse1, inverse2 = 1.0 / o.forgetting_mass, 1.0 / o.forgetting_grade
        self._forgetting = Forgetting(self.name != "rlsmf", inverse1, inverse2)
        low, high, (top1, top2) = self.box.low, self.box.high, self._ceiling(p)
        self._limits = Limits(low[0], high[0], low[1], high[1], top1 * inverse1, top2 * inverse2)
        # the state holds P / lambda, which is what every line of eq. 23 uses
        self._state = [*theta, p[0] * inverse1, p[2] * inverse2, variance]

    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        out, state = Known.empty(len(y)), state_in(self._state)
        forget_each(*pack(y, phi1, phi2), self._forgetting, self._limits, VARIANCE_ALPHA, state, out)
        self._state = state_out(state)
        known = out.columns()
        known[2] *= self.options.forgetting_mass
        known[3] *= self.options.forgetting_grade
        return known


@jit.kernel
def forget_each(
    y: Container,
    phi1: Container,
    phi2: Container,
    forgetting: Forgetting,
    limits: Limits,
    alpha: float,
    state: Container,
    known: Known,
) -> None:
    """2005, eqs. 17-23, row by row, with q_i = P_i / lambda_i carried instead of P_i.

    With w_i = q_i phi_i^2:  L_new = [q_1 phi_1, q_2 phi_2] / (1 + w_1 + w_2)  (eq. 23), and from each own
    gain L_i (eqs. 17, 18), (1 - L_i phi_i) P_i / lambda_i = q_i / (1 + w_i). The step along L_new leaves the
    residual f = e / (1 + w_1 + w_2), so e f estimates the noise variance without bias (as in plain RLS).
    The outputs var_i are q_i times that variance.

    joint: 2013, Alg. 7 for two parameters, P = diag((I - L_new phi^T) P) / lambda (line 4), where
    1 - L_new,i phi_i = (1 + w_j) / (1 + w_1 + w_2): each covariance shrinks less than by its own gain.
    """
    a, b, q1, q2, s = state
    joint, il1, il2 = forgetting
    low1, high1, low2, high2, top1, top2 = limits
    theta1, theta2, var1, var2 = known
    for k in range(len(y)):
        p = phi1[k]
        r = phi2[k]
        u1 = q1 * p
        u2 = q2 * r
        w1 = u1 * p
        w2 = u2 * r
        e = y[k] - p * a - r * b
        d = 1.0 + w1 + w2
        f = e / d
        a += u1 * f
        b += u2 * f
        if a < low1:
            a = low1
        elif a > high1:
            a = high1
        if b < low2:
            b = low2
        elif b > high2:
            b = high2
        q1 = q1 * il1 * (1.0 + w2) / d if joint else q1 * il1 / (1.0 + w1)
        if q1 > top1:  # noqa: PLR1730 - min() costs a call
            q1 = top1
        q2 = q2 * il2 * (1.0 + w1) / d if joint else q2 * il2 / (1.0 + w2)
        if q2 > top2:  # noqa: PLR1730 - min() costs a call
            q2 = top2
        s += alpha * (e * f - s)
        theta1[k] = a
        theta2[k] = b
        var1[k] = q1 * s
        var2[k] = q2 * s
    state[0] = a
    state[1] = b
    state[2] = q1
    state[3] = q2
    state[4] = s
