"""What every publisher does with a live stream: reads its rows, and notices when the source is gone."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any, NamedTuple

from canest.core.gates import LABELS, Gate
from canest.node.estimate_frame import NOT_AVAILABLE_STATUS, STATUS_NAMES
from canest.serve.history import WallClock
from canest.telemetry.live_protocol import DECIMALS, Row
from canest.telemetry.status_text import NOT_AVAILABLE

CHECK_S = 0.5
SILENT_S = 1.2  #: a source without a message for so long does not answer
QUIET_S = 2.0  #: without a frame, or an estimate of now, for so long there is none
#: numbers of an estimate, in the order of a row
NUMBERS = tuple(name for name in DECIMALS if name not in ("t_s", "status", "gate"))


class LiveEstimate(NamedTuple):
    """An estimate of now.

    t_s: UTC. numbers: of `NUMBERS`, None where there is none. status, gate: code and name.
    """

    t_s: float
    numbers: dict[str, float | None]
    status: tuple[int, str]
    gate: tuple[int, str]


class Pace:
    """Lets at most so many through a second, on a raster: 5 a second give 1 a second, and not 5 in 6 s."""

    def __init__(self, rate_hz: float) -> None:
        self._pause_s, self._due_s = 1.0 / rate_hz, 0.0

    def is_due(self) -> bool:
        """Return whether the next one may go, and count it as gone."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return False
        self._due_s = max(self._due_s + self._pause_s, now_s + 0.5 * self._pause_s)
        return True


class Follower:
    """Takes messages of `canest.telemetry.live_protocol` and calls the three methods below with what is new.

    problem: why there is no source now ('' when there is one).
    """

    def __init__(self, source: str) -> None:
        self.source = source
        self.problem = f"waiting for {source}"
        self._columns: list[str] = []
        self._clock = WallClock()
        self._message_s = 0.0
        self._row_s = -math.inf  #: when the source last had an estimate of now

    def on_estimate(self, estimate: LiveEstimate) -> None:
        """Take an estimate, as often as the source has one; one without numbers where none is of now."""

    def on_status(self, status: dict[str, Any]) -> None:
        """Take the snapshot of `canest status --json`, once a second."""

    def on_source(self) -> None:
        """Note that `problem` has changed."""

    def take(self, message: dict[str, Any]) -> None:
        """Take one message. Errors: ValueError, KeyError, TypeError for one that is none."""
        self._message_s = time.monotonic()
        if self.problem:
            self.problem = ""
            self.on_source()
        if "rows" in message:
            quiet_s = message["quiet_s"] or 0.0
            if message["newest"] is not None:
                self._row_s = self._message_s
                self.on_estimate(self._estimate(message["newest"], quiet_s))
            elif message["quiet_s"] is None or max(quiet_s, self._message_s - self._row_s) > QUIET_S:
                self.on_estimate(nothing())
        elif "status" in message:
            self.on_status(message["status"])
        elif "columns" in message:
            self._columns = list(message["columns"])

    def lose(self, problem: str) -> None:
        """Note that the source is gone, and why."""
        if problem != self.problem:
            self.problem = problem
            self.on_source()

    async def check(self) -> None:
        """Notice a source that is connected and silent, for ever."""
        while True:
            await asyncio.sleep(CHECK_S)
            silent_s = time.monotonic() - self._message_s
            if not self.problem and silent_s > SILENT_S:
                self.lose(f"{self.source} has sent nothing for more than {SILENT_S:g} s")

    def _estimate(self, row: Row, quiet_s: float) -> LiveEstimate:
        values = dict(zip(self._columns, row, strict=True))
        newest_s = float(values["t_s"] or 0.0)
        t_s = self._clock.utc_s(newest_s, newest_s, time.time() - quiet_s)
        status, gate = values["status"], values["gate"]
        code = NOT_AVAILABLE_STATUS if status is None else int(status)
        return LiveEstimate(
            t_s,
            {name: values.get(name) for name in NUMBERS},
            (code, STATUS_NAMES[code]),
            (int(gate), LABELS[int(gate)]) if gate in LABELS else _NO_GATE,
        )


_NO_GATE = (int(Gate.STALE), NOT_AVAILABLE)


def nothing() -> LiveEstimate:
    """Return that there is no estimate of now."""
    return LiveEstimate(
        round(time.time(), 2),
        dict.fromkeys(NUMBERS),
        (NOT_AVAILABLE_STATUS, STATUS_NAMES[NOT_AVAILABLE_STATUS]),
        (int(Gate.STALE), Gate.STALE.label),
    )
