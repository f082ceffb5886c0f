"""A load leg: the driving between two stops in which the load may have changed, and what it weighed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from canest.core.samples import STATUS_LABELS, Status

#: a mass with a standard deviation of up to this share of it can be compared with another
KNOWN = 0.10
_VALID = STATUS_LABELS[Status.VALID]


@dataclass(frozen=True, slots=True)
class Leg:
    """The driving with one load; a row of the fleet's table.

    from_s, to_s: first and last moving sample, seconds of the log's clock.
    mass_kg, mass_std_kg: while `status` is "valid" of the leg's last valid sample (of legs that were merged:
        of the one whose std is least); else of its last estimate, not to be trusted; None without any.
    mass_t_s: the time of that sample.
    valid_share: share of `driving_s` in which the status was valid, 0 to 1.
    distance_m, climb_m: way driven, and the sum of the rises that the estimated grade makes of it.
    driving_s: time in motion. stops: pauses of `SHORTEST_STOP_S` or longer within the leg.
    status: "valid", "converging" or "unestimated": the best that was reached.
    load: 1 for the first leg with a valid mass, 2 for the next, None without a valid mass.
    true_mass_kg, mass_error_pct: the truth at `mass_t_s`, and the error there; None where nobody knows.
    reported_kg: what other controllers reported meanwhile: sender -> median, kg.
    passed_us: first and last moving sample, us, as time goes on where the clock was set back; not in JSON.
    """

    from_s: float
    to_s: float
    mass_kg: float | None
    mass_std_kg: float | None
    valid_share: float
    mass_t_s: float | None = None
    distance_m: float = 0.0
    climb_m: float = 0.0
    driving_s: float = 0.0
    stops: int = 0
    status: str = STATUS_LABELS[Status.UNESTIMATED]
    load: int | None = None
    true_mass_kg: float | None = None
    mass_error_pct: float | None = None
    reported_kg: Mapping[str, float] = field(default_factory=dict)
    passed_us: tuple[int, int] = (0, 0)

    @property
    def is_valid(self) -> bool:
        """Return whether the leg has a valid mass."""
        return self.status == _VALID

    @property
    def is_known(self) -> bool:
        """Return whether its mass can be compared with another's."""
        return self.mass_kg is not None and (self.mass_std_kg or math.inf) <= KNOWN * self.mass_kg

    def to_json(self) -> dict[str, Any]:
        """Return all fields by name, as JSON types, numbers to three decimals."""
        fields = asdict(self)
        del fields["passed_us"]
        return {name: round(v, 3) if isinstance(v, float) else v for name, v in fields.items()}

    def with_truth(self, mass_kg: float) -> Leg:
        """Return the leg with what it truly weighed (kg, NaN for unknown)."""
        if not math.isfinite(mass_kg) or mass_kg <= 0.0:
            return self
        error_pct = None if self.mass_kg is None else 100.0 * (self.mass_kg / mass_kg - 1.0)
        return replace(self, true_mass_kg=mass_kg, mass_error_pct=error_pct)


def load_legs(parts: Sequence[Leg]) -> list[Leg]:
    """Merge neighbours that carry one load, and number the loads; in order of time.

    Two legs carry one load where their masses agree within their standard deviations,
    |m1 - m2| <= sqrt(s1^2 + s2^2). A leg between them without a known mass is then of this load too.
    """
    legs: list[Leg] = []
    known: int | None = None
    for part in parts:
        if known is not None and part.is_known and _agree(legs[known], part):
            legs[known:] = [_joined([*legs[known:], part])]
            continue
        legs.append(part)
        if part.is_known:
            known = len(legs) - 1
    numbers = iter(range(1, len(legs) + 1))
    return [replace(leg, load=next(numbers) if leg.is_valid else None) for leg in legs]


def _agree(a: Leg, b: Leg) -> bool:
    assert a.mass_kg is not None and b.mass_kg is not None
    return abs(a.mass_kg - b.mass_kg) <= math.hypot(a.mass_std_kg or 0.0, b.mass_std_kg or 0.0)


def _joined(legs: Sequence[Leg]) -> Leg:
    """Return one leg of several that follow each other; its mass is the best known of theirs."""
    best = min(legs, key=lambda leg: (not leg.is_valid, leg.mass_std_kg or math.inf))
    driving_s = sum(leg.driving_s for leg in legs)
    valid_s = sum(leg.valid_share * leg.driving_s for leg in legs)
    return replace(
        best,
        from_s=legs[0].from_s,
        to_s=legs[-1].to_s,
        passed_us=(legs[0].passed_us[0], legs[-1].passed_us[1]),
        valid_share=valid_s / driving_s if driving_s else 0.0,
        distance_m=sum(leg.distance_m for leg in legs),
        climb_m=sum(leg.climb_m for leg in legs),
        driving_s=driving_s,
        stops=sum(leg.stops for leg in legs) + len(legs) - 1,
    )
