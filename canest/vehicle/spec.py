"""What the vehicle stage is built from: facts, gates, effects, and which roles there are."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from canest.vehicle.facts import Vehicle
from canest.vehicle.gate_settings import Gates

if TYPE_CHECKING:
    from canest.vehicle.effects import Effect  # two dozen dataclasses, of no use to a vehicle without effects


class AccelerometerSource(NamedTuple):
    """How the longitudinal accelerometer arrives.

    stale_s: age in seconds up to which a sample counts.
    same_message: roles that come in the same message from the same sender, itself included.
    """

    stale_s: float
    same_message: tuple[str, ...] = ("longitudinal_accel",)


class FilterSpec(NamedTuple):
    """The Butterworth low-pass of the regression: order, and -3 dB frequency in Hz."""

    order: int = 2
    cutoff_hz: float = 2.0


class ModelSpec(NamedTuple):
    """Everything that the longitudinal model, its filters and its gates depend on.

    roles: the mapped roles, in the order of the signal map. required: those of them that close the gate
    `stale` by being absent. friction_step_pct: resolution of the reported engine friction (SPN 514) in
    percent, None where nothing reports it. accelerometer: None without one.
    """

    vehicle: Vehicle
    roles: tuple[str, ...]
    gates: Gates
    required: frozenset[str] = frozenset()
    effects: tuple[Effect, ...] = ()
    filter: FilterSpec = FilterSpec()
    friction_step_pct: float | None = None
    accelerometer: AccelerometerSource | None = None

    def with_effects(self, effects: tuple[Effect, ...]) -> ModelSpec:
        """Return the same model with exactly these effects."""
        return self._replace(effects=effects)
