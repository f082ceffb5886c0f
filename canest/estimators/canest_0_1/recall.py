"""Is it the load from before? After a long stop the vehicle may carry another, and mostly does not.

The filter opens its load there and learns it anew, as if nothing were known. What it has found since, with
its doubt, is a measurement: how well the load from before foretold it, and how well any other would have, are
the odds (Bayes' factor). What is given out is the likelier of the two, with the doubt that the other leaves.
"""

from __future__ import annotations

import math
from typing import Any

from canest.core import jit
from canest.estimators.canest_0_1.doubt import untold
from canest.estimators.canest_0_1.states import (
    GIVEN_VAR,
    HELD_U,
    LEARNED,
    LEFT,
    OUT_U,
    OUT_U_VAR,
    OUT_UNTOLD,
    SAME_U,
    SAME_VAR,
)

Container = Any  #: list interpreted, array compiled

#: what is called the same load may be a little another: some passengers, a pallet; share of the mass, std
LITTLE = 0.03
#: and another one mostly differs by this share: loads as different as can be would make any other unlikely as
#: long as little is known, and a small change would pass for none (Lindley's paradox)
ANOTHER = 0.4


@jit.kernel
def remember(memory: Container) -> None:
    """Remember the load that is given out, for it may become another; what is not compared yet stays."""
    if memory[LEARNED] > 0.0 and not (memory[SAME_VAR] > 0.0 and memory[LEFT] == 1.0):
        little = LITTLE * memory[HELD_U]
        memory[SAME_U], memory[SAME_VAR] = memory[HELD_U], memory[GIVEN_VAR] + little * little
        memory[LEFT] = 1.0


@jit.kernel
def refute(memory: Container) -> None:
    """Forget the load from before: it is another, or was learned with what is not believed any more."""
    memory[SAME_VAR], memory[LEFT] = 0.0, 1.0


@jit.kernel
def compare(memory: Container, u: float, u_var: float, any_var: float) -> None:
    """Compare the load from before with any other, and hold the likelier.

    u, u_var: what has been found of the inverse mass since the stop. any_var: its variance when nothing is
    known.
    """
    if memory[SAME_VAR] == 0.0:
        return
    apart, var = u - memory[SAME_U], memory[SAME_VAR]
    another = ANOTHER * memory[SAME_U]
    any_var = min(any_var, another * another)
    both = u_var + var
    either = both + any_var
    odds = math.sqrt(either / both) * math.exp(0.5 * apart * apart * (1.0 / either - 1.0 / both))
    # what both tell, if it is the same
    gain = var / both
    joint, joint_var = memory[SAME_U] + gain * apart, gain * u_var
    beside = (u - joint) * (u - joint)
    given_var = (u_var + odds * (joint_var + beside)) / (1.0 + odds)
    if odds > 1.0:
        memory[HELD_U] = joint
        # a load that is a little another looks the same for long: all that is between them stays in doubt
        given_var = (u_var + odds * joint_var) / (1.0 + odds) + beside
    memory[LEFT] = given_var / u_var


@jit.kernel
def give_mass(memory: Container, row: Container, mean: float, is_open: bool, any_var: float) -> None:
    """Put the inverse mass that is given out into an output row, with the variance of all that is in doubt.

    mean: of what the filter alone knows; the row has the variance of that. any_var: as in `compare`.
    """
    share = untold(memory)
    u_var = row[OUT_U_VAR] + share * share * mean * mean
    if is_open:
        compare(memory, mean, u_var, any_var)
    row[OUT_U], row[OUT_UNTOLD] = memory[HELD_U], share
    row[OUT_U_VAR] = memory[GIVEN_VAR] = memory[LEFT] * u_var
