"""Does the accelerometer feel what the vehicle does? One that is stuck, inverted or in another unit does not.

The change of its mean from one second to the next, against that of the acceleration that a speed tells: no
torque, mass, grade or bias has a part in it, and a speed's noise hardly any. Pitch adds some tenths.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.estimators.canest_0_1.states import (
    ACCEL_BEFORE,
    ACCEL_SUM,
    DEAF,
    SENSED_BEFORE,
    SENSED_SUM,
    SHAKEN,
    SHAKES,
    SUMMED,
)

Container = Any  #: list interpreted, array compiled

#: a second, in windows; a change of the acceleration that is no noise, m/s2
SECOND, SHAKE_MPS2 = 5.0, 0.2
#: nor is it the rounding of a coarse speed: four times what that makes of a change, sqrt(6) stds a second
ROUNDED_1PS = 10.0
#: squares of changes, (m/s2)2: how many make a judgement, and how many are remembered
FEWEST, MOST = 1.5, 5.0
#: the share of a change that a sound accelerometer feels: 0.8 to 1.1 on trucks and cars, more on soft springs
LEAST_FELT, MOST_FELT = 0.5, 1.6


@jit.kernel
def hears(memory: Container, sensed: float, accel: float, moving: bool, rounding_mps: float) -> bool:
    """Return whether there is an accelerometer to be used, after one more window (its mean, and the speed's).

    sensed: NaN where there is none. moving: fast enough for a speed sensor to tell an acceleration.
    rounding_mps: std of the speed within its resolution.
    """
    known = not math.isnan(sensed)
    if known and moving:
        memory[SENSED_SUM] += sensed
        memory[ACCEL_SUM] += accel
        memory[SUMMED] += 1.0
    else:
        memory[SENSED_SUM] = memory[ACCEL_SUM] = memory[SUMMED] = 0.0
        memory[ACCEL_BEFORE] = math.nan  # the second to come has none before it, and so no change
    if memory[SUMMED] >= SECOND:
        felt, done = memory[SENSED_SUM] / SECOND, memory[ACCEL_SUM] / SECOND
        shake = done - memory[ACCEL_BEFORE]
        if abs(shake) > max(SHAKE_MPS2, ROUNDED_1PS * rounding_mps):
            memory[SHAKES] += shake * shake
            memory[SHAKEN] += shake * (felt - memory[SENSED_BEFORE])
            left = min(MOST / memory[SHAKES], 1.0)
            memory[SHAKES] *= left
            memory[SHAKEN] *= left
            shakes = memory[SHAKES]
            sound = LEAST_FELT * shakes < memory[SHAKEN] < MOST_FELT * shakes
            memory[DEAF] = 0.0 if sound or shakes < FEWEST else 1.0
        memory[SENSED_BEFORE], memory[ACCEL_BEFORE] = felt, done
        memory[SENSED_SUM] = memory[ACCEL_SUM] = memory[SUMMED] = 0.0
    return known and bool(memory[DEAF] == 0.0)
