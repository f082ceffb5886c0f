"""The driver: what a change of torque says of the road (docs/theory.md, section 7.3)."""

from __future__ import annotations

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.default.constants import Constants
from canest.estimators.default.model import Window


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
def own_torque(fast_N: float, u: float, speed_mps: float, wander_1pm: float, c: Constants) -> float:
    """Return how much less probable a change of torque is where it answers the road (log likelihood).

    In a second a road bends by about `answer_curvature_1pm`, and wanders by two standard deviations at most;
    what moves faster is the driver's own. A free driver may do anything, so slow changes speak for neither.
    """
    metres = max(speed_mps, 1.0)
    bend = c.answer_curvature_1pm * metres
    usual = GRAVITY_MPS2 * GRAVITY_MPS2 * (bend * bend + 4.0 * wander_1pm * metres)
    ratio = u * u * fast_N * fast_N / (usual + c.answer_noise_mps2 * c.answer_noise_mps2)
    return -min(0.5 * max(ratio - 1.0, 0.0), 30.0)
