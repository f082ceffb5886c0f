"""How long a report counts, and what a signal is between two of them."""

from __future__ import annotations

from canest.config.schema import Config
from canest.config.sections import Source
from canest.core.roles import LASTING, ROLES, TWO_STATE
from canest.grid.between import Between, earlier, larger, line, smaller, unchanged

#: staleness limit of a signal that only an effect knows
EFFECT_SIGNAL_STALE_S = 5.0
#: two reports are joined when they lie so many periods apart at most: one may be lost
MISSED_PERIODS = 2.5
#: a report may come late by this share of its period
LATE_PERIODS = 0.2
_NOTHING_BETWEEN = ("selected_gear", "pto_state")
#: states that close a gate while they are off, and those that do while they are on: all that are 0 or 1
_CLOSES_OFF = frozenset(("driveline_engaged", "lockup_engaged"))
_CLOSES_ON = (TWO_STATE - _CLOSES_OFF) | {"brake_pedal", "clutch_slip"}


def hold_us(config: Config) -> int:
    """Return how long ticks go on after the last wanted frame."""
    slowest_s = max((source.period_s or 0.0 for source in config.signals.values()), default=0.0)
    return round(max(config.sampling.hold_s, MISSED_PERIODS * slowest_s) * 1e6)


def stale_limit_s(role: str, source: Source) -> float:
    """Return how old a sample of a role may be."""
    if source.stale_s is not None:
        return source.stale_s
    limit_s = ROLES[role].stale_s if role in ROLES else EFFECT_SIGNAL_STALE_S
    return limit_s if source.period_s is None else max(limit_s, MISSED_PERIODS * source.period_s)


def between_of(role: str, source: Source, *, has_steps: bool) -> Between | None:
    """Return what a role is between two reports, None where the last one is held.

    has_steps: whether the transmission has gears; a ratio without them glides.
    """
    if source.period_s is None or role in LASTING:
        return None
    if role in _CLOSES_ON:
        return larger
    if role in _CLOSES_OFF:
        return smaller
    if role == "gear_ratio" and not has_steps:
        return line
    if role in ("gear", "gear_ratio"):
        return unchanged
    return earlier if role in _NOTHING_BETWEEN or source.map else line


def wait_us(source: Source) -> int:
    """Return how long a report waits for the next one: a period, and what it may come late by."""
    if source.period_s is None:
        return 0
    return round(source.period_s * (1.0 + LATE_PERIODS) * 1e6)
