"""The driver: a share of every change of torque may answer the road (docs/theory.md, section 7.3)."""

from __future__ import annotations

import math

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants
from canest.estimators.default.model import Mixture, Window

#: mean and variance of a share that is uniform between none and all: nothing to choose
_SHARE, _SHARE_VAR = 0.5, 1.0 / 12.0


@jit.kernel
def draw_answer(mix: Mixture, d: int, left: float, u: float) -> None:
    """Draw the answer anew but for a part that is left: sigma <- left sigma + (1 - left) u / 2 + noise.

    u: mean inverse mass. With its own u a heavy density would expect less noise, and be preferred.
    """
    A, i = mix.A[d], m.ANSWER
    n, part = len(A), (1.0 - left) * _SHARE
    own_var = left * (left * A[i, i] + part * A[m.U, i])
    row = left * A[i] + part * A[m.U]
    row[i] = own_var + part * row[m.U] + (1.0 - left * left) * _SHARE_VAR * u * u
    A[i] = row
    A[:, i] = row[:n]


@jit.kernel
def answered_force(w: Window, is_open: bool, before_N: float) -> float:
    """Return the change of force over a window that may answer the road, N. before_N: the force, or NaN."""
    if is_open:
        return w.traction_N - w.begin_N
    if w.retarding > 0.0 and w.gap_s == 0.0 and not math.isnan(before_N):
        return w.force_N - before_N
    return 0.0


@jit.kernel
def answer_log_likelihood(
    answered_N: float, u: float, metres: float, wander_1pm: float, bend_var: float, c: Constants
) -> float:
    """Return how much less probable a change of torque is where it answers the road.

    What changes faster than a road bends and wanders is the driver's own (docs/theory.md, section 7.3).
    """
    usual = GRAVITY_MPS2 * GRAVITY_MPS2 * (bend_var * metres * metres + 4.0 * wander_1pm * metres)
    ratio = u * u * answered_N * answered_N / (usual + c.answer_noise_mps2 * c.answer_noise_mps2)
    return -min(0.5 * max(ratio - 1.0, 0.0), 30.0)
