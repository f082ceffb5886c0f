"""Grade from accelerometer and speed alone (2014 paper, eq. 3 and PMG): no force needed, no gate."""

from __future__ import annotations

from math import exp

import numpy as np

from canest.core import jit
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, STEP_S, ModelBlock
from canest.estimators.kernel_arrays import Container, outputs, pack, state_in, state_out, unpack
from canest.estimators.regression import ACCEL_LIMIT_MPS2


def has_accelerometer(block: ModelBlock) -> BoolColumn:
    """Return True where accelerometer and speed can be used together; the driveline does not matter."""
    good: BoolColumn = (
        block.ax_ok
        & (np.abs(block.accelerometer_mps2) < ACCEL_LIMIT_MPS2)
        & (np.abs(block.accel_mps2) < ACCEL_LIMIT_MPS2)
    )
    return good


class KinematicGrade:
    """sin(beta) = (a_x - dv/dt) / g less the body's pitch, as an average weighted by how calm the signal is.

    The weight of a sample is 1 / (calm^2 + s^2) with s^2 the variance of the raw grade over the last
    ``buffer_s`` (large: bounce and pitch); weights fade over ``memory_s``. The paper leaves pitch out and
    shows how a correction would look (proportional to the acceleration); here it is.
    """

    def __init__(self, pitch_rad_per_mps2: float, buffer_s: float, memory_s: float, calm: float) -> None:
        self._pitch, self._calm2 = pitch_rad_per_mps2, calm * calm
        self._buffer, self._keep = STEP_S / buffer_s, exp(-STEP_S / memory_s)
        # mean and variance of the raw grade, weighted sum of it, of its square and of the weights
        self._state = [0.0, 0.0, 0.0, 0.0, 0.0]

    def __call__(self, block: ModelBlock) -> tuple[IntColumn, FloatColumn, FloatColumn]:
        """Return positions (k,), sin(beta) (k,) and its variance (k,) where they are known."""
        at = np.flatnonzero(has_accelerometer(block))
        raw = (block.accelerometer_mps2[at] - block.accel_mps2[at]) / GRAVITY_MPS2
        raw = np.clip(raw - self._pitch * block.accel_mps2[at], -1.0, 1.0)
        out, state = outputs(len(at), 2), state_in(self._state)
        calm_average(*pack(raw), self._buffer, self._keep, self._calm2, state, *out)
        self._state = state_out(state)
        return at, unpack(out[0]), unpack(out[1])


@jit.kernel
def calm_average(
    raw: Container,
    buffer: float,
    keep: float,
    calm2: float,
    state: Container,
    sine: Container,
    variance: Container,
) -> None:
    """Weighted moving average and the weighted variance about it; the first sample starts the moments."""
    mean, var, total, squares, weights = state
    for k in range(len(raw)):
        x = raw[k]
        if weights == 0.0:
            mean = x
        d = x - mean
        mean += buffer * d
        var = (1.0 - buffer) * (var + buffer * d * d)
        w = 1.0 / (calm2 + var)
        total = keep * total + w * x
        squares = keep * squares + w * x * x
        weights = keep * weights + w
        average = total / weights
        sine[k] = average
        variance[k] = max(squares / weights - average * average, 0.0)
    state[0] = mean
    state[1] = var
    state[2] = total
    state[3] = squares
    state[4] = weights
