"""Engine brakes: the reported one that the driver uses, and the one that nobody reports."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import RECORD_S
from canest.simulation.parameters import RetarderParameters
from canest.simulation.states import Pedals

# All chosen.
USABLE_RADPS = 100.0  #: engine speed from which the reported engine brake acts
UNREPORTED_RADPS = 95.0  #: engine speed from which the unreported one acts
BUILD_UP_S = 0.15  #: time constant of the reported one
UNREPORTED_S = 0.1  #: time constant of the unreported one
OFF_NM = 1.0  #: a torque below it is none
PEDAL_UP = 0.005  #: an accelerator below it is released


@kernel
def reported_retarder(
    p: RetarderParameters, torque: float, missing: float, torque_per_force: float, usable: bool
) -> tuple[float, float]:
    """Return the reported engine brake's torque (N m), and the force (N) that is missing beside it."""
    want = 0.0
    if usable and missing > 0.0:
        want = min(p.highest, missing * torque_per_force)
        missing -= want / torque_per_force
    torque += (want - torque) * RECORD_S / BUILD_UP_S
    if torque < OFF_NM and want == 0.0:
        torque = 0.0
    return torque, missing


@kernel
def unreported_retarder(p: RetarderParameters, torque: float, pedals: Pedals, usable: bool) -> float:
    """Return the unreported engine brake's torque (N m)."""
    want = 0.0
    if usable:
        if pedals.accelerator < PEDAL_UP:
            want = p.pedal_up
        if pedals.braking:
            want += p.brake
    return torque + (want - torque) * RECORD_S / UNREPORTED_S
