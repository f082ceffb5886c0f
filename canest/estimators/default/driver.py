"""The driver: what a change of torque says of the road (docs/theory.md, section 7.3).

    g dtheta = s u dF

s: share of the change of torque that answers the road. A driver, or cruise control, that answers it may have
any share between none and all; a normal density with mean and variance of a uniform one stands for that.
Products s u enter linearly, so that is the state.
"""

from __future__ import annotations

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default import model as m
from canest.estimators.default.constants import Constants
from canest.estimators.default.model import Mixture, Window

#: mean and variance of a share that is uniform between none and all: nothing to choose
_SHARE, _SHARE_VAR = 0.5, 1.0 / 12.0


@jit.kernel
def draw_answer(mix: Mixture, d: int, left: float, u: float) -> None:
    """Draw the answer anew but for a part that is left: s u <- left s u + (1 - left) u / 2 + noise.

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
def answered_force(w: Window, is_open: bool, follows: bool, before_N: float) -> float:
    """Return the change of force over a window that a driver may have answered the road with, N.

    follows: whether the force of the window before was known. before_N: that force.
    """
    if is_open:
        return w.traction_N - w.begin_N
    if w.retarding > 0.0 and follows and w.gap_s == 0.0:
        return w.force_N - before_N
    return 0.0


@jit.kernel
def own_torque(
    answered_N: float, u: float, metres: float, wander_1pm: float, bend_var: float, c: Constants
) -> float:
    """Return how much less probable a change of torque is where it answers the road (log likelihood).

    Over so many metres a curved road bends by its usual curvature, and wanders by two stds at most; what
    changes faster is the driver's own. A free driver may do anything, so slow changes speak for neither.
    """
    usual = GRAVITY_MPS2 * GRAVITY_MPS2 * (bend_var * metres * metres + 4.0 * wander_1pm * metres)
    ratio = u * u * answered_N * answered_N / (usual + c.answer_noise_mps2 * c.answer_noise_mps2)
    return -min(0.5 * max(ratio - 1.0, 0.0), 30.0)
