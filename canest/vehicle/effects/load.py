"""What the vehicle carries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from canest.vehicle.effects.base import Effect, Parameter, Stage, register


@register
@dataclass(frozen=True)
class PayloadChange(Effect):
    """The load changes during a stop: a note for people, no force. An estimate finds the new mass itself."""

    name: ClassVar[str] = "payload_change"
    stage: ClassVar[Stage] = "load"
    text: ClassVar[str] = "mass added at a stop: a note for people, which changes no estimate"
    parameters: ClassVar[dict[str, Parameter]] = {
        "mass_delta_kg": Parameter("kg", 0.0, -100_000.0, 100_000.0, 100.0),
        "t_s": Parameter("s", 0.0, -1e12, 1e12, 1.0),
    }
    mass_delta_kg: float = 0.0
    t_s: float = 0.0
