"""Signals that nobody sends, or no role maps, though mass and grade are wrong without them."""

from __future__ import annotations

from collections.abc import Collection

from canest.config.schema import Config
from canest.core.roles import BRAKES, PEDAL
from canest.vehicle.role_sources import is_at_wheels, torque_role

FRICTION, RETARDER = "engine_friction_pct", "retarder_torque_pct"

#: where a brake is reported
_BRAKE_SIGNAL = "on J1939 it is SPN 597, in CCVS1; on your own DBC, the brake's message"


def missing_signal_warnings(config: Config, received: Collection[str]) -> list[str]:
    """Return one sentence for each gap; ``received``: the roles that have had a value."""
    missing = config.signals.keys() - set(received)
    warnings = []
    torque = torque_role(config.signals, config.vehicle)
    if not is_at_wheels(torque, config.signals):
        if (
            torque == "engine_torque_pct"
            and FRICTION not in received
            and "friction_torque_pct" not in config.vehicle.model_fields_set
            and len(config.vehicle.gear_ratios) != 1  # as a rule a motor, which has none
        ):
            warnings.append(
                "no signal reports the engine's friction, so it counts as 0 % of the reference torque: set "
                "what it is (vehicle.friction_torque_pct, some 5 to 12 % of a combustion engine, 0 of an "
                "electric motor and of a net torque, as one that is clearly negative in overrun), or mass "
                "and grade are wrong by it"
            )
        stated_Nm = config.vehicle.reference_torque_Nm
        if torque == "engine_torque_pct" and "reference_torque" in missing and stated_Nm is not None:
            warnings.append(
                f"reference_torque (SPN 544) is mapped and never came: the {stated_Nm:,g} N m of "
                "vehicle.reference_torque_Nm count, and masses are as wrong as they are"
            )
        if RETARDER in missing and config.vehicle.retarder is not None:
            warnings.append(_unseen("a retarder", RETARDER))
    brakes = [role for role in BRAKES if role in config.signals]
    unmapped = "" if brakes else f". No such role is mapped: {_BRAKE_SIGNAL}"
    assumed = config.gates.brake.assume_when_pedal_released
    if not brakes and config.gates.possible_brake.enabled and not (assumed and PEDAL in config.signals):
        unless = " unless the accelerator is pressed" if PEDAL in config.signals else ""
        warnings.append(
            f"no signal reports whether the brake acts: without propulsion nothing is learned{unless} (gate "
            f"possible_brake, signals.brake_switch or brake_pedal){unmapped}"
        )
    elif missing.issuperset(brakes) and not assumed:
        warnings.append(_unseen("the brake", " or ".join(brakes or BRAKES)) + unmapped)
    return warnings


def _unseen(what: str, signals: str) -> str:
    return f"no signal reports whether {what} acts: its force counts as weight or a hill (signals.{signals})"
