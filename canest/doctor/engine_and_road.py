"""What makes the engine turn otherwise than the road has it: a unit, a wheel radius or an axle."""

from __future__ import annotations

from canest.core.roles import RADPS_PER_RPM
from canest.doctor.speed_units import mistaken_unit
from canest.vehicle.facts import Vehicle
from canest.vehicle.lever_check import SPEED_TOLERANCE

#: slower than this (m/s), speeds are too coarse to compare
MIN_MPS = 5.0
#: no wrong radius or axle, but a diameter, makes speeds so many times larger or smaller
MOST_TIMES = 1.6
#: what may turn out to be in another unit or at another radius, the commonest first
ROAD_SPEEDS = ("vehicle_speed", "undriven_speed", "gps_speed")


def words(role: str) -> str:
    """Return what the engine is compared with, in words. role: a road speed, or that of the output shaft."""
    return role.replace("_", " ") if role in ROAD_SPEEDS else "output shaft"


def at_radius(vehicle: Vehicle, role: str) -> str:
    """Return by which facts a road speed stands for the output shaft's, '' where none does."""
    if role not in ROAD_SPEEDS:
        return ""
    return f" (at wheel_radius_m {vehicle.wheel_radius_m:g} and final_drive {vehicle.final_drive:g})"


def unit_hint(role: str, times: float) -> str:
    """Return which unit makes the engine turn so many times as often as the road has it, '' for none."""
    for taken, factor in (
        ("rpm is taken for rad/s", 1.0 / RADPS_PER_RPM),
        ("rad/s is taken for rpm", RADPS_PER_RPM),
    ):
        if abs(times / factor - 1) <= SPEED_TOLERANCE:
            return (
                f"engine_speed is {times:.3g} times what the {words(role)} gives, as it is when "
                f"{taken}: look at the unit of signals.engine_speed"
            )
    mistaken = mistaken_unit(1.0 / times)
    if role not in ROAD_SPEEDS or not mistaken:
        return ""
    return (
        f"{role} is {1.0 / times:.3g} times what the engine gives, as it is when {mistaken}: "
        f"look at the unit of signals.{role}"
    )


def signals_first(times: float, role: str, other: str) -> str:
    """Return the question that comes before radius and axle, '' where one of them may make so many times.

    role, other: the speed that is so many times the other one.
    """
    if 1.0 / MOST_TIMES < times < MOST_TIMES:
        return ""
    return (
        f"{role} is {times:.3g} times what {other} gives: are factor, start bit and byte order of both "
        "signals right? Else "
    )


def one_mistake(vehicle: Vehicle, role: str, times: float, by: str) -> list[str]:
    """Return which one mistake makes the engine turn so many times as often in every gear; [] for none.

    by: what else is as it is, gear ratios from the bus or of the config.
    """
    if abs(times - 1) <= SPEED_TOLERANCE:
        return []
    if hint := unit_hint(role, times):
        return [hint]
    if role not in ROAD_SPEEDS:
        return [
            f"engine_speed is {times:.3g} times what {words(role)} and {by} give: look at the units of "
            f"signals.engine_speed, signals.{role} and {by}"
        ]
    radius_m, drive, road = vehicle.wheel_radius_m, vehicle.final_drive, words(role)
    return [
        f"{signals_first(times, 'engine_speed', role)}engine and {road} agree with wheel_radius_m "
        f"{radius_m / times:.3f} (at final_drive {drive:g} and the same {by}), the config has {radius_m:g}; "
        f"or with final_drive {drive * times:.3g} (at wheel_radius_m {radius_m:g})"
    ]
