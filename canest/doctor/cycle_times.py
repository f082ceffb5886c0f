"""Whether the time stamps run too fast or too slowly, by how often the messages of a J1939 bus come."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from canest.decode.database import is_j1939
from canest.doctor.other_identifiers import message_of

if TYPE_CHECKING:
    from canest.config import Config
    from canest.doctor.signal_report import RoleReport

#: messages that must agree, the share of all that do, and how well
_LEAST, _MOST_OF_THEM, _ALIKE = 3, 0.75, 0.04
#: an ECU may be slower or faster by so much
_USUAL = 0.15


class _Rate(NamedTuple):
    message: str
    rate_hz: float
    declared_hz: float

    @property
    def times(self) -> float:
        return self.rate_hz / self.declared_hz


def clock_hints(config: Config, reports: Iterable[RoleReport]) -> list[str]:
    """Return that the messages come as if another clock had stamped them, in a sentence; [] where not.

    One ECU may send at a rate of its own. Most messages of a bus, all faster by one factor, are a clock.
    """
    rates: dict[str, _Rate] = {}
    for report in reports:
        message = message_of(config, report.role) if not report.from_table else None
        mine = [s for s in report.senders if report.source in (None, s.address) and s.rate_hz]
        if message is None or not mine or not message.cycle_time or not is_j1939(message):
            continue
        rates.setdefault(message.name, _Rate(message.name, mine[0].rate_hz or 0.0, 1e3 / message.cycle_time))
    times = sorted(rate.times for rate in rates.values())
    if len(times) < _LEAST:
        return []
    middle = times[len(times) // 2]
    alike = [rate for rate in rates.values() if abs(math.log(rate.times / middle)) < _ALIKE]
    if abs(math.log(middle)) < _USUAL or len(alike) < max(_LEAST, _MOST_OF_THEM * len(times)):
        return []
    shown = ", ".join(f"{r.message} {r.rate_hz:.3g} for {r.declared_hz:.3g} per second" for r in alike[:3])
    why = (
        "do the time stamps run too slowly?" if middle > 1.0 else "do they run too fast, or are frames lost?"
    )
    return [
        f"{len(alike)} of {len(times)} messages come {middle:.2g} times as often as the DBC declares "
        f"({shown}): {why} All speeds and accelerations, and so the mass, depend on the time stamps"
    ]
