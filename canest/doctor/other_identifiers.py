"""Messages that a bus carries under another identifier, or in another frame format, than the DBC declares."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from canest.decode import j1939
from canest.decode.database import is_j1939
from canest.decode.groups import exact_id
from canest.pipeline.signal_map import J1939_DATABASE, signal_of

if TYPE_CHECKING:
    from cantools.database.can import Message

    from canest.config import Config
    from canest.decode.counters import Counters
    from canest.doctor.received import Received
    from canest.doctor.signal_report import RoleReport

#: bit of a DBC's message number that makes its identifier one of 29 bits
_EXTENDED_IN_DBC = 1 << 31
#: identifiers that are named
_SHOWN = 4


def other_format(config: Config, role: str, counters: Counters) -> str:
    """Return that a role's identifier came in frames of the other format, '' where it did not."""
    message = message_of(config, role)
    if message is None or is_j1939(message) or exact_id(message) not in counters.other_format:
        return ""
    came, declared = ("11-bit", "a 29-bit") if message.is_extended_frame else ("29-bit", "an 11-bit")
    number = message.frame_id | (0 if message.is_extended_frame else _EXTENDED_IN_DBC)
    return (
        f"its identifier 0x{message.frame_id:X} came in {came} frames, and the DBC declares {declared} one: "
        f"in a DBC for this bus it is BO_ {number}"
    )


def unknown_identifiers(config: Config, reports: Iterable[RoleReport], received: Received) -> list[str]:
    """Return which messages of roles that matter never came, and the nearest identifiers that no message has.

    Only those of 11 bits; nothing where no message of the config came, as on another vehicle's bus.
    """
    absent, reports = {}, list(reports)
    came = {report.need for report in reports if report.senders}
    for report in reports:  # of speeds and ways to the ratio, one is enough
        message = message_of(config, report.role)
        matters = report.need == "needed" or report.need not in {"optional", *came}
        if matters and message is not None and not message.is_extended_frame:
            absent[message.frame_id] = message.name
    known = {m.frame_id for base in config.databases for m in base.messages if not m.is_extended_frame}
    unknown = received.standard_ids.keys() - known
    if not unknown or not came:
        return []
    found = []
    for frame_id in absent.keys() - received.standard_ids.keys():
        nearest = sorted(unknown, key=lambda number: abs(number - frame_id))[:_SHOWN]
        rates = (received.standard_ids[number] / (received.duration_s or 1.0) for number in nearest)
        shown = ", ".join(f"0x{n:X} ({rate:.3g}/s)" for n, rate in zip(nearest, rates, strict=True))
        found.append(
            f"0x{frame_id:X} ({absent[frame_id]}) never came, and the bus has {shown}, which no message of "
            "the DBC has"
        )
    return found


def other_group_members(config: Config, reports: Iterable[RoleReport], pgns: Collection[int]) -> list[str]:
    """Return that messages which are matched by their whole identifier are there under others.

    pgns: the parameter groups that were received.
    """
    found = [
        report.expected
        for report in reports
        if not report.senders
        and (message := message_of(config, report.role)) is not None
        and message.is_extended_frame
        and not is_j1939(message)
        and j1939.pgn_of(message.frame_id) in pgns
    ]
    if not found:
        return []
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return [
        f"{found[0]}{more} is matched by its whole identifier, and the bus has its parameter "
        f"group under others: to take it from them needs {J1939_DATABASE}"
    ]


def message_of(config: Config, role: str) -> Message | None:
    """Return the message that carries a role, None for a column of a table."""
    found = signal_of(config, role)
    return None if found is None else found[0]
