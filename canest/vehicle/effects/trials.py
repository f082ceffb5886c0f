"""What an effect needs to know of drives to choose the forms that are worth trying on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf


@dataclass(frozen=True, slots=True)
class Trial:
    """One form of an effect: its first parameter is fitted, the rest of its config entry (shape) is fixed.

    measured_std: standard deviation that a measurement leaves the parameter, infinite without one.
    """

    label: str
    shape: tuple[tuple[str, object], ...] = ()
    measured_std: float = inf


@dataclass(frozen=True, slots=True)
class DrivenData:
    """What some drives of one vehicle hold.

    roles: those of the signal map. mass_kg: known or first estimate. gears: those driven in for long enough
    to be judged, where there are several. temperature_span_K: how far the drives differ in ambient
    temperature. loading_stops_s: middles of the stops in which a load may have changed, on the log's clock.
    switches: role that goes on and off -> the level between. radius_factor: true over declared rolling radius
    as satellites see the vehicle move, None where they do not.
    """

    roles: frozenset[str] = frozenset()
    mass_kg: float = 0.0
    gears: Sequence[int] = ()
    temperature_span_K: float = 0.0
    loading_stops_s: Sequence[float] = ()
    switches: Mapping[str, float] = field(default_factory=dict)
    radius_factor: float | None = None
