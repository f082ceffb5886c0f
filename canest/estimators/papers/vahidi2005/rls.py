"""Recursive least squares: one forgetting factor (`rls`), vector-type forgetting (`rls-vector`)."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any, ClassVar, NamedTuple

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.estimators.description import Description, option
from canest.estimators.kernel_arrays import Container, pack, state_in, state_out
from canest.estimators.papers.prior import VARIANCE_ALPHA
from canest.estimators.papers.two_parameter import Known, Limits, TwoParameter, TwoParameterOptions


class RlsOptions(TwoParameterOptions):
    """Options of `rls`."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "2005-figure-3": {"forgetting": 0.8},
        "2005-figure-4": {"forgetting": 0.9},
        "2005-classical": {"forgetting": 1.0},
        "2013": {"forgetting": 0.997},
    }

    forgetting: float = option(0.9995, "λ, weight of a row against the next", gt=0.0, le=1.0)


class RlsVectorOptions(TwoParameterOptions):
    """Options of `rls-vector`.

    Lambda stands on both sides of P in eq. 12, so a factor here is the square root of one in eq. 11.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "2005-simulation": {"forgetting_mass": 1.0, "forgetting_grade": 0.8},
        "2005-experiment": {"forgetting_mass": 0.95, "forgetting_grade": 0.4},
    }

    forgetting_mass: float = option(0.9998, "λ₁, of 1/M", gt=0.0, le=1.0)
    forgetting_grade: float = option(0.998, "λ₂, of sin(β + β_mu)", gt=0.0, le=1.0)


class Scale(NamedTuple):
    """What the elements of P are multiplied with after every row."""

    p11: float
    p12: float
    p22: float


class _MatrixRls(TwoParameter):
    """What both share: a full 2 x 2 covariance, scaled element by element after every row."""

    wants_excitation_gate = True

    def _scale(self) -> Scale:
        """Return what P11, P12 and P22 are multiplied with after an update."""
        raise NotImplementedError

    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        low, high = self.box.low, self.box.high
        self._limits = Limits(low[0], high[0], low[1], high[1], *self._ceiling(p))
        self._state = [*theta, *p, variance]

    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        known, state = Known.empty(len(y)), state_in(self._state)
        matrix_rls(*pack(y, phi1, phi2), self._scale(), self._limits, VARIANCE_ALPHA, state, known)
        self._state = state_out(state)
        return known.columns()


class Rls(_MatrixRls):
    """One forgetting factor: 2005, eqs. 6-8 (lambda 1) and 10-11; 2013, Alg. 6."""

    descriptions = (
        Description(
            "rls",
            "recursive least squares, one forgetting factor",
            "2005, eqs. 6-11; 2013, Alg. 6",
            options=RlsOptions,
        ),
    )

    def _scale(self) -> Scale:
        inverse = 1.0 / self.options.forgetting
        return Scale(inverse, inverse, inverse)


class RlsVector(_MatrixRls):
    """Vector-type forgetting: 2005, eq. 12, P = Lambda^-1 (I - L phi^T) P Lambda^-1, after Saelid and Foss.

    The gain is that of eq. 7 on the P that eq. 12 has already discounted (the form of their paper).
    """

    descriptions = (
        Description("rls-vector", "vector-type forgetting", "2005, eq. 12", options=RlsVectorOptions),
    )

    def _scale(self) -> Scale:
        one, two = self.options.forgetting_mass, self.options.forgetting_grade
        return Scale(1.0 / (one * one), 1.0 / (one * two), 1.0 / (two * two))


@jit.kernel
def matrix_rls(
    y: Container,
    phi1: Container,
    phi2: Container,
    scale: Scale,
    limits: Limits,
    alpha: float,
    state: Container,
    known: Known,
) -> None:
    """2005, eqs. 6-8, 10-12, row by row; the state is theta, P (p11, p12, p22) and the noise variance.

    P is carried as discounted after the last row: with P / lambda for P, eq. 10 becomes eq. 7. `var` is the
    diagonal of P *before* that discount times the noise variance. P is kept below its ceiling by scaling
    a row and its column together, and its determinant above zero: without either, hours without excitation
    end in overflow ("wind-up", section 4.1).
    """
    a, b, p11, p12, p22, s = state
    scale11, scale12, scale22 = scale
    low1, high1, low2, high2, top1, top2 = limits
    theta1, theta2, var1, var2 = known
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
