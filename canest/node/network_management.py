"""A well-behaved J1939 node: owns an address before it speaks, answers requests, yields a used group."""

from __future__ import annotations

from collections import Counter, deque

from canest.config.bus import Broadcast
from canest.decode import j1939
from canest.node.address_claim import CLAIM_PGN, AddressClaim, Frame, encode_name
from canest.node.bus_monitor import BusWatch

#: before the first broadcast: long enough to hear anybody who sends in our group once a second
LISTEN_US = 1_500_000
#: after a foreign user of our group has fallen silent for this long, the group is free
QUIET_US = 60_000_000

_ACKNOWLEDGE_PGN = 0xE800  #: 59392
_NACK = 1  #: control byte: the group asked for is not supported
_ANSWERS_QUEUED = 8  #: unsupported requests waiting for an answer; more are dropped and counted
_ANSWER_EVERY_US = 100_000


class Citizen:
    """Decides when and from which address anything may be sent.

    groups: parameter groups that may be asked of us. Times are microseconds of a monotonic clock.
    """

    def __init__(self, broadcast: Broadcast, groups: frozenset[int]) -> None:
        self.claim = AddressClaim(encode_name(broadcast.name), broadcast.preferred_address)
        self._groups = groups
        self._own_pgn = broadcast.pgn
        self.counters: Counter[str] = Counter()
        #: groups of ours that were asked for since the last look; the broadcaster takes them
        self.requested: set[int] = set()
        self.group_user: int | None = None  #: address that uses our group since before we did
        self._listening_since_us = 0
        self._spoken = False
        self._answers: deque[tuple[int, int]] = deque()
        self._answer_at_us = 0

    def start(self, now_us: int) -> None:
        """The bus is there (again): claim an address, listen before speaking."""
        self._listening_since_us = now_us
        self._spoken = False
        self.claim.start(now_us)

    def observe(self, watch: BusWatch, now_us: int) -> None:
        """Take what the last frames said to nodes."""
        for source, name in watch.claims:
            self.claim.on_claim(source, name, now_us)
        for request in watch.requests:
            if request.destination in (j1939.GLOBAL_ADDRESS, self.claim.address):
                self._asked(request.source, request.pgn, request.destination != j1939.GLOBAL_ADDRESS, now_us)
        self._watch_group(watch, now_us)

    def poll(self, now_us: int, awake_us: int | None = None) -> list[Frame]:
        """Return the frames that a node owes the bus now (times as in `AddressClaim.poll`)."""
        frames = self.claim.poll(now_us, awake_us)
        address = self.claim.address
        if address is not None and self._answers and now_us >= self._answer_at_us:
            asker, pgn = self._answers.popleft()
            self._answer_at_us = now_us + _ANSWER_EVERY_US
            payload = bytes([_NACK, 0xFF, 0xFF, 0xFF, asker]) + pgn.to_bytes(3, "little")
            frames.append((j1939.pack(_ACKNOWLEDGE_PGN, address), payload))
        return frames

    def address_to_speak_from(self, now_us: int) -> int | None:
        """Return the address to broadcast from, None while we have to be silent."""
        if self.silence(now_us):
            return None
        self._spoken = True
        return self.claim.address

    def silence(self, now_us: int) -> str:
        """Return in plain words why nothing is broadcast ('' when something is)."""
        if self.claim.address is None:
            return f"no address ({self.claim.reason or self.claim.state.value})"
        if self.group_user is not None:
            return f"PGN {self._own_pgn:#x} is already used from address {self.group_user:#04x}"
        if now_us - self._listening_since_us < LISTEN_US:
            return "listening before the first broadcast"
        return ""

    def _asked(self, asker: int, pgn: int, personally: bool, now_us: int) -> None:
        if pgn == CLAIM_PGN:
            self.counters["requests_for_claim"] += 1
            self.claim.on_request(now_us)
        elif pgn in self._groups:
            self.counters["requests_for_our_groups"] += 1
            self.requested.add(pgn)
        elif personally and len(self._answers) < _ANSWERS_QUEUED:
            self._answers.append((asker, pgn))
        elif personally:
            self.counters["requests_unanswered"] += 1

    def _watch_group(self, watch: BusWatch, now_us: int) -> None:
        for source in [s for s, heard in watch.group_users.items() if now_us - heard > QUIET_US]:
            del watch.group_users[source]
        others = [s for s in watch.group_users if s != self.claim.address]
        if not others:
            self.group_user = None
        elif not self._spoken:
            self.group_user = others[0]
        # who comes after us is reported, but does not silence us: else one forged frame could
