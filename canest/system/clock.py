"""A clock that nobody sets."""

from __future__ import annotations

import time


def elapsed_s() -> float:
    """Return a time in s that no clock's adjustment changes, and that goes on while the machine sleeps."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()
