"""The part of docs/config.md about vehicles that need a line more in their config, or cannot be expressed."""

from __future__ import annotations

_LINES = (
    (
        "motors on two axles, or an engine and a motor",
        "the torques at the wheels as `half_shaft_torque_left` and `_right`: each with `scale:` ratio times "
        "efficiency. They are added; `gear_ratios` and `final_drive` do not count for them. The speed of one "
        "motor as `output_shaft_speed` with `scale:` `final_drive` by its ratio lets `check` find a wrong "
        "radius or unit",
    ),
    (
        "several torques in one signal map",
        "one counts, the nearest to the wheels; `check` and `replay` name the others",
    ),
    (
        "speeds of four wheels",
        "one of an undriven axle as `undriven_speed`, or one of a driven wheel as `vehicle_speed`",
    ),
    ("a wheel speed in 1/min", "`output_shaft_speed` with `scale:` the final drive"),
    (
        "a CVT",
        "`gear_ratio` from the bus, or a torque at the wheels. Speeds do not give a ratio without steps",
    ),
    (
        "a torque in another unit than N m, kN m or lbf ft",
        "`unit: Nm` with `scale:` how many N m one of it is",
    ),
    ("a brake that is 1 when pressed and 2 when not", "`map: {1: 1, 2: 0}`"),
)
_CANNOT = (
    "A transfer case or range splitter, of which no signal gives the whole ratio. `gear_ratio` can.\n"
    "  Otherwise a config for each range.",
    "A percent torque of the full load at the present speed, as some passenger cars have it. Percent\n"
    "  counts of one reference torque.",
    "Two retarders. One role has one sender, and the other one acts unreported.",
    "Signals beyond the eighth byte of a CAN FD frame, and multiplexors within multiplexed signals. Both\n"
    "  are refused.",
)


def vehicles_text() -> str:
    """Return it."""
    rows = "\n".join(f"| {vehicle} | {what} |" for vehicle, what in _LINES)
    cannot = "\n".join(f"- {what}" for what in _CANNOT)
    return (
        "### Vehicles that need a line more\n\n| vehicle | what to write |\n|---|---|\n"
        f"{rows}\n\nWhat a config cannot say:\n\n{cannot}\n\n"
    )
