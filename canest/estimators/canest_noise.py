"""How `canest` follows its noise levels from the innovations, and keeps the books about them."""

from __future__ import annotations

from typing import Any

from canest import fast
from canest.estimators.canest_filter import OUTLIER
from canest.estimators.canest_states import COUNT, NIS_SUM, POSITIVE, RUNS, SIGN

Container = Any  #: list interpreted, array compiled

#: memory of a noise level in windows, and how many its first guess counts for
NOISE_MEMORY, NOISE_START = 300.0, 10.0


@fast.kernel
def surplus(e: float, s: float) -> float:
    """Return an innovation's square less what the states explain of it, outliers cut."""
    return min(e * e, OUTLIER * s) - s


@fast.kernel
def level(variance: float, surplus: float, floor: float, count: float) -> float:
    """Follow a noise level. The memory grows with the count so far: a wrong first guess is soon forgotten."""
    return max(floor * floor, variance + surplus / min(NOISE_MEMORY, NOISE_START + count))


@fast.kernel
def tally(memory: Container, sign: float, nis: float) -> None:
    """Count the normalised innovation squared, its signs and runs (Wald and Wolfowitz 1940)."""
    memory[COUNT] += 1.0
    memory[NIS_SUM] += nis
    sign = 1.0 if sign > 0.0 else -1.0
    if sign > 0.0:
        memory[POSITIVE] += 1.0
    if sign != memory[SIGN]:
        memory[RUNS] += 1.0
    memory[SIGN] = sign
