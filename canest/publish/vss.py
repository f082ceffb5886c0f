"""An estimate as signals of the Vehicle Signal Specification (VSS): a standard one, and a branch of ours.

The standard's weight has no uncertainty, so it has a value only while the estimate is valid. The branch is no
part of VSS: `tools/vss_overlay.py` writes it as an overlay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from canest.node.estimate_frame import STATUS_NAMES
from canest.publish.follower import LiveEstimate

Value = float | str | None
WEIGHT = "Vehicle.CurrentOverallWeight"  #: of VSS: kg, uint16, which ends at 65,535
BRANCH = "Vehicle.Canest"
BRANCH_TEXT = "Estimates of the vehicle's mass and the road's grade, with their standard deviations."
VALID = STATUS_NAMES.index("valid")


class Signal(NamedTuple):
    """A signal of our branch.

    value: from an estimate, None where there is no number. allowed: empty for any.
    """

    datatype: str
    unit: str
    description: str
    value: Callable[[LiveEstimate], Value]
    allowed: tuple[str, ...] = ()


def _percent(name: str) -> Callable[[LiveEstimate], Value]:
    def value(estimate: LiveEstimate) -> Value:
        ratio = estimate.numbers[name]
        return None if ratio is None else round(100.0 * ratio, 4)

    return value


#: name below `BRANCH` -> signal
SIGNALS = {
    "Mass": Signal(
        "float", "kg", "Mass of the vehicle with its trailers and load.", lambda e: e.numbers["mass_kg"]
    ),
    "MassStd": Signal("float", "kg", "Standard deviation of the mass.", lambda e: e.numbers["mass_std_kg"]),
    "Grade": Signal(
        "float", "percent", "Grade of the road, the tangent of its angle; positive uphill.", _percent("grade")
    ),
    "GradeStd": Signal("float", "percent", "Standard deviation of the grade.", _percent("grade_std")),
    "Status": Signal(
        "string", "", "Whether the mass can be used.", lambda e: e.status[1], tuple(STATUS_NAMES)
    ),
    "Gate": Signal("string", "", "Why nothing is learned now; empty while it is.", lambda e: e.gate[1]),
}


def values(estimate: LiveEstimate) -> dict[str, Value]:
    """Return the value of every signal by its path."""
    valid = estimate.status[0] == VALID
    return {
        WEIGHT: estimate.numbers["mass_kg"] if valid else None,
        **{f"{BRANCH}.{name}": signal.value(estimate) for name, signal in SIGNALS.items()},
    }
