"""What the decoder counts: per sender, per signal, and what it could attribute to nobody."""

from __future__ import annotations

from dataclasses import dataclass, field

from canest.core.frames import IntColumn

#: a sender without a frame for longer is silent, or the clock was set
LONGEST_US = 60_000_000


@dataclass(slots=True)
class SignalCounters:
    """One role as one address sends it.

    Each sample counts once as valid, not_available or error_value; not_owner counts those that did not
    become samples of the role because another address owns it (only without a configured source).
    """

    valid: int = 0
    not_available: int = 0
    error_value: int = 0  #: in the indicator range, yet not "not available"; or text that names no gear
    not_owner: int = 0


@dataclass(slots=True)
class SenderCounters:
    """One parameter group (or exact identifier) from one address.

    used: False when the config names another source for everything that this group carries.
    frames: data frames or reassembled messages; first_us, last_us: their event time, for the rate. Where the
    clock steps, or the sender is silent for long, first_us is moved along: that was no time in which it sent.
    """

    used: bool
    frames: int = 0
    wrong_length: int = 0
    remote_frames: int = 0
    unknown_mux: int = 0
    transport_errors: int = 0
    first_us: int | None = None
    last_us: int | None = None
    roles: dict[str, SignalCounters] = field(default_factory=dict)

    def take(self, t_us: IntColumn) -> None:
        """Count frames of one sender by their stamps (n,), at least one."""
        self.frames += len(t_us) - 1
        self.take_one(int(t_us[0]))
        assert self.first_us is not None
        steps = t_us[1:] - t_us[:-1]
        if steps.min(initial=0) < 0 or steps.max(initial=0) > LONGEST_US:
            self.first_us += int(steps[(steps < 0) | (steps > LONGEST_US)].sum())
        self.last_us = int(t_us[-1])

    def take_one(self, t_us: int) -> None:
        """Count one frame."""
        self.frames += 1
        if self.first_us is None or self.last_us is None:
            self.first_us = t_us
        elif not 0 <= t_us - self.last_us <= LONGEST_US:
            self.first_us += t_us - self.last_us
        self.last_us = t_us

    @property
    def not_available(self) -> int:
        """Samples sent as "not available", over all roles."""
        return sum(r.not_available for r in self.roles.values())

    @property
    def error_value(self) -> int:
        """Samples in the error range, over all roles."""
        return sum(r.error_value for r in self.roles.values())

    @property
    def rate_Hz(self) -> float | None:
        """Mean rate from the first to the last frame, None before the second."""
        if self.first_us is None or self.last_us is None or self.last_us <= self.first_us:
            return None
        return (self.frames - 1) * 1e6 / (self.last_us - self.first_us)


@dataclass(slots=True)
class Counters:
    """Everything a decoder counted.

    frames: all frames it was given; wanted: data frames of the wanted groups, from any address.
    senders: (PGN, or exact identifier with its `EXTENDED` flag; source address, or None) -> counters.
    other_format: wanted exact identifiers that came in the other frame format, of 29 bits instead of 11 or of
    11 instead of 29.
    transport: reason -> multi-packet sessions that ended so (see `canest.decode.transport_protocol`).
    """

    frames: int = 0
    wanted: int = 0
    error_frames: int = 0
    senders: dict[tuple[int, int | None], SenderCounters] = field(default_factory=dict)
    other_format: set[int] = field(default_factory=set)
    transport: dict[str, int] = field(default_factory=dict)

    def of_role(self, role: str) -> dict[int | None, SignalCounters]:
        """Return the counters of one role per source address."""
        return {sa: s.roles[role] for (_, sa), s in self.senders.items() if role in s.roles}

    @property
    def other_senders(self) -> dict[tuple[int, int | None], int]:
        """Frames of wanted groups from addresses that the config does not name."""
        return {key: s.frames for key, s in self.senders.items() if not s.used and s.frames}

    def contested(self) -> dict[str, dict[int | None, int]]:
        """Return role -> address -> samples that were refused because another address owns the role."""
        found: dict[str, dict[int | None, int]] = {}
        for (_, source), sender in self.senders.items():
            for role, counted in sender.roles.items() if sender.used else ():
                if counted.not_owner:
                    found.setdefault(role, {})[source] = counted.not_owner
        return found

    def lost(self) -> dict[str, int]:
        """Frames that could not be decoded, by why; nothing for what did not happen."""
        senders = self.senders.values()
        counts = {
            "frames of wrong length": sum(s.wrong_length for s in senders),
            "frames of unknown multiplexor": sum(s.unknown_mux for s in senders),
            "remote frames": sum(s.remote_frames for s in senders),
            "broken multi-packet messages": sum(s.transport_errors for s in senders),
            "error frames": self.error_frames,
        }
        return {what: n for what, n in counts.items() if n}
