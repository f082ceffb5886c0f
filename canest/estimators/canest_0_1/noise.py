"""How `canest` follows its noise levels from the innovations, and keeps the books about them."""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.estimators.canest_0_1.filter import OUTLIER
from canest.estimators.canest_0_1.states import COUNT, NIS_SUM, POSITIVE, RINGING, RUNS, SIGN, SWING_VAR
from canest.estimators.windowing import WINDOW_S

Container = Any  #: list interpreted, array compiled

#: memory of a noise level in windows, and how many its first guess counts for
NOISE_MEMORY, NOISE_START = 300.0, 10.0
#: what rotates swings against the vehicle after a shove of torque: m/s per N and per share that it has of
#: the mass, at first, and bounds. Half-shafts of 150 kNm/rad: 1e-5 in first gear, torque coming at once
SWING_MPN, LEAST_SWING_MPN, MOST_SWING_MPN = 1e-6, 3e-7, 1e-5
#: how much of the swing's energy is left a window later
RINGS = 0.75
#: an innovation this many times larger than the noise, by what the states are in doubt, tells less of it
DOUBTED = 5.0

#: gusts: m/s, and how long they last
GUST_MPS, GUST_S = 0.15, 5.0
#: force that the model lacks: share of the traction, correlated over this time (torque holes, oscillation);
#: more in overrun, where friction torque is coarse and brakes blend in
FORCE_SHARE, OVERRUN_SHARE, FORCE_S = 0.02, 0.1, 0.2
#: reported torque is rounded, and the rounding error stays until the torque has moved on by a step
STEP_STD, LONGEST_WINDOWS = math.sqrt(12.0), 25.0


@jit.kernel
def unknown_force(t: float, moved: float, step: float, drag: float) -> float:
    """Return the density of the force that the model lacks, N2 s.

    t: traction, and by how much it moved in this window. step: std of it within the torque's resolution.
    drag: aerodynamic force per m/s of wind.
    """
    lasts = min(max(STEP_STD * step / max(moved, 1.0), 1.0), LONGEST_WINDOWS) * WINDOW_S
    lacking = FORCE_SHARE * t if t > 0.0 else -OVERRUN_SHARE * t
    gust = GUST_MPS * drag
    unknown: float = lacking * lacking * FORCE_S + 2.0 * (step * step * lasts + gust * gust * GUST_S)
    return unknown


@jit.kernel
def surplus(e: float, s: float, r: float) -> float:
    """Return an innovation's square less what is expected of it, outliers cut.

    s: its variance; r: the noise in it. Where it is mostly the states' doubt, as in the first windows of
    a new load, it counts by what noise is in it, or one such window would call every noise nothing.
    """
    share = min(DOUBTED * r / s, 1.0)
    return share * (min(e * e, OUTLIER * s) - s)


@jit.kernel
def level(variance: float, surplus: float, floor: float, count: float) -> float:
    """Follow a noise level. The memory grows with the count so far: a wrong first guess is soon forgotten."""
    return max(floor * floor, variance + surplus / min(NOISE_MEMORY, NOISE_START + count))


@jit.kernel
def ring(memory: Container, shove: float, share: float) -> float:
    """Return what the variance of a swinging driveline's speed is proportional to, N2, after one more window.

    shove: change of the traction (N); share: of what rotates in the mass, small in high gears.
    """
    memory[RINGING] = RINGS * memory[RINGING] + shove * shove
    rings: float = share * share * memory[RINGING]
    return rings


@jit.kernel
def follow_swing(memory: Container, surplus: float) -> None:
    """Follow how much this driveline swings. surplus: by `ring`, where that is most of the noise."""
    swing = level(memory[SWING_VAR], surplus, LEAST_SWING_MPN, NOISE_MEMORY)
    memory[SWING_VAR] = min(swing, MOST_SWING_MPN * MOST_SWING_MPN)


@jit.kernel
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
