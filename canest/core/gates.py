"""The gates: why the estimator does not learn from a sample. Codes are those of `dbc/canest.dbc`."""

from __future__ import annotations

from enum import IntEnum


class Gate(IntEnum):
    """Reasons. Where several hold at once, the first in order of precedence is named."""

    OPEN = 0
    STALE = 1  #: a required signal is older than its limit, or has never been seen
    INVALID = 2  #: a required signal is "not available" or "error", or out of range
    REVERSE = 3
    LOW_SPEED = 4
    BRAKE = 5  #: service or parking brake, ABS, traction control
    SHIFT = 6
    DRIVELINE = 7  #: not engaged, not locked up, clutch slipping, or speeds not in a gear's ratio
    RETARDER = 8
    PTO = 9
    TURNING = 10
    IMPLAUSIBLE = 11  #: two signals that must agree do not, or one jumps beyond physics
    LOW_EXCITATION = 12
    RECOVERY = 13  #: nothing wrong any more, but the filters still hold what was
    POSSIBLE_BRAKE = 14  #: no brake is mapped, and the vehicle may be braking

    @property
    def label(self) -> str:
        """Return the name used in est.csv, summary.json and configs ('' when open)."""
        return "" if self is Gate.OPEN else self.name.lower()


LABELS: dict[int, str] = {int(g): g.label for g in Gate}
