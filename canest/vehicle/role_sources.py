"""Which of the roles that a config maps give torque, speed and gear ratio."""

from __future__ import annotations

from collections.abc import Collection

from canest.core.errors import ConfigError
from canest.vehicle.driveline_state import CLUTCH_ROLES
from canest.vehicle.facts import Vehicle
from canest.vehicle.range_rate_check import SPEED_ORDER

#: torque roles that are measured where neither crank nor gear matters
AT_WHEELS = ("wheel_force", "wheel_torque", "half_shaft_torque_left")
#: speeds that turn with the driven wheels
DRIVEN_SPEEDS = ("output_shaft_speed", "engine_speed", "vehicle_speed")


def is_at_wheels(torque: str, roles: Collection[str]) -> bool:
    """Return whether the torque role needs neither crank nor gear: power, if no engine speed divides it."""
    return torque in AT_WHEELS or (torque == "power" and "engine_speed" not in roles)


def torque_role(roles: Collection[str], vehicle: Vehicle) -> str:
    """Return the role that gives the torque: the nearest to the wheels. Errors: ConfigError for none."""
    for role in (*AT_WHEELS, "engine_torque", "engine_torque_pct", "power"):
        if role == "half_shaft_torque_left" and "half_shaft_torque_right" not in roles:
            continue
        if role in roles:
            if role == "engine_torque_pct" and not (
                "reference_torque" in roles or vehicle.reference_torque_Nm
            ):
                raise ConfigError(
                    "is missing, and no signal gives it",
                    where="vehicle.reference_torque_Nm",
                    expected="the engine's 100 % torque in N m (SPN 544)",
                )
            return role
    raise ConfigError(
        "no torque",
        where="signals",
        expected="engine_torque_pct, engine_torque, wheel_torque or _force, power or both half-shaft torques",
    )


def speed_in_use(roles: Collection[str], vehicle: Vehicle) -> str:
    """Return the role that gives the speed as long as it is received, '' for none."""
    return next(iter(_speeds(roles, vehicle)), "")


def motion_roles(roles: Collection[str], vehicle: Vehicle) -> set[str]:
    """Return the speed in use and the accelerometer."""
    return {speed_in_use(roles, vehicle), "longitudinal_accel"}


def speed_roles(roles: Collection[str], vehicle: Vehicle) -> tuple[str, ...]:
    """Return the roles that give the speed, the finest first. Errors: ConfigError for none."""
    found = _speeds(roles, vehicle)
    if found:
        return found
    if "engine_speed" not in roles:
        raise ConfigError(
            "no speed",
            where="signals",
            expected="output_shaft_speed, vehicle_speed or another speed",
        )
    raise ConfigError(
        "engine_speed is the only speed, and no signal shows when the clutch is open",
        where="signals",
        expected=f"vehicle_speed or another speed, or one of {', '.join(CLUTCH_ROLES)}",
    )


def _speeds(roles: Collection[str], vehicle: Vehicle) -> tuple[str, ...]:
    rigid = vehicle.has_one_gear or any(role in roles for role in CLUTCH_ROLES)
    needs_ratio = vehicle.gear_ratios or not any(role in roles for role in AT_WHEELS)
    others = any(role in roles for role in SPEED_ORDER if role != "engine_speed")
    if not needs_ratio and others and "gear_ratio" not in roles:
        rigid = False  # none may have been given
    # where no signal shows when the clutch is open, any other speed is nearer to the truth
    return tuple(r for r in SPEED_ORDER if r in roles and (rigid or r != "engine_speed"))


def ratio_ways(roles: Collection[str], vehicle: Vehicle, torque: str) -> tuple[tuple[str, ...], ...]:
    """Return the ways to the gear ratio, each the roles that it takes; none where none is needed.

    Errors: ConfigError where there are several gears and no signal of which one is in.
    """
    gears, has = vehicle.gear_ratios, roles
    ways: list[tuple[str, ...]] = [("gear_ratio",)] if "gear_ratio" in has else []
    if is_at_wheels(torque, roles) or (not ways and not gears):
        return ()
    if gears and "gear" in has:
        ways.append(("gear",))
    if not ways and len(gears) == 1:
        return ()
    if gears and "engine_speed" in has:
        ways += [("engine_speed", role) for role in ("output_shaft_speed", "vehicle_speed") if role in has]
    if not ways:
        raise ConfigError(
            f"no signal shows which of the {len(gears)} vehicle.gear_ratios is engaged",
            where="signals",
            expected="gear_ratio, gear, or engine_speed with output_shaft_speed or vehicle_speed",
        )
    return tuple(ways)
