"""Roles: what the estimator needs to know, whatever a bus calls it.

A config's signal map ties each role to a DBC signal or a table column. A role has one unit inside
canest; a source in another unit of the same dimension is converted, any other unit is refused.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

from canest.core.nearest_name import expected_name

RADPS_PER_RPM = math.pi / 30

#: a pound-force foot, N m
LBF_FT_NM = 1.3558179483314004

#: unit inside canest -> the units it may come in: value_inside = value * factor + offset
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "m/s": {"m/s": (1.0, 0.0), "km/h": (1 / 3.6, 0.0), "kph": (1 / 3.6, 0.0), "mph": (0.44704, 0.0)},
    "rpm": {"rpm": (1.0, 0.0), "1/min": (1.0, 0.0), "rad/s": (1 / RADPS_PER_RPM, 0.0)},
    "Nm": {
        "Nm": (1.0, 0.0),
        "N m": (1.0, 0.0),
        "kNm": (1000.0, 0.0),
        **dict.fromkeys(("lbf ft", "lb-ft", "ft-lb"), (LBF_FT_NM, 0.0)),
    },
    "N": {"N": (1.0, 0.0), "kN": (1000.0, 0.0)},
    "%": {"%": (1.0, 0.0)},
    "ratio": {"": (1.0, 0.0), "ratio": (1.0, 0.0)},
    "gear": {"": (1.0, 0.0), "gear": (1.0, 0.0)},
    "": {"": (1.0, 0.0)},
    "m": {"m": (1.0, 0.0), "km": (1000.0, 0.0), "ft": (0.3048, 0.0)},
    "deg": {"deg": (1.0, 0.0), "rad": (180 / math.pi, 0.0)},
    "rad": {"rad": (1.0, 0.0), "deg": (math.pi / 180, 0.0)},
    "rad/s": {"rad/s": (1.0, 0.0), "deg/s": (math.pi / 180, 0.0)},
    "m/s2": {"m/s2": (1.0, 0.0), "m/s^2": (1.0, 0.0), "g": (9.80665, 0.0)},
    "kPa": {"kPa": (1.0, 0.0), "bar": (100.0, 0.0), "mbar": (0.1, 0.0), "hPa": (0.1, 0.0)},
    "degC": {"degC": (1.0, 0.0), "°C": (1.0, 0.0), "K": (1.0, -273.15), "degF": (5 / 9, -160 / 9)},
    "kg": {"kg": (1.0, 0.0), "t": (1000.0, 0.0)},
    "kW": {"kW": (1.0, 0.0), "W": (0.001, 0.0)},
}
KNOWN_UNITS = sorted({u for table in UNITS.values() for u in table if u})


def conversion(role: str, unit: str) -> tuple[float, float] | None:
    """Return (factor, offset) from a source's unit to a role's, None when they cannot be converted.

    A role that only an effect knows takes any unit as it is; a source without a unit is trusted.
    """
    known = ROLES.get(role)
    if known is None or not unit:
        return 1.0, 0.0
    return UNITS[known.unit].get(unit)


class Role(NamedTuple):
    """One role: its unit inside canest, how old a sample may be, and what it is for."""

    name: str
    unit: str
    stale_s: float
    text: str


def _role(name: str, unit: str, stale_s: float, text: str) -> tuple[str, Role]:
    return name, Role(name, unit, stale_s, text)


ROLES: dict[str, Role] = dict(
    [
        # traction
        _role("engine_torque_pct", "%", 0.25, "actual engine percent torque, indicated (SPN 513)"),
        _role("engine_torque_fraction", "%", 0.25, "eighths of a percent, added to SPN 513 (SPN 4154)"),
        # the last received friction is nearer to the truth than any default
        _role("engine_friction_pct", "%", math.inf, "nominal friction percent torque (SPN 514)"),
        _role("reference_torque", "Nm", math.inf, "engine reference torque, 100 % (SPN 544)"),
        _role("engine_torque", "Nm", 0.25, "net torque of engine or motor at its shaft, where sent in N m"),
        _role("wheel_force", "N", 0.25, "measured or computed force of the driven wheels on the road"),
        _role("power", "kW", 0.25, "power of engine or motor; without engine_speed, power at the wheels"),
        _role("wheel_torque", "Nm", 0.25, "sum of measured wheel or half-shaft torques"),
        _role("half_shaft_torque_left", "Nm", 0.25, "measured torque of the left half-shaft"),
        _role("half_shaft_torque_right", "Nm", 0.25, "measured torque of the right half-shaft"),
        _role("engine_speed", "rpm", 0.25, "engine speed (SPN 190)"),
        # driveline
        _role("output_shaft_speed", "rpm", 0.25, "transmission output shaft speed (SPN 191)"),
        _role("input_shaft_speed", "rpm", 0.25, "transmission input shaft speed (SPN 161)"),
        _role("gear_ratio", "ratio", 1.0, "actual transmission ratio (SPN 526)"),
        _role("gear", "gear", 1.5, "current gear number (SPN 523)"),
        _role("selected_gear", "gear", 1.5, "selected gear number (SPN 524)"),
        _role("shift_in_process", "", 0.5, "shift in process, 0 or 1 (SPN 574)"),
        _role(
            "driveline_engaged",
            "",
            0.5,
            "driveline engaged, 0 or 1 (SPN 560): while it is open, the grade needs no torque",
        ),
        _role("lockup_engaged", "", 0.5, "torque converter locked up, 0 or 1 (SPN 573)"),
        _role("clutch_slip", "%", 0.5, "clutch slip (SPN 522)"),
        _role("clutch_switch", "", 1.0, "clutch pedal pressed, 0 or 1 (SPN 598)"),
        # speed of the vehicle
        _role("vehicle_speed", "m/s", 0.5, "wheel-based vehicle speed (SPN 84)"),
        _role("undriven_speed", "m/s", 0.5, "speed of an undriven axle (SPN 904)"),
        _role("gps_speed", "m/s", 2.5, "navigation-based speed (SPN 517)"),
        # brakes and retarders
        _role("brake_switch", "", 1.0, "service brake pressed, 0 or 1 (SPN 597)"),
        _role("brake_pedal", "%", 0.5, "brake pedal position (SPN 521)"),
        _role("parking_brake", "", 1.0, "parking brake set, 0 or 1 (SPN 70)"),
        _role("abs_active", "", 1.0, "anti-lock or traction control acting, 0 or 1 (SPN 563)"),
        _role(
            "retarder_torque_pct", "%", 0.5, "actual retarder percent torque, negative when braking (SPN 520)"
        ),
        _role("retarder_request", "%", 0.5, "driver's demand of retarder torque, negative (SPN 1715)"),
        _role("retarder_reference_torque", "Nm", math.inf, "retarder reference torque (SPN 556)"),
        # driver and environment
        _role("accelerator", "%", 0.5, "accelerator pedal position (SPN 91)"),
        _role("ambient_temperature", "degC", 30.0, "ambient air temperature (SPN 171)"),
        _role("barometric_pressure", "kPa", 30.0, "barometric pressure (SPN 108)"),
        _role("pto_state", "", 2.0, "power take-off governor state, 0 is off (SPN 976)"),
        _role("fan_speed", "%", 5.0, "estimated fan speed (SPN 975)"),
        # motion
        _role("longitudinal_accel", "m/s2", 0.25, "longitudinal accelerometer (SPN 1810)"),
        _role("lateral_accel", "m/s2", 0.25, "lateral accelerometer (SPN 1809)"),
        _role("yaw_rate", "rad/s", 0.25, "yaw rate, left positive (SPN 1808)"),
        _role("steering_angle", "rad", 0.25, "steering wheel angle, left positive (SPN 1807)"),
        _role("pitch", "rad", 0.25, "slope sensor pitch, uphill positive (SPN 3318)"),
        _role("altitude", "m", 5.0, "altitude (SPN 580)"),
        # position: for no estimate, only for tables and maps that ask for it
        _role("latitude", "deg", 5.0, "latitude, north positive (SPN 584)"),
        _role("longitude", "deg", 5.0, "longitude, east positive (SPN 585)"),
        # reported by other controllers
        _role(
            "reported_mass", "kg", 10.0, "gross mass that other controllers report (SPN 1760), only compared"
        ),
    ]
)
#: these values never expire: neither silence nor "not available" clears them
LASTING = frozenset(name for name, role in ROLES.items() if role.stale_s == math.inf)
#: roles that are only compared with the estimate: every sender counts for itself, none owns them
COMPARED = frozenset(("reported_mass",))
#: roles that report whether the service brake is on
BRAKES = ("brake_switch", "brake_pedal")
#: the pedal that a driver releases before braking
PEDAL = "accelerator"
#: roles that are 0 or 1
TWO_STATE = frozenset(
    (
        "shift_in_process", "driveline_engaged", "lockup_engaged", "clutch_switch",
        "brake_switch", "parking_brake", "abs_active",
    )
)  # fmt: skip
#: what somebody calls a role without knowing its name -> the roles that are meant, the usual one first
_EVERYDAY: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("speed", "velocity", "v", "kmh", "wheel_speed"), ("vehicle_speed",)),
    **dict.fromkeys(("rpm", "engine_rpm", "revs", "n_engine"), ("engine_speed",)),
    **dict.fromkeys(("brake", "brakes", "braking"), ("brake_switch", "brake_pedal")),
    "torque": ("engine_torque", "engine_torque_pct"),
    "force": ("wheel_force",),
    **dict.fromkeys(("throttle", "gas", "pedal", "accelerator_pedal"), ("accelerator",)),
    **dict.fromkeys(("gear_number", "current_gear"), ("gear",)),
    "clutch": ("clutch_switch", "clutch_slip"),
    **dict.fromkeys(("accel", "acceleration"), ("longitudinal_accel",)),
    **dict.fromkeys(("slope", "grade"), ("pitch",)),
    **dict.fromkeys(("height", "elevation"), ("altitude",)),
    "lat": ("latitude",),
    **dict.fromkeys(("lon", "lng", "long"), ("longitude",)),
    **dict.fromkeys(("mass", "weight"), ("reported_mass",)),
    "pressure": ("barometric_pressure",),
}


def expected_role(name: str, roles: Collection[str] = ROLES, kind: str = "a role") -> str:
    """Return what was expected instead of ``name``: the roles that the word stands for, else the nearest.

    roles: among these. kind: what they are, with its article.
    """
    if meant := [role for role in _EVERYDAY.get(name.lower(), ()) if role in roles]:
        return f"{kind}, perhaps {' or '.join(meant)}"
    return expected_name(name, roles, kind, "docs/config.md")
