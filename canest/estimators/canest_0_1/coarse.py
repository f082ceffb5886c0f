"""The road while force is too coarse to learn mass from: a driveline that swings after a shift, a bend.

Learning from such windows would bend the mass, so the filter does not. But its grade goes on from before the
gate closed, unsure by the metre, and soon even a coarse force says more. So a second, scalar estimate of the
grade follows the filter's, takes the coarse windows, and is given out as long as it is the surer of the two.
"""

from __future__ import annotations

from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.canest_0_1.filter import OUTLIER
from canest.estimators.canest_0_1.prior import ROLLING_SHARE_STD
from canest.estimators.canest_0_1.states import COARSE_GRADE, COARSE_VAR, LAST_GRADE, LAST_VAR
from canest.estimators.windowing import WINDOW_S

Container = Any  #: list interpreted, array compiled

#: the force is known to this share, and its error lasts this many windows
COARSE_SHARE, COARSE_WINDOWS = 0.1, 5.0
#: what a bend brakes is as wrong from its beginning to its end
BEND_WINDOWS = 25.0

#: where the filter learns again the coarse estimate soon counts no more: its variance doubles in every window
FORGETS = 2.0


@jit.kernel
def coarse_grade(
    u: float, u_var: float, wind: float, force: float, rotating: float, a: float, roll: float, drag: float,
    bend: float, speed_var: float,
) -> tuple[float, float]:  # fmt: skip
    """Return what a window's force says of the grade, given inverse mass and wind, and its variance."""
    lever = force - rotating * a
    lacks, rolls = COARSE_SHARE * u * force, ROLLING_SHARE_STD * roll
    shared = lacks * lacks + rolls * rolls + lever * lever * u_var
    var = 2.0 * speed_var / (WINDOW_S * WINDOW_S) + COARSE_WINDOWS * shared + BEND_WINDOWS * bend * bend
    return (lever * u - a - roll - drag * wind) / GRAVITY_MPS2, var / (GRAVITY_MPS2 * GRAVITY_MPS2)


@jit.kernel
def surer(
    memory: Container, grade: float, var: float, is_open: bool, seen: float, seen_var: float
) -> tuple[float, float]:
    """Return the surer of the filter's grade (variance var) and the coarse one, with its variance.

    seen: what this window's coarse force says of the grade; seen_var: its variance, 0 where it says nothing.
    """
    if is_open:
        memory[COARSE_VAR] *= FORGETS
    else:
        memory[COARSE_GRADE] += grade - memory[LAST_GRADE]
        memory[COARSE_VAR] += max(var - memory[LAST_VAR], 0.0)
    memory[LAST_GRADE], memory[LAST_VAR] = grade, var
    if seen_var > 0.0:
        e = seen - memory[COARSE_GRADE]
        gain = memory[COARSE_VAR] / max(memory[COARSE_VAR] + seen_var, e * e / OUTLIER)
        memory[COARSE_GRADE] += gain * e
        memory[COARSE_VAR] -= gain * memory[COARSE_VAR]
    if memory[COARSE_VAR] >= var:
        memory[COARSE_GRADE], memory[COARSE_VAR] = grade, var
    return memory[COARSE_GRADE], memory[COARSE_VAR]
