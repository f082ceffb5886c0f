"""What was found of one role, what that means, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canest.core.roles import COMPARED

if TYPE_CHECKING:
    from canest.config.sections import Source
    from canest.decode.counters import Counters, SenderCounters
    from canest.decode.value_table import Label

OK, SILENT, ABSENT, ELSEWHERE, SEVERAL = "ok", "no value", "not found", "elsewhere", "several"
REFUSED = "refused"
#: of frames that are received, and give no sample of a role
WHY_NOT_HELD = "they end before it, or their multiplexor never selects it"
#: a signal of which more than this share has no value deserves a hint
MOSTLY = 0.5
#: an address whose share of error values is larger sends something else under this group
SOUND = 0.01


@dataclass(slots=True)
class Sender:
    """One address (None: a table column, or an 11-bit identifier) that sends a role's message."""

    address: int | None
    rate_hz: float | None
    frames: int
    valid: int
    not_available: int
    error_value: int
    wrong_length: int
    unknown_mux: int = 0
    remote_frames: int = 0
    not_used: int = 0  #: samples that another address was preferred to
    low: float | None = None  #: range of its own values, in the role's unit
    high: float | None = None

    @property
    def used(self) -> int:
        """Samples of the role that come from this address."""
        return self.valid + self.not_available + self.error_value - self.not_used


@dataclass(slots=True)
class RoleReport:
    """What the log or bus has of one role.

    need: "needed", "speed" (one of these is needed), "ratio" (one way to the gear ratio is) or "optional".
    low, high: range of its values in the role's unit. labels: what the DBC or a table calls them.
    verdict: ok, no value, not found, elsewhere (another address has it), several (addresses send it, and the
    config names none), refused (most samples jump beyond physics). senders: the one in use first.
    """

    role: str
    text: str
    need: str
    expected: str
    source: int | None
    unit: str
    from_table: bool = False  # a column, where no address is to be expected
    senders: list[Sender] = field(default_factory=list)
    low: float | None = None
    high: float | None = None
    values: int = 0
    verdict: str = ABSENT
    hint: str = ""
    labels: list[Label] = field(default_factory=list)


def senders_of(counters: Counters, role: str, named: bool) -> list[Sender]:
    """Return who sends a role, by address.

    named: the config names the address that counts. Else the one in use is first.
    """
    owned = not named and role not in COMPARED
    found: list[tuple[int | None, SenderCounters]] = [
        (address, sender)
        for (_, address), sender in counters.senders.items()
        if role in sender.roles and sender.frames
    ]
    senders = [
        Sender(
            address,
            _rate_hz(sender, role),
            sender.frames,
            sender.roles[role].valid,
            sender.roles[role].not_available,
            sender.roles[role].error_value,
            sender.wrong_length,
            sender.unknown_mux,
            sender.remote_frames,
            sender.roles[role].not_owner if owned else 0,
        )
        for address, sender in sorted(found, key=lambda item: -1 if item[0] is None else item[0])
    ]
    return sorted(senders, key=lambda s: -s.used) if owned else senders


def _rate_hz(counters: SenderCounters, role: str) -> float | None:
    """Return how often an address sends a role: less often than its frames, where they are multiplexed."""
    first_us, last_us, seen = counters.first_us, counters.last_us, counters.roles[role]
    samples = seen.valid + seen.not_available + seen.error_value
    if first_us is None or last_us is None or last_us <= first_us or samples < 2:
        return None
    return (samples - 1) * 1e6 / (last_us - first_us)


def judge(entry: RoleReport, source: Source, stale_s: float, refused: int) -> tuple[str, str]:
    """Return the verdict on a role, and what to do about it.

    stale_s: how long its samples count. refused: how many of them jump beyond physics.
    """
    if refused > MOSTLY * entry.values:
        return REFUSED, (
            f"{refused:,} of {entry.values:,} samples jump beyond physics and are not used: is its unit, its "
            "factor or its byte order wrong?"
        )
    mine = [s for s in entry.senders if source.source in (None, s.address)]
    others = [s for s in entry.senders if s not in mine and _is_sound(s)]
    if entry.values:
        with_values = [s for s in mine if s.valid]
        if source.source is None and len(with_values) > 1 and entry.role not in COMPARED:
            shown = ", ".join(address_text(s.address) for s in with_values)
            used = address_text(with_values[0].address)
            return SEVERAL, f"several addresses send it ({shown}), {used} is used: name one with source:"
        bad = sum(s.not_available + s.error_value for s in mine)
        if bad > MOSTLY * (bad + entry.values):
            return OK, f"only {entry.values:,} of {bad + entry.values:,} samples hold a value"
        every_s = min((1.0 / s.rate_hz if s.rate_hz else 0.0 for s in with_values), default=0.0)
        if every_s > stale_s:
            return OK, f"comes every {every_s:.2g} s, and a value counts for {stale_s:g} s only (stale_s)"
        return OK, ""
    if others:
        best = max(others, key=lambda s: s.valid)
        where = address_text(best.address)
        return ELSEWHERE, f"{where} sends it with {best.valid:,} values: try source: {where}"
    if mine:
        return SILENT, _why_silent(mine)
    if entry.senders:
        shown = ", ".join(address_text(s.address) for s in entry.senders)
        return ABSENT, f"sent by {shown} only, and without a sound value"
    return ABSENT, ""


def _why_silent(senders: list[Sender]) -> str:
    """Return why senders that are received give no sample of a role, '' when their samples hold no value."""
    if all(s.wrong_length >= s.frames for s in senders):
        return "every frame has another length than the DBC declares"
    if not any(s.not_available + s.error_value for s in senders):
        return f"no frame holds it: {WHY_NOT_HELD}"
    return ""


def _is_sound(sender: Sender) -> bool:
    """Return whether an address sends values: nobody sends error codes and values in turns."""
    return sender.valid > 0 and sender.error_value <= SOUND * sender.valid


def complaint(entry: RoleReport) -> str:
    """Return what is wrong with a role that has no values, as the end of a sentence."""
    expected = entry.expected
    if entry.source is not None:
        expected += f" from {address_text(entry.source)}"
    if entry.verdict == SILENT:
        bad = sum(s.not_available for s in entry.senders if entry.source in (None, s.address))
        if bad:
            return f"was sent as not available in all {bad:,} frames of {expected}"
        return f"never had a valid value in {expected}" + (f" ({entry.hint})" if entry.hint else "")
    if entry.verdict == ELSEWHERE:
        return f"is not sent as {expected}, but {entry.hint}"
    return f"was not found as {expected}" + (f" ({entry.hint})" if entry.hint else "")


def address_text(address: int | None) -> str:
    """Return a source address for a person; None is a column of a table."""
    return "the table" if address is None else f"0x{address:02X}"
