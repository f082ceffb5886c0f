"""Sends the estimate: `CanestEstimate` in our own group, and where configured SPN 1760 and SPN 7432.

Sending never waits: a frame that the interface does not take at once is dropped and counted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Set

from canest.config.bus import Broadcast
from canest.core.samples import Status
from canest.decode import j1939
from canest.node.address_claim import Frame
from canest.node.bus_monitor import CVW_LARGEST, CVW_PGN, CVW_STEP_KG
from canest.node.estimate_frame import Estimate, encode

PCC1_PGN = 61651  #: Predictive Cruise Control 1
FRESH_US = 400_000  #: an estimate older than this is no estimate of now

_NOT_AVAILABLE_8 = 0xFF
_AT_ONCE = -(1 << 62)
_PRIORITY = {CVW_PGN: 6, PCC1_PGN: 3}
_GRADE_STEP, _GRADE_OFFSET, _GRADE_LARGEST = 0.00125, -0.16, 0xFA  #: SPN 7432, byte 4
_CVW_PERIOD_US, _PCC1_PERIOD_US = 1_000_000, 100_000


class Broadcaster:
    """Turns the newest estimate into the frames that are due.

    Call `frames` once per tick with the time of a monotonic clock (us) and the address we own.
    """

    def __init__(self, broadcast: Broadcast) -> None:
        self._config = broadcast
        self._counter = 0
        self._estimate = Estimate()
        self._estimated_us: int | None = None
        self.counters: Counter[str] = Counter()
        self._timers = {broadcast.pgn: _SendTimer(round(1e6 / broadcast.rate_hz))}
        if broadcast.cvw:
            self._timers[CVW_PGN] = _SendTimer(_CVW_PERIOD_US)
        if broadcast.pcc1:
            self._timers[PCC1_PGN] = _SendTimer(_PCC1_PERIOD_US)
        self.due_us = _AT_ONCE  #: when `frames` has something to send

    @property
    def groups(self) -> frozenset[int]:
        """Return the parameter groups we send."""
        return frozenset(self._timers)

    def set_estimate(self, estimate: Estimate, now_us: int) -> None:
        """Keep the newest estimate and when it came."""
        self._estimate, self._estimated_us = estimate, now_us

    def current(self, now_us: int) -> Estimate:
        """Return what may be sent now: the newest estimate while it is fresh, else "not available"."""
        if self._estimated_us is None or now_us - self._estimated_us > FRESH_US:
            return Estimate()
        return self._estimate

    def available(self, now_us: int, taken: Set[int] = frozenset()) -> frozenset[int]:
        """Return the groups that can be sent now: without those ``taken``, or with nothing valid to send."""
        estimate = self.current(now_us)
        own = {self._config.pgn}
        standard = {pgn for pgn in self._timers if _standard_payload(pgn, estimate) is not None}
        return frozenset((own | standard) - taken)

    def frames(
        self, now_us: int, address: int, requested: Set[int], taken: Set[int] = frozenset()
    ) -> list[Frame]:
        """Return the frames due now, sent from ``address``.

        Groups in ``requested`` are due at once; those in ``taken`` are others' to send, and left to them.
        """
        estimate = self.current(now_us)
        frames = []
        for pgn, timer in self._timers.items():
            if timer.due(now_us, pgn in requested):
                if pgn in taken:
                    self.counters["left_to_other_senders"] += 1
                    continue
                frame = self._frame(pgn, address, estimate)
                if frame is not None:
                    frames.append(frame)
        self.due_us = min(timer.next_us for timer in self._timers.values())
        return frames

    def _frame(self, pgn: int, address: int, estimate: Estimate) -> Frame | None:
        if pgn == self._config.pgn:
            can_id = j1939.pack(pgn, address, self._config.priority)
            payload = encode(estimate, self._counter, can_id)
            self._counter = (self._counter + 1) % 16
            return can_id, payload
        standard = _standard_payload(pgn, estimate)
        return None if standard is None else (j1939.pack(pgn, address, _PRIORITY[pgn]), standard)


def _standard_payload(pgn: int, estimate: Estimate) -> bytes | None:
    """Return what is sent in a group of the standard, None where nothing is."""
    # other ECUs act on a standard parameter: only a valid estimate is sent there
    if estimate.status != Status.VALID:
        return None
    if pgn == CVW_PGN:
        return cvw_payload(estimate.mass_kg)
    return pcc1_payload(estimate.grade) if pgn == PCC1_PGN else None


def cvw_payload(mass_kg: float) -> bytes | None:
    """Return PGN 65136 with SPN 1760 and nothing else; None when the mass does not fit."""
    raw = _steps(mass_kg / CVW_STEP_KG, CVW_LARGEST)
    if raw is None:
        return None
    return bytes([_NOT_AVAILABLE_8] * 2) + raw.to_bytes(2, "little") + bytes([_NOT_AVAILABLE_8] * 4)


def pcc1_payload(grade: float) -> bytes | None:
    """Return PGN 61651 with SPN 7432 and nothing else; None when the grade does not fit."""
    raw = _steps((grade - _GRADE_OFFSET) / _GRADE_STEP, _GRADE_LARGEST)
    return None if raw is None else bytes([_NOT_AVAILABLE_8] * 3 + [raw] + [_NOT_AVAILABLE_8] * 4)


def _steps(steps: float, largest: int) -> int | None:
    return None if math.isnan(steps) or not 0 <= steps <= largest else round(steps)


class _SendTimer:
    """When the next frame of one group is due; on request earlier, but not in a flood."""

    def __init__(self, period_us: int) -> None:
        self._period_us = period_us
        self.next_us = _AT_ONCE
        self._sent_us = 0

    def due(self, now_us: int, requested: bool) -> bool:
        if now_us - self.next_us > self._period_us:  # a missed period is not made up for
            self.next_us = now_us
        on_time = now_us >= self.next_us
        if on_time:
            self.next_us += self._period_us
        elif not (requested and now_us - self._sent_us >= min(_PCC1_PERIOD_US, self._period_us)):
            return False
        self._sent_us = now_us
        return True
