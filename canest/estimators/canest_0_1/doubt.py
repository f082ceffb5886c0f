"""What torque has told of the mass, and what makes the mass doubtful again.

Under a steady hand force follows the road, and no filter can tell mass and grade apart by itself. So the
effort is kept beside the filter: how much the driver's own torque has moved, beyond what a crest brings.
"""

from __future__ import annotations

from typing import Any

from canest.core import jit
from canest.core.samples import GRAVITY_MPS2
from canest.estimators.canest_0_1.states import (
    BEFORE_U,
    BIASED,
    DEAF,
    EFFORT,
    FELT,
    HELD_U,
    HERE_EFFORT,
    HERE_M,
    LASTED_S,
    LASTING_U,
    LEARNED,
    SINCE_STOOD_M,
    SLOW_N,
    STANDING_S,
    STEADY_N,
    SURPRISED_M,
)
from canest.estimators.windowing import WINDOW_S

Container = Any  #: list interpreted, array compiled

#: forces that change within this time are the engine's, not the road's; with an accelerometer, which feels
#: the road, those that change faster than its bias
ROAD_S, BIAS_S = 1.0, 10.0
#: ordinary crests and the sharpest, in stds of a curvature
ORDINARY, CREST = 0.5, 2.0
#: a crest or sag is so long, m: on one such stretch force may happen to follow the road, so it is credited
#: with no more effort than this, m2/s3, whatever the driver does (two stretches are two witnesses)
HILL_M, HILL_EFFORT = 200.0, 0.12
#: share of the mass left in doubt is this by the effort (m2/s3): half of it on a motorway at one speed,
#: however long, 1 % after two or three launches; and the same by what an accelerometer has felt
UNTOLD_MPS2, UNFELT_MPS2 = 0.005, 0.02
#: slow torque leaves at least this share in doubt, whatever an accelerometer feels, so that it alone is never
#: trusted: one crest taken for a straight while the driver eases off is enough
LEAST_UNFELT = 0.045
#: share of the mass in doubt where nothing speaks for it
UNBELIEVED = 0.5
#: memory of the innovations' sign, in windows; one innovation counts for so many stds at most
SIGN_MEMORY, CLIP = 15.0, 5.0
#: innovations this one-signed for seconds lean; more so, they surprise
LEANING, ONE_SIGNED = 0.5, 1.5
#: a load that is another than before, by this share, has to prove itself for so long, s
ANOTHER, PROOF_S = 0.045, 60.0
#: who is surprised within this distance of another time, or of a stop, carries another load, m
AGAIN_M = 1000.0
#: a vehicle that has stood this long may have been coupled or tipped, and creeps this far while that is done
STOP_S, CREEP_M = 3.0, 10.0


@jit.kernel
def steady_hand(memory: Container, u: float, force: float, steepens_1ps: float) -> bool:
    """Return whether a window's force (N) has changed no more than an ordinary crest asks for.

    u: inverse mass, 1/kg. steepens_1ps: how fast the grade changes on a usual crest, 1/s.
    """
    brisk = u * (force - memory[STEADY_N])
    crest = ORDINARY * GRAVITY_MPS2 * steepens_1ps * ROAD_S
    return bool(brisk * brisk < crest * crest)


@jit.kernel
def begin_stretch(memory: Container) -> None:
    """From here on what the driver does is another witness."""
    memory[HERE_M] = memory[HERE_EFFORT] = 0.0


@jit.kernel
def credit(
    memory: Container, u: float, force: float, steepens_1ps: float, first: bool, feels: bool, ds: float
) -> None:
    """Credit the mass with what a window's force tells of it (what u learns meanwhile is no effort).

    As above; first: of all windows. feels: an accelerometer feels the road. ds: metres of the window.
    """
    memory[HERE_M] += ds
    if memory[HERE_M] > HILL_M:
        begin_stretch(memory)
    if first:
        memory[STEADY_N] = memory[SLOW_N] = force
    crest = CREST * GRAVITY_MPS2 * steepens_1ps * ROAD_S
    brisk, slow = force - memory[STEADY_N], force - memory[SLOW_N]
    memory[STEADY_N] += brisk * WINDOW_S / ROAD_S
    memory[SLOW_N] += slow * WINDOW_S / BIAS_S
    brisk, slow = u * brisk, u * slow
    effort = max(brisk * brisk - crest * crest, 0.0) * WINDOW_S
    if not feels:
        effort = min(effort, HILL_EFFORT - memory[HERE_EFFORT])
        memory[HERE_EFFORT] += effort
    memory[EFFORT] += effort
    if feels:
        memory[FELT] += slow * slow * WINDOW_S


