"""Resolves a config's signal map: finds signals in the databases, converts units, refuses what is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.config.schema import Config
from canest.config.sections import Source
from canest.core.errors import ConfigError
from canest.core.nearest_name import nearest_names
from canest.core.roles import ROLES, UNITS, conversion
from canest.decode.database import find_signal, is_j1939
from canest.decode.decoder import Decoder
from canest.decode.groups import Want
from canest.decode.value_table import TextTable, raw_table
from canest.vehicle.role_sources import speed_in_use

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

#: a larger factor or offset, or a smaller factor, is that of no quantity, and what follows from it overflows
_MOST_FACTOR = 1e15
#: how a DBC declares a message as J1939, which is matched by parameter group and not by its identifier
J1939_DATABASE = 'a DBC that declares J1939 (VFrameFormat "J1939PG", or ProtocolType "J1939")'


def decoder_for(config: Config) -> Decoder:
    """Return the decoder of a config's DBC signals (one without wants for a table-only config).

    Errors: ConfigError naming the key, what was found and what was expected.
    """
    return Decoder(wants_of(config), config.databases)


def wants_of(config: Config) -> dict[str, Want]:
    """Return role -> DBC signal. Errors: ConfigError as above."""
    wants: dict[str, Want] = {}
    for role, (message, signal) in _of_databases(config).items():
        source, where = config.signals[role], config.at(f"signals.{role}")
        if source.source is not None and not is_j1939(message):
            raise ConfigError(
                f"{message.name} is no J1939 message: its identifier holds no source address",
                where=config.at(f"signals.{role}.source"),
                found=f"0x{source.source:02X}",
                expected="no such key" + (f", or {J1939_DATABASE}" if message.is_extended_frame else ""),
            )
        _refuse_factor(source, signal, where)
        factor, offset = factor_and_offset(role, source, unit_of(source, signal), where)
        wants[role] = Want(
            role=role,
            message=message.name,
            signal=signal.name,
            source=source.source,
            validity=source.validity,
            factor=factor,
            offset=offset,
            where=where,
            values=raw_table(source.map, signal, config.at(f"signals.{role}.map"))
            if source.map and source.validity != "ascii"
            else None,
            texts=TextTable(source.map) if source.map and source.validity == "ascii" else None,
        )
    return wants


def _of_databases(config: Config) -> dict[str, tuple[Message, Signal]]:
    """Return role -> message and signal. Errors: ConfigError, which names all roles that have none."""
    found: dict[str, tuple[Message, Signal]] = {}
    missing: dict[str, ConfigError] = {}
    for role, source in config.signals.items():
        if source.message is None or source.signal is None:
            continue
        where = config.at(f"signals.{role}")
        if not config.databases:
            raise ConfigError("names a DBC signal, but the config has no dbc: file", where=where)
        try:
            found[role] = find_signal(config.databases, source.message, source.signal, where)
        except ConfigError as error:
            missing[role] = error
    if len(missing) > 1:
        (_, first), *others = missing.items()
        raise ConfigError(
            first.what, where=first.where, found=first.found,
            expected=f"{first.expected}. Nor is there one for: {', '.join(role for role, _ in others)}; map "
            "each to what the DBC calls it, or delete its line. `dbc:` names "
            f"{', '.join(config.dbc)}{'' if 'dbc' in config.model_fields_set else ' where it is not given'}",
        )  # fmt: skip
    if missing:
        raise next(iter(missing.values()))
    return found


def signal_of(config: Config, role: str) -> tuple[Message, Signal] | None:
    """Return the DBC's message and signal of a role, None for a column and a role that is not mapped.

    Errors: ConfigError naming the key for what no database has.
    """
    source = config.signals.get(role)
    if source is None or source.message is None or source.signal is None:
        return None
    return find_signal(config.databases, source.message, source.signal, config.at(f"signals.{role}"))


def _refuse_factor(source: Source, signal: Signal, where: str) -> None:
    """Refuse a factor or an offset of the DBC that no quantity has. Errors: ConfigError.

    They are used unless there is a map, or text.
    """
    if source.map or source.validity == "ascii":
        return
    factor, offset = float(signal.scale), float(signal.offset)
    name = f"{source.message}.{source.signal}"
    if factor == 0.0:
        raise ConfigError(
            "the DBC's factor makes every value the same",
            where=where,
            found=f"{name} with factor 0",
            expected="another factor in the DBC, or map: in this entry",
        )
    if not (1.0 / _MOST_FACTOR <= abs(factor) <= _MOST_FACTOR and abs(offset) <= _MOST_FACTOR):
        raise ConfigError(
            "the DBC's factor and offset make no quantity",
            where=where,
            found=f"{name} with factor {factor:g} and offset {offset:g}",
            expected=f"a factor from {1.0 / _MOST_FACTOR:g} to {_MOST_FACTOR:g}, an offset of at most that",
        )


def unit_of(source: Source, signal: Signal | None = None) -> str:
    """Return the unit of a source's numbers: its own, else that of its DBC signal; '' where none is known."""
    return source.unit or ((signal.unit if signal is not None else None) or "").strip()


