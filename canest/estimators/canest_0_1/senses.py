"""What tells of the road beside the driven wheels: an accelerometer, an altitude, a retarder of known force.

Each is heard by each of the two filters; with a closed gate they move the grade alone (see `correct`).
"""

from __future__ import annotations

from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.canest_0_1.filter import correct, widen
from canest.estimators.canest_0_1.noise import surplus
from canest.estimators.canest_0_1.roads import likelihood
from canest.estimators.canest_0_1.states import (
    BIAS,
    FREE,
    GRADE,
    HEIGHT,
    LAST_MPS2,
    PITCH,
    SENSE_LAG,
    SENSED_VAR,
    SLIP,
    WIND,
    Q,
    U,
)
from canest.estimators.windowing import WINDOW_S

Container = Any  #: list interpreted, array compiled

#: an accelerometer is read every so many windows
SEE_EVERY = 2.0
#: its bias wanders with its temperature (0.02 m/s2 in ten minutes), (m/s2)2/s
BIAS_WALK = 6e-7
#: brakes and torque holes pitch the body otherwise than the drive does: share of the acceleration
OTHER_PITCH = 0.1
#: a satellite altitude wanders (2 m in a minute, whether the vehicle moves or not), m2/s; and the std of one
#: reading, m
HEIGHT_WANDER, HEIGHT_STD_M = 0.07, 2.5
#: an altitude this many squared stds from where the road leads has leapt
LEAP = 25.0
#: a retarder's force is known to this share, for as long as it brakes
RETARDER_SHARE, RETARDER_WINDOWS = 0.1, 25.0


@jit.kernel
def feel(
    x: Container, P: Container, w: Container, memory: Container, is_open: bool, sensed: float, a: float,
    motion: float, calm: float, t: float, torque_rate: float,
) -> tuple[float, float]:  # fmt: skip
    """Take what an accelerometer felt; return its log-likelihood and what it was louder than expected.

    a, motion: acceleration, measured and as the filter foretells it. calm: speed without its recent noise.
    t, torque_rate: traction and its rate.
    """
    P[BIAS][BIAS] += BIAS_WALK * SEE_EVERY * WINDOW_S
    r = memory[SENSED_VAR]
    slip = calm * torque_rate + t * motion
    jerk = x[U] * torque_rate
    first = 0
    if not is_open:  # the torque reported in a shift is not that of the wheels
        first = FREE
        jerk = (a - memory[LAST_MPS2]) / WINDOW_S
        r += slip * slip * (x[SLIP] * x[SLIP] + P[SLIP][SLIP])
        r += jerk * jerk * (x[SENSE_LAG] * x[SENSE_LAG] + P[SENSE_LAG][SENSE_LAG])
        r += OTHER_PITCH * OTHER_PITCH * a * a
        jerk = 0.0
    e, s = correct(
        x, P, w, first, sensed - a, r,
        GRADE, GRAVITY_MPS2, BIAS, 1.0, PITCH, motion, SLIP, -slip, SENSE_LAG, -jerk,
    )  # fmt: skip
    return likelihood(e, s), surplus(e, s, r)


@jit.kernel
def climb(x: Container, P: Container, w: Container, is_open: bool, known: bool, altitude: float) -> float:
    """Take an altitude; return its log-likelihood. known: the height before it is."""
    told = 0.0
    r = HEIGHT_STD_M * HEIGHT_STD_M
    e, s = altitude - x[HEIGHT], max(P[HEIGHT][HEIGHT], 0.0) + r
    if known:
        told = likelihood(e, s)
    if known and e * e < LEAP * s:
        correct(
            x, P, w, 0 if is_open else FREE, altitude, r,
            HEIGHT, 1.0, Q, 0.0, Q, 0.0, Q, 0.0, Q, 0.0,
        )  # fmt: skip
    else:  # the first one, or satellites found anew: no road leads there
        widen(P, HEIGHT, r)
        x[HEIGHT] = altitude
    return told


@jit.kernel
def retard(
    x: Container, P: Container, w: Container, force: float, rotating: float, a: float, roll: float,
    drag: float, speed_var: float,
) -> None:  # fmt: skip
    """Take a window in which nothing but a retarder of known force closes the gate."""
    share = RETARDER_SHARE * x[U] * force
    r = 2.0 * speed_var / (WINDOW_S * WINDOW_S) + RETARDER_WINDOWS * share * share
    correct(
        x, P, w, FREE, -a - roll, r,
        GRADE, GRAVITY_MPS2, U, rotating * a - force, WIND, drag, Q, 0.0, Q, 0.0,
    )  # fmt: skip
