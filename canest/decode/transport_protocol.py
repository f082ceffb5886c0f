"""Reassembles multi-packet parameter groups: BAM, and RTS/CTS sessions between other nodes (SAE J1939-21).

A broken session is dropped and counted, never repaired: one wrong byte in a reference torque is worse
than a message that comes again in five seconds. Time is event time; nothing here raises.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from canest.decode.j1939 import GLOBAL_ADDRESS

RTS, CTS, BAM, ABORT = 16, 17, 32, 255  #: control bytes of TP.CM
PACKET_BYTES = 7
SMALLEST, LARGEST = 9, 1785  #: bytes that a multi-packet message may have
BAM_SILENCE_US = 750_000  #: T1: longest gap between two packets of a broadcast
SESSION_SILENCE_US = 1_250_000  #: T2, T3: longest gap within a destination-specific session
MAX_SESSIONS = 64  #: more at once is no vehicle but a fault; the oldest goes


@dataclass(slots=True)
class _Session:
    pgn: int
    size: int
    packets: int
    last_us: int
    silence_us: int
    chunks: list[bytes] = field(default_factory=list)


class Transport:
    """Sessions of all addresses.

    wanted: (PGN, source address) -> whether its messages are worth keeping.
    on_error: called with (PGN, source address) when a wanted session is dropped.
    counts: how sessions ended: complete, sequence, duplicate, timeout, superseded, size, aborted, evicted;
    and frames passed over, since they came again as they were (in a log of two interfaces all do): repeated.
    """

    def __init__(self, wanted: Callable[[int, int], bool], on_error: Callable[[int, int], None]) -> None:
        self._wanted, self._on_error = wanted, on_error
        self._sessions: dict[tuple[int, int], _Session] = {}  # (source, destination)
        self.counts: dict[str, int] = {}

    @property
    def open_sessions(self) -> int:
        """Return how many messages are waiting for packets."""
        return len(self._sessions)

    def manage(self, t_us: int, source: int, destination: int, length: int, word: int) -> None:
        """Take a TP.CM frame (``word``: its payload as a little-endian integer)."""
        control = word & 0xFF
        if length != 8:
            return  # names no session that could be trusted
        pgn = word >> 40
        if control in (BAM, RTS):
            self._open(t_us, source, destination, control, word, pgn)
        elif control == CTS:
            self._clear(t_us, destination, source, word)
        elif control == ABORT:
            for key in ((source, destination), (destination, source)):
                session = self._sessions.get(key)
                if session is not None and session.pgn == pgn:
                    self._drop(key, "aborted")

    def packet(
        self, t_us: int, source: int, destination: int, length: int, word: int
    ) -> tuple[int, bytes] | None:
        """Take a TP.DT frame; return (PGN, payload) when it completes a message."""
        key = (source, destination)
        session = self._sessions.get(key)
        if session is None:
            return None
        expected = len(session.chunks) + 1
        number = word & 0xFF
        if abs(t_us - session.last_us) > session.silence_us:
            self._drop(key, "timeout")
            return None
        if length != 8:
            self._drop(key, "size")
            return None
        chunk = (word >> 8).to_bytes(PACKET_BYTES, "little")
        if number != expected:
            again = 0 < number == expected - 1
            if again and chunk == session.chunks[-1]:
                self._count("repeated")
            else:
                self._drop(key, "duplicate" if again else "sequence")
            return None
        session.chunks.append(chunk)
        session.last_us = t_us
        if number < session.packets:
            return None
        del self._sessions[key]
        self._count("complete")
        return session.pgn, b"".join(session.chunks)[: session.size]

    def _open(self, t_us: int, source: int, destination: int, control: int, word: int, pgn: int) -> None:
        broadcast = control == BAM
        if broadcast != (destination == GLOBAL_ADDRESS):
            return
        key = (source, destination)
        size, packets = (word >> 8) & 0xFFFF, (word >> 24) & 0xFF
        before = self._sessions.get(key)
        if before is not None:
            if not before.chunks and (before.pgn, before.size, before.packets) == (pgn, size, packets):
                before.last_us = t_us
                self._count("repeated")
                return
            self._drop(key, "superseded")
        if not self._wanted(pgn, source):
            return
        if not SMALLEST <= size <= LARGEST or packets != -(-size // PACKET_BYTES):
            self._count("size")
            self._on_error(pgn, source)
            return
        if len(self._sessions) >= MAX_SESSIONS:
            self._drop(next(iter(self._sessions)), "evicted")
        silence_us = BAM_SILENCE_US if broadcast else SESSION_SILENCE_US
        self._sessions[key] = _Session(pgn, size, packets, t_us, silence_us)

    def _clear(self, t_us: int, source: int, destination: int, word: int) -> None:
        """The receiver asks for packets; it may ask for some again."""
        session = self._sessions.get((source, destination))
        if session is None or session.pgn != word >> 40:
            return
        session.last_us = t_us
        wanted_count, first = (word >> 8) & 0xFF, (word >> 16) & 0xFF
        if wanted_count and 1 <= first <= len(session.chunks):
            del session.chunks[first - 1 :]

    def _drop(self, key: tuple[int, int], reason: str) -> None:
        session = self._sessions.pop(key)
        self._count(reason)
        self._on_error(session.pgn, key[0])

    def _count(self, reason: str) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + 1