def factor_and_offset(role: str, source: Source, unit: str, where: str = "") -> tuple[float, float]:
    """Return how a source's numbers become the role's: ``scale``, ``offset`` and ``invert`` included.

    The physical value is converted into the role's unit, then times scale plus offset, and a state that is
    inverted is 1 minus that. Errors: ConfigError for a unit of another dimension.
    """
    converted = conversion(role, unit)
    if converted is None:
        known = UNITS[ROLES[role].unit]
        names = [u or "no unit" for u in known]
        expected = "one of " + ", ".join(names) if len(names) > 1 else names[0]
        what = "unit does not fit the role"
        if source.unit is None and source.message is not None:
            what = f"unit of {source.message}.{source.signal} in the DBC does not fit the role"
            key = " ".join(["unit:", *nearest_names(unit, known)[:1]])
            expected += (
                f"; {key} in this entry overrides the DBC's, with scale: for how many of them one is"
                if any(known)
                else ""
            )
        raise ConfigError(what, where=where or f"signals.{role}", found=unit, expected=expected)
    factor, offset = converted
    factor, offset = factor * source.scale, offset * source.scale
    if source.offset:  # a sum with zero would take the sign from a zero
        offset += source.offset
    return (-factor, 1.0 - offset) if source.invert else (factor, offset)


def resolution_of(config: Config) -> dict[str, float]:
    """Return the steps of the signals in use: ``speed`` (m/s), ``torque`` (N m), ``accelerometer`` (m/s2).

    The factor of a DBC signal; for table columns, whose resolution nobody declares, typical values.
    """
    v = config.vehicle
    reference = v.reference_torque_Nm or 2000.0
    speeds = {
        "output_shaft_speed": v.mps_per_shaft_rpm,
        "undriven_speed": 1.0,
        "engine_speed": v.mps_per_shaft_rpm / min(v.gear_ratios.values(), default=1.0),
        "vehicle_speed": 1.0,
        "gps_speed": 1.0,
    }
    steps = {"speed": 0.01, "torque": 0.005 * reference, "accelerometer": 0.02}
    speed = speed_in_use(config.signals, config.vehicle)
    step = step_of(config, speed)
    if step is not None:
        steps["speed"] = step * speeds[speed]
    torques = {
        "wheel_force": v.wheel_radius_m,
        "wheel_torque": 1.0,
        "half_shaft_torque_left": 2.0**0.5,  # and the right one
        "engine_torque": 1.0,
        "engine_torque_pct": 0.01 * reference,
    }
    if step_of(config, "engine_torque_fraction") is not None:  # finer than the role that it is added to
        torques = {"engine_torque_fraction": 0.01 * reference} | torques
    for role, scale in torques.items():
        step = step_of(config, role)
        if step is not None:
            steps["torque"] = step * scale
            break
    step = step_of(config, "longitudinal_accel")
    if step is not None:
        steps["accelerometer"] = step
    return steps


def step_of(config: Config, role: str) -> float | None:
    """Return the factor of a role's DBC signal in the role's unit, None for a column or a mapped signal."""
    found = signal_of(config, role)
    if found is None or config.signals[role].map:
        return None
    source, (_, signal) = config.signals[role], found
    factor, _ = factor_and_offset(role, source, unit_of(source, signal))
    return abs(float(signal.scale) * factor)
