"""What of a config's signals does not count, and what no signal checks: known before any log is read."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from canest.core.errors import ConfigError
from canest.core.roles import UNITS
from canest.vehicle.role_sources import AT_WHEELS, is_at_wheels, torque_role

if TYPE_CHECKING:
    from collections.abc import Collection

    from cantools.database.can import Message, Signal

    from canest.config import Config

#: signals that are the speed of an engine or motor, by their name
_ENGINE = re.compile(r"eng|mot", re.IGNORECASE)
#: and those that turn with the wheels, whatever gear is in
_TURN_WITH_WHEELS = re.compile(r"mot|shaft", re.IGNORECASE)
_RIGHT = "half_shaft_torque_right"
_TORQUES = (*AT_WHEELS, _RIGHT, "engine_torque", "engine_torque_pct", "power")


def unused_signal_warnings(config: Config, came: Collection[str] | None = None) -> list[str]:
    """Return which torques are mapped and do not count, and what could check ratio, radius and unit.

    came: messages of the log, of those that could; None where no log has been read.
    """
    try:
        used = torque_role(config.signals, config.vehicle)
    except ConfigError:  # is said where the model is built
        return []
    return _other_torques(config, used) + _unchecked_ratio(config, came)


def messages_that_could_check(config: Config) -> list[Message]:
    """Return the messages that could show whether ratios, radius and unit fit each other."""
    return [message for message, _ in _could_check(config)]


def _other_torques(config: Config, used: str) -> list[str]:
    counts = {used, _RIGHT} if used in AT_WHEELS[2:] else {used}
    others = [role for role in _TORQUES if role in config.signals and role not in counts]
    if not others:
        return []
    return [
        f"signals.{used} is the torque that counts, the nearest to the wheels: {', '.join(others)} "
        f"{'are' if len(others) > 1 else 'is'} mapped too, and neither added nor compared (motors on two "
        "axles: docs/config.md)"
    ]


def _unchecked_ratio(config: Config, came: Collection[str] | None) -> list[str]:
    """Return which signal of the databases could show that ratios, radius and unit fit each other."""
    could = [
        f"{message.name}.{signal.name}"
        for message, signal in _could_check(config)
        if came is None or message.name in came
    ]
    if not could:
        return []
    used = torque_role(config.signals, config.vehicle)
    role, facts = "engine_speed", "gear, gear_ratios, final_drive, wheel_radius_m and the unit of the speed"
    scale = ""
    if is_at_wheels(used, config.signals):
        role, facts = "output_shaft_speed", "wheel_radius_m and the unit of the speed"
        scale = ", with scale: final_drive / its ratio to the wheels"
    return [
        f"no signals.{role}: nothing shows whether {facts} fit each other, and masses are as wrong as they "
        f"are ({could[0]} could{scale})"
    ]


def _could_check(config: Config) -> list[tuple[Message, Signal]]:
    """Return the speeds that turn as the torque does and that no role takes: of its own message first."""
    used = torque_role(config.signals, config.vehicle)
    at_wheels = is_at_wheels(used, config.signals)
    if "engine_speed" in config.signals or (at_wheels and "output_shaft_speed" in config.signals):
        return []
    names = _TURN_WITH_WHEELS if at_wheels else _ENGINE
    mapped = {(source.message, source.signal) for source in config.signals.values()}
    found = [
        (message, signal)
        for database in config.databases
        for message in database.messages
        for signal in message.signals
        if _is_speed(signal, names) and (message.name, signal.name) not in mapped
    ]
    return sorted(found, key=lambda pair: pair[0].name != config.signals[used].message)


def is_motor_speed(signal: Signal) -> bool:
    """Return whether a signal is the speed of an engine or motor, by its unit and name."""
    return _is_speed(signal, _ENGINE)


def _is_speed(signal: Signal, names: re.Pattern[str]) -> bool:
    return (signal.unit or "").strip() in UNITS["rpm"] and names.search(signal.name) is not None
