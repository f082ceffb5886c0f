"""Recursive least squares: one forgetting factor (`rls`), vector-type forgetting (`rls-vector`)."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.kernel_arrays import Container, give, room, state_in, state_out, take
from canest.estimators.papers.two_parameter import (
    P_LIMIT,
    PRIOR_NOISE_MPS2,
    VARIANCE_ALPHA,
    TwoParameter,
    TwoParameterOptions,
)


class RlsOptions(TwoParameterOptions):
    """Options of `rls`."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "2005-figure-3": {"forgetting": 0.8},
        "2005-figure-4": {"forgetting": 0.9},
        "2005-classical": {"forgetting": 1.0},
        "2013": {"forgetting": 0.997},
    }

    #: lambda, weight of a row against the next
    forgetting: float = Field(0.9995, gt=0.0, le=1.0)


class RlsVectorOptions(TwoParameterOptions):
    """Options of `rls-vector`.

    Lambda stands on both sides of P in eq. 12, so a factor here is the square root of one in eq. 11.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "2005-simulation": {"forgetting_mass": 1.0, "forgetting_grade": 0.8},
        "2005-experiment": {"forgetting_mass": 0.95, "forgetting_grade": 0.4},
    }

    #: lambda_1, of 1/M
    forgetting_mass: float = Field(0.9998, gt=0.0, le=1.0)
    #: lambda_2, of sin(beta + beta_mu)
    forgetting_grade: float = Field(0.998, gt=0.0, le=1.0)


class _MatrixRls(TwoParameter):
    """What both share: a full 2 x 2 covariance, scaled element by element after every row."""

    wants_excitation_gate = True

    def _scale(self) -> tuple[float, float, float]:
        """Return what P11, P12 and P22 are multiplied with after an update."""
        raise NotImplementedError

    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        limit = [P_LIMIT * v / PRIOR_NOISE_MPS2**2 for v in self.box.variance]
        self._ceiling = (max(limit[0], p[0]), max(limit[1], p[2]))
        self._state = [*theta, *p, variance]

    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        out, state = room(len(y), 4), state_in(self._state)
        bounds = (self.box.low[0], self.box.high[0], self.box.low[1], self.box.high[1])
        matrix_rls(*give(y, phi1, phi2), *self._scale(), *bounds, *self._ceiling, VARIANCE_ALPHA, state, *out)
        self._state = state_out(state)
        return np.stack([take(c) for c in out])


class Rls(_MatrixRls):
    """One forgetting factor: 2005, eqs. 6-8 (lambda 1) and 10-11; 2013, Alg. 6."""

    names = ("rls",)
    Options = RlsOptions

    def _scale(self) -> tuple[float, float, float]:
        inverse = 1.0 / self.options.forgetting
        return inverse, inverse, inverse


class RlsVector(_MatrixRls):
    """Vector-type forgetting: 2005, eq. 12, P = Lambda^-1 (I - L phi^T) P Lambda^-1, after Saelid and Foss.

    The gain is that of eq. 7 on the P that eq. 12 has already discounted (the form of their paper).
    """

    names = ("rls-vector",)
    Options = RlsVectorOptions

    def _scale(self) -> tuple[float, float, float]:
        one, two = self.options.forgetting_mass, self.options.forgetting_grade
        return 1.0 / (one * one), 1.0 / (one * two), 1.0 / (two * two)


@jit.kernel
def matrix_rls(
    y: Container,
    phi1: Container,
    phi2: Container,
    scale11: float,
    scale12: float,
    scale22: float,
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
) -> None:
    """2005, eqs. 6-8, 10-12, row by row; the state is theta, P (p11, p12, p22) and the noise variance.

    P is carried as discounted after the last row: with P / lambda for P, eq. 10 becomes eq. 7. `var` is the
    diagonal of P *before* that discount times the noise variance. P is kept below its ceiling by scaling
    a row and its column together, and its determinant above zero: without either, hours without excitation
    end in overflow ("wind-up", section 4.1).
    """
    a, b, p11, p12, p22, s = state
    for k in range(len(y)):
        p = phi1[k]
        r = phi2[k]
        u1 = p11 * p + p12 * r
        u2 = p12 * p + p22 * r
        d = 1.0 / (1.0 + p * u1 + r * u2)
        e = y[k] - p * a - r * b
        f = e * d
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
        p11 -= u1 * u1 * d
        p12 -= u1 * u2 * d
        p22 -= u2 * u2 * d
        s += alpha * (e * f - s)
        # cancellation may leave a tiny negative number where a tiny positive one belongs
        if p11 < 0.0:  # noqa: PLR1730 - max() costs a call
            p11 = 0.0
        if p22 < 0.0:  # noqa: PLR1730 - max() costs a call
            p22 = 0.0
        theta1[k] = a
        theta2[k] = b
        var1[k] = p11 * s
        var2[k] = p22 * s
        p11 *= scale11
        p12 *= scale12
        p22 *= scale22
        if p11 > top1:
            p12 *= sqrt(top1 / p11)
            p11 = top1
        if p22 > top2:
            p12 *= sqrt(top2 / p22)
            p22 = top2
        if p12 * p12 > p11 * p22:
            p12 = sqrt(p11 * p22) if p12 > 0.0 else -sqrt(p11 * p22)
    state[0] = a
    state[1] = b
    state[2] = p11
    state[3] = p12
    state[4] = p22
    state[5] = s
