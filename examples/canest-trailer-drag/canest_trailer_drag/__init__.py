"""An effect for canest: extra air drag while a trailer is attached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from canest.vehicle.effects import Effect, ModelColumns, Parameter


@dataclass(frozen=True)
class TrailerDrag(Effect):
    """A trailer adds drag area while a signal reports it attached."""

    name: ClassVar[str] = "trailer_drag"
    text: ClassVar[str] = "drag area Cd A added while a trailer is attached"
    parameters: ClassVar[dict[str, Parameter]] = {"cda_delta_m2": Parameter("m2", 0.0, 0.0, 20.0, 0.3)}
    rarity: ClassVar[int] = 85  # commoner than a drag area that is always wrong (90)
    cause_quantity: ClassVar[str] = "speed"
    separated_by: ClassVar[str] = "the same road with and without the trailer"

    cda_delta_m2: float = 0.0
    #: role of the signal map that is above 0.5 while a trailer is attached; in a config its key is `signal`
    on_signal: str = "trailer_attached"

    @property
    def signal(self) -> str:
        """Return the role that reports whether a trailer is attached."""
        return self.on_signal

    def apply(self, c: ModelColumns) -> None:
        """Add to the drag area while the trailer is attached; nothing while nobody knows."""
        c.drag_area_m2 = c.drag_area_m2 + self.cda_delta_m2 * c.on(self.on_signal)

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence. std: of the drag area."""
        return f"a drag area {self.amount(std)} larger while a trailer is attached"
