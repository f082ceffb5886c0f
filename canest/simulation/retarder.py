"""Engine brakes: the reported one that the driver uses, and the one that nobody reports."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import PEDAL, RECORD_S, RETARDER
from canest.simulation.parameters import RetarderParameters
from canest.simulation.states import BRAKING, TORQUE_PER_FORCE, UNREPORTED, State

# All chosen.
USABLE_RADPS = 100.0  #: engine speed from which the reported engine brake acts
UNREPORTED_RADPS = 95.0  #: engine speed from which the unreported one acts
BUILD_UP_S = 0.15  #: time constant of the reported one
UNREPORTED_S = 0.1  #: time constant of the unreported one
OFF_NM = 1.0  #: a torque below it is none
PEDAL_UP = 0.005  #: an accelerator below it is released


@kernel
def use_retarder(p: RetarderParameters, x: State, missing: float, usable: bool) -> float:
    """Use the reported engine brake for a missing force (N); return what is missing beside it."""
    want = 0.0
    if usable and missing > 0.0:
        per_force = x[TORQUE_PER_FORCE]
        want = min(p.highest, missing * per_force)
        missing -= want / per_force
    torque = x[RETARDER]
    torque += (want - torque) * RECORD_S / BUILD_UP_S
    if torque < OFF_NM and want == 0.0:
        torque = 0.0
    x[RETARDER] = torque
    return missing


@kernel
def use_unreported(p: RetarderParameters, x: State, usable: bool) -> None:
    """Let the unreported engine brake act while its cause is on."""
    want = 0.0
    if usable:
        if x[PEDAL] < PEDAL_UP:
            want = p.pedal_up
        if x[BRAKING]:
            want += p.brake
    torque = x[UNREPORTED]
    x[UNREPORTED] = torque + (want - torque) * RECORD_S / UNREPORTED_S
