"""What has changed while nobody looked: status, source, bus and config, with the time of each change."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

MOST = 100  #: that are kept
QUIET_S = 2.0  #: a bus without a frame for so long is quiet


class Change(NamedTuple):
    """A change. t_s: UTC."""

    t_s: float
    text: str


class Changes:
    """The last `MOST` changes. Each thing is compared with what it was, and noted where it differs.

    noted: called with every new one.
    """

    def __init__(self, noted: Callable[[Change], None]) -> None:
        self.last: deque[Change] = deque(maxlen=MOST)
        self._noted = noted
        self._before: dict[str, Any] = {}

    def of_source(self, problem: str) -> None:
        """Note a source that is lost, and why, or that is there ('')."""
        self._compare("source", bool(problem), f"no data: {problem}" if problem else "the source answers")

    def of_rows(self, status: str | None, quiet_s: float | None) -> None:
        """Note the status of the newest estimate, and a bus that is quiet. None: not known."""
        if status is not None:
            self._compare("status", status, f"status {status}")
        if quiet_s is not None:
            quiet = quiet_s > QUIET_S
            self._compare("quiet", quiet, "no frame on the bus" if quiet else "frames on the bus")

    def of_snapshot(self, status: dict[str, Any]) -> None:
        """Note the bus, the config and errors that were survived, of a snapshot."""
        bus = status.get("bus", {})
        if state := bus.get("state"):
            reason = f": {bus['reason']}" if bus.get("reason") else ""
            self._compare("bus", state, f"bus {bus.get('channel', '')} {state}{reason}")
        refused = status.get("reload_refused_because", "")
        self._compare("config", refused, f"config refused: {refused}" if refused else "config in force")
        failures = status.get("failures", 0)
        self._compare("failures", failures, f"{failures} errors inside the estimation were survived")

    def _compare(self, what: str, value: Any, text: str) -> None:
        usual = {"source": False, "quiet": False, "config": "", "failures": 0, "bus": "up"}
        if value == self._before.get(what, usual.get(what)):
            return
        self._before[what] = value
        change = Change(round(time.time(), 1), text)
        self.last.append(change)
        self._noted(change)