@jit.kernel
def untold(memory: Container) -> float:
    """Return the share of the mass that is in doubt because torque has told too little of it."""
    if memory[DEAF] > 0.0:  # what it told is in all that was learned
        return UNBELIEVED
    brisk = UNTOLD_MPS2 / max(memory[EFFORT], 1e-9)
    felt = max(UNFELT_MPS2 / max(memory[FELT], 1e-9), LEAST_UNFELT)
    share: float = min(brisk, felt, UNBELIEVED)
    return share


@jit.kernel
def last(memory: Container, u: float) -> None:
    """Count how long the inverse mass u has lasted, a window with open gates more; another begins anew."""
    if abs(u - memory[LASTING_U]) > ANOTHER * memory[LASTING_U]:
        memory[LASTING_U] = u
        memory[LASTED_S] = 0.0
    memory[LASTED_S] += WINDOW_S


@jit.kernel
def proven(memory: Container) -> float:
    """Return 0 for another mass than the one before a long stop, as long as it has not lasted, else 1."""
    before = memory[BEFORE_U]
    same = before == 0.0 or abs(memory[HELD_U] - before) < ANOTHER * before
    return 1.0 if same or memory[LASTED_S] >= PROOF_S else 0.0


@jit.kernel
def forget(memory: Container) -> None:
    """Forget what torque has told of the mass."""
    memory[EFFORT] = memory[FELT] = memory[HERE_M] = memory[HERE_EFFORT] = 0.0


@jit.kernel
def stand(memory: Container, gap_s: float, still: bool, ds: float) -> float:
    """Return how long the vehicle has stood, creeping included. gap_s: time missing before this window."""
    standing: float = memory[STANDING_S] + gap_s + (WINDOW_S if still else 0.0)
    memory[SINCE_STOOD_M] = 0.0 if still or gap_s > 0.0 else memory[SINCE_STOOD_M] + ds
    memory[STANDING_S] = standing if memory[SINCE_STOOD_M] <= CREEP_M else 0.0
    if standing > STOP_S:  # whoever is surprised soon after a stop carries another load
        memory[SURPRISED_M] = 0.0
    return standing


@jit.kernel
def unload(memory: Container) -> None:
    """Forget what torque has told: the vehicle may carry another load, which has to prove itself.

    Measured by the mass that had lasted, or by the first one, though that was known for less than `PROOF_S`.
    """
    forget(memory)
    if memory[LASTED_S] >= PROOF_S or (memory[BEFORE_U] == 0.0 and memory[LEARNED] > 0.0):
        memory[BEFORE_U] = memory[HELD_U]


@jit.kernel
def follow(memory: Container, bias: float) -> None:
    """Follow the sign of the innovations. bias: the newest one, in its stds."""
    memory[BIASED] += (min(max(bias, -CLIP), CLIP) - memory[BIASED]) / SIGN_MEMORY


@jit.kernel
def leans(memory: Container, traction: float) -> bool:
    """Return whether innovations lean to one side: road or load is not what either filter takes it for.

    What follows from it is not known yet, least of all for the mass. In overrun nobody counts (see `follow`).
    """
    return bool(traction > 0.0 and abs(memory[BIASED]) > LEANING)


@jit.kernel
def surprise(memory: Container, ds: float) -> tuple[bool, bool]:
    """Return whether the innovations have been one-signed for too long, and whether it is the load.

    ds: metres since the window before. Once, it may be a sharper crest than roads have; within `AGAIN_M` of
    another time or of a stop, the load is another and what was told of it is void.
    """
    memory[SURPRISED_M] += ds
    surprised = abs(memory[BIASED]) > ONE_SIGNED
    again = surprised and memory[SURPRISED_M] < AGAIN_M
    if surprised:
        memory[BIASED] = memory[SURPRISED_M] = 0.0
    if again:
        unload(memory)
    return surprised, again
