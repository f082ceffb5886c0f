"""The config of a table whose columns bear the names of roles."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

from canest.config.load import validated
from canest.config.origins import Origins
from canest.config.schema import Config
from canest.config.sections import SLOWEST_PERIOD_S
from canest.core.errors import ConfigError, LogError
from canest.core.roles import ROLES, expected_role
from canest.vehicle.facts import Vehicle

#: rows further apart than this make steps that the filters let pass, s: they are joined
SLOW_S = 0.125
#: a sample of a slow table must outlast the time to the next row, which may come late
STALE_ROWS = 2.0
HOLD_ROWS = 3.0
_HOLD_S = 2.0
_SHOWN = 12
#: rows so far apart show no launch and no stop, s: those of 200 Hz are, if they are stamped in milliseconds
NO_ROWS_S = 5.0
#: what times may be in -> the largest step from row to row that speaks for it (1 s)
_UNITS = (("milliseconds", 1e3), ("microseconds", 1e6))


def config_of_table(
    given: Config | Vehicle, columns: Collection[str], step_s: float, units: Mapping[str, str] | None = None
) -> Config:
    """Return the config under which a table is estimated from.

    A config that maps any of the columns is that config, as it is. Else every column that is named by a
    role (or by a signal that an effect of the config needs) becomes its source, and no DBC is read.

    columns: names. step_s: time from row to row, in s; rows of slow tables are joined by lines, and count for
    two rows at least.
    units: role -> unit of its column, where that is not the role's own.
    Errors: ConfigError where no column has a name that means anything, or units name another; LogError
    where rows are too far apart to be seconds.
    """
    config = given if isinstance(given, Config) else None
    if config is not None and any(source.column in columns for source in config.signals.values()):
        if units:
            raise ConfigError("the config itself maps the columns", where="units", expected="signals.*.unit")
        return config
    known = {*ROLES, *(config.signals if config is not None else ())}
    roles = [name for name in columns if name in known]
    if not roles:
        raise ConfigError(
            "no column is named by a role" + (", and the config maps none of them" if config else ""),
            where="table",
            found=", ".join(list(columns)[:_SHOWN]),
            expected="names as engine_torque_pct, engine_speed, vehicle_speed (docs/config.md)",
        )
    for role in units or ():
        if role not in roles:
            expected = expected_role(role, roles, "a role among the columns")
            raise ConfigError("unknown column", where="units", found=role, expected=expected)
    _refuse_other_times(step_s)
    raw: dict[str, Any] = {"vehicle": given}
    if config is not None:
        raw = {name: getattr(config, name) for name in Config.model_fields}
    elif type(given) is not Vehicle:  # configs of the same content are equal
        raw["vehicle"] = Vehicle.model_validate(given.model_dump())
    raw["dbc"] = ()
    raw["signals"] = {role: _source(role, step_s, (units or {}).get(role)) for role in roles}
    sampling = config.sampling.model_dump() if config is not None else {}
    hold_s = max(sampling.get("hold_s", _HOLD_S), HOLD_ROWS * step_s)
    raw["sampling"] = {**sampling, "hold_s": hold_s}
    return validated(raw, Origins())


def _refuse_other_times(step_s: float) -> None:
    """Refuse rows that are so far apart that the times are in another unit, or say nothing of a motion."""
    if step_s < NO_ROWS_S:
        return
    unit = next((name for name, most in _UNITS if step_s <= most), "nanoseconds")
    raise LogError(
        f"the rows are too far apart, or their times are in {unit}",
        where="table",
        found=f"{step_s:g} s from row to row",
        expected=f"times in seconds, less than {NO_ROWS_S:g} s from row to row",
    )


def _source(role: str, step_s: float, unit: str | None) -> dict[str, Any]:
    source: dict[str, Any] = {"column": role}
    unit = unit or (ROLES[role].unit if role in ROLES else None)  # a name of a role promises its unit
    if unit:
        source["unit"] = unit
    if step_s > SLOW_S and role in ROLES:
        source["period_s"] = min(step_s, SLOWEST_PERIOD_S)
    stale_s = ROLES[role].stale_s if role in ROLES else math.inf
    if stale_s < STALE_ROWS * step_s:
        source["stale_s"] = STALE_ROWS * step_s
    return source
