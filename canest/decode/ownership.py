"""Who owns a role when the config names no source address and several addresses send the group.

The first address that sends a valid value owns the role, and keeps it until it has sent no valid value
for `SILENT_US` of event time; then the next address that does takes over. While nobody owns the role, a
"not available" from anybody counts as one: it shows that the signal is there without a number. The rule
looks at one sample at a time, so it does not depend on how the stream is cut.
"""

from __future__ import annotations

from dataclasses import dataclass

SILENT_US = 5_000_000  #: no valid value for this long ends the ownership


@dataclass(slots=True)
class Owner:
    """The owner of one role: its address and the event time of its last valid value."""

    address: int | None = None
    last_us: int = 0

    def accepts(self, t_us: int, address: int, valid: bool) -> bool:
        """Take note of a sample and return whether it counts for the role."""
        if address != self.address and self.address is not None and 0 <= t_us - self.last_us <= SILENT_US:
            return False
        if valid:
            self.address, self.last_us = address, t_us
        return True
