"""The undriven axle's own small filter: what its speed says about the slip of the driven wheels."""

from __future__ import annotations

from typing import Any

from canest.core import jit
from canest.estimators.canest_0_1.filter import correct
from canest.estimators.canest_0_1.noise import level, surplus
from canest.estimators.canest_0_1.states import AXLE_LAG, AXLE_SCALE, AXLE_SLIP, COUNT, UNDRIVEN_VAR

Container = Any  #: list interpreted, array compiled

#: slip is learned from every so many windows: wheel speeds come at 10 Hz and it changes slowly
UNDRIVEN_EVERY = 5.0


@jit.kernel
def slip_seen(
    y: Container, Y: Container, w: Container, memory: Container, floor: float, v: float, calm: float,
    t: float, a: float,
) -> tuple[float, float]:  # fmt: skip
    """Take v = driven less undriven speed into the axle's filter; return what is new about slip, as z and r.

    Lag and scale of the axle concern nothing else, so its own filter can settle them; what it adds to the
    knowledge of slip is a measurement of slip alone. r is 0 where nothing was added.
    """
    before, mean = Y[AXLE_SLIP][AXLE_SLIP], y[AXLE_SLIP]
    e, s = correct(
        y, Y, w, 0, v, memory[UNDRIVEN_VAR],
        AXLE_SLIP, calm * t, AXLE_LAG, a, AXLE_SCALE, calm, AXLE_SLIP, 0.0, AXLE_SLIP, 0.0,
    )  # fmt: skip
    count = memory[COUNT] / UNDRIVEN_EVERY
    memory[UNDRIVEN_VAR] = level(memory[UNDRIVEN_VAR], surplus(e, s, memory[UNDRIVEN_VAR]), floor, count)
    after = Y[AXLE_SLIP][AXLE_SLIP]
    if after <= 0.0 or before - after < 1e-9 * before:
        return 0.0, 0.0
    r = before * after / (before - after)
    return mean + (y[AXLE_SLIP] - mean) * before / (before - after), r
