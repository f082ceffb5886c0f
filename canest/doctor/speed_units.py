"""Which unit of speed has been taken for another, by how many times a speed is too large."""

from __future__ import annotations

from canest.core.roles import UNITS
from canest.vehicle.lever_check import SPEED_TOLERANCE

#: how many times too large a speed is for each unit that is taken for another
UNIT_FACTORS = sorted(
    {taken / true for true, _ in UNITS["m/s"].values() for taken, _ in UNITS["m/s"].values()} - {1.0}
)


def mistaken_unit(times: float) -> str:
    """Return which unit of speed, taken for which other, makes it so many times too large, '' for none."""
    for true, (factor, _) in UNITS["m/s"].items():
        for taken, (other, _) in UNITS["m/s"].items():
            if factor != other and abs(times * factor / other - 1) <= SPEED_TOLERANCE:
                return f"{true} is taken for {taken}"
    return ""
