"""What a user should know of a config before any log is read: its databases, and units that nobody states."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.core.roles import ROLES, UNITS
from canest.decode.database import database_warnings
from canest.doctor.same_messages import same_message_warnings
from canest.doctor.unused_signals import unused_signal_warnings
from canest.pipeline.signal_map import signal_of, unit_of

if TYPE_CHECKING:
    from collections.abc import Collection

    from canest.config import Config
    from canest.config.sections import Source


def config_warnings(config: Config, came: Collection[str] | None = None) -> list[str]:
    """Return what is odd about a config and its databases, one sentence each.

    came: messages of the log, of those that no role takes (`UnmappedGroups`); None where none has been read.
    """
    return [
        *database_warnings(config.databases), *same_message_warnings(config),
        *unused_signal_warnings(config, came), *unit_warnings(config), *other_unit_warnings(config),
    ]  # fmt: skip


def unit_warnings(config: Config) -> list[str]:
    """Return which signals are taken in the unit of their role, since nothing states another."""
    in_dbc, in_table = [], []
    for role, source in config.signals.items():
        if not _could_be_another(role, source):
            continue
        taken = f"is taken as {ROLES[role].unit} (state signals.{role}.unit)"
        if (known := signal_of(config, role)) is None:
            if not unit_of(source):
                in_table.append(f"{source.column} {taken}")
        elif not unit_of(source, known[1]):
            in_dbc.append(f"{source.message}.{source.signal} {taken}")
    both = (("no unit in the DBC", in_dbc), ("no unit of the column", in_table))
    return [f"{what}: {', '.join(found)}" for what, found in both if found]


def other_unit_warnings(config: Config) -> list[str]:
    """Return which signals are taken in another unit than their DBC states, where both could be."""
    found = []
    for role, source in config.signals.items():
        if (known := signal_of(config, role)) is None or not source.unit or role not in ROLES:
            continue
        stated, units = (known[1].unit or "").strip(), UNITS[ROLES[role].unit]
        if source.scale == 1.0 and stated in units and units[stated] != units.get(source.unit):
            found.append(
                f"signals.{role}.unit: {source.unit} counts, though the DBC says {stated} of "
                f"{source.message}.{source.signal}"
            )
    return found


def _could_be_another(role: str, source: Source) -> bool:
    """Return whether a source's numbers could be in another unit than the role's.

    A percentage could not. A scale is a conversion of the user's, unless it only turns a sign, and the
    numbers of a map are the user's too.
    """
    if role not in ROLES or abs(source.scale) != 1.0 or source.map:
        return False
    return len(set(UNITS[ROLES[role].unit].values())) > 1
