"""What every bus has in common: its two halves, and what is asked of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from canest.bus.kernel_drain import Drained

Filters = Sequence[tuple[int, int]]  #: (id, mask) with flags, as in Linux' struct can_filter

#: states of a bus that carries frames
UP = ("up", "error-passive")
REOPEN_S = 0.5  #: longest wait between attempts to open an interface that is not there


class Receiver(Protocol):
    """The receiving half of a bus. It has no way to send: a listen-only daemon holds nothing else.

    state: "up", "down", "absent", "error-passive" or "bus-off".
    reason: why it is absent, in the words of the system or driver; '' when unknown, or when it is there.
    opened: how often the interface has been opened (a change means: another bus may be behind it).
    counters: what happened, by name.
    """

    state: str
    reason: str
    opened: int
    counters: Counter[str]

    @property
    def max_poll_interval_us(self) -> int:
        """Longest time between two calls of `collect`, us: one tick where the buffer's size is unknown."""

    def collect(self) -> bool:
        """Take what has arrived out of the interface's own small buffer; False: `drain` has to follow now."""

    def drain(self) -> Drained:
        """Return what has arrived. Never blocks, never raises: an interface that is gone is reopened."""

    def close(self) -> None:
        """Let the interface go."""


def bus_state(receiver: Receiver) -> str:
    """Return the state of a bus, with the reason where there is one."""
    return f"{receiver.state}: {receiver.reason}" if receiver.reason else receiver.state


class Transmitter(Protocol):
    """The sending half of a bus."""

    counters: Counter[str]

    def send(self, can_id: int, payload: bytes) -> bool:
        """Send one frame if the interface takes it at once; False when it was dropped (and counted)."""

    @property
    def waiting(self) -> int:
        """Return how many frames the interface has taken that are not on the bus yet."""

    def failed(self) -> list[int]:
        """Return the identifiers of frames that were taken and never sent, since the last call."""

    def drop_waiting(self) -> None:
        """Send none of the frames that wait: they are of an address that was lost."""
