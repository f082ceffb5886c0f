"""Pitch of the body on its springs: what a body-fixed accelerometer sees besides motion and grade."""

from __future__ import annotations

from canest.core.jit import kernel
from canest.simulation.constants import RECORD_S
from canest.simulation.parameters import PitchParameters
from canest.simulation.states import Pitch

DAMPING_RATIO = 0.35  #: chosen


@kernel
def pitch_after(p: PitchParameters, pitch: Pitch, accel: float) -> Pitch:
    """Return the pitch 5 ms later: x'' = w^2 (gain a - x) - 2 D w x'. accel: m/s2."""
    w = p.natural
    rate = (
        pitch.rate
        + (w * w * (p.gain * accel - pitch.angle) - 2.0 * DAMPING_RATIO * w * pitch.rate) * RECORD_S
    )
    return Pitch(pitch.angle + rate * RECORD_S, rate)
