"""Pitch of the body on its springs: what a body-fixed accelerometer sees besides motion and grade."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import PITCH, RECORD_S
from canest.simulation.parameters import PitchParameters
from canest.simulation.states import PITCH_RATE, State

DAMPING_RATIO = 0.35  #: chosen


@kernel
def pitch_body(p: PitchParameters, x: State, accel: float) -> None:
    """Pitch for 5 ms: y'' = w^2 (gain a - y) - 2 D w y'. accel: m/s2."""
    w = p.natural
    pitch = x[PITCH]
    rate = x[PITCH_RATE]
    rate = rate + (w * w * (p.gain * accel - pitch) - 2.0 * DAMPING_RATIO * w * rate) * RECORD_S
    x[PITCH] = pitch + rate * RECORD_S
    x[PITCH_RATE] = rate
