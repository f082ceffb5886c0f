"""Signals that nobody sends, or no role maps, though mass and grade are wrong without them."""

from __future__ import annotations

from collections.abc import Collection

from canest.config.schema import Config
from canest.core.roles import BRAKES
from canest.vehicle.role_sources import AT_WHEELS, torque_role

FRICTION, RETARDER = "engine_friction_pct", "retarder_torque_pct"


def missing_signal_warnings(config: Config, heard: Collection[str]) -> list[str]:
    """Return one sentence for each gap; ``heard``: the roles that have had a value."""
    missing = config.signals.keys() - set(heard)
    told = []
    torque = torque_role(config.signals, config.vehicle)
    if torque not in AT_WHEELS:
        if torque == "engine_torque_pct" and FRICTION not in heard and not config.vehicle.friction_torque_pct:
            told.append(
                "nobody tells the engine's friction, so it counts as 0 % of the reference torque: say what "
                "it is (vehicle.friction_torque_pct, some 5 to 12 %), or mass and grade are wrong by it"
            )
        if RETARDER in missing and config.vehicle.retarder is not None:
            told.append(_unseen("a retarder", RETARDER))
    brakes = [role for role in BRAKES if role in config.signals]
    if missing.issuperset(brakes) and not config.gates.brake.assume_when_pedal_released:
        told.append(
            _unseen("the brake", " or ".join(brakes or BRAKES))
            + ("" if brakes else ". No such role is mapped: SPN 597 is in CCVS1")
        )
    return told


def _unseen(what: str, signals: str) -> str:
    return f"nobody tells whether {what} acts: what it takes counts as weight or a hill (signals.{signals})"
