"""J1939 network management: address before the first broadcast, answers to requests, our own group."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Set

from canest.config.bus import Broadcast
from canest.decode import j1939
from canest.node.address_claim import CLAIM_PGN, AddressClaim, Frame, encode_name
from canest.node.bus_monitor import BusMonitor, Request

#: before the first broadcast: long enough to receive from anybody who sends in our group once a second
LISTEN_US = 1_500_000
#: without a frame from another user of our group for this long, the group is free
QUIET_US = 60_000_000

_ACKNOWLEDGE_PGN = 0xE800  #: 59392
_NACK = 1  #: control byte: the group asked for is not supported, or not sent now
_ANSWERS_QUEUED = 8  #: refused requests waiting for their answer; more are dropped and counted
_ANSWER_EVERY_US = 100_000


class NetworkManagement:
    """Decides when and from which address anything may be sent.

    groups: parameter groups that may be asked of us. Times are microseconds of a monotonic clock.
    """

    def __init__(self, broadcast: Broadcast, groups: frozenset[int]) -> None:
        self.claim = AddressClaim(encode_name(broadcast.name), broadcast.preferred_address)
        self._groups = groups
        self._own_pgn = broadcast.pgn
        self.counters: Counter[str] = Counter()
        #: groups of ours that were requested since they were last sent; the broadcaster sends them
        self.requested: set[int] = set()
        self.group_user: int | None = None  #: address that uses our group since before we did
        self._listening_since_us = 0
        self._has_sent = False
        #: requester and group of the directed requests since the last `refusals`, each once
        self._directed: dict[tuple[int, int], None] = {}
        self._answers: deque[tuple[int, int]] = deque()
        self._answer_at_us = 0

    def start(self, now_us: int) -> None:
        """Claim an address and listen before the first broadcast; called whenever the bus was opened."""
        self._listening_since_us = now_us
        self._has_sent = False
        self.claim.start(now_us)

    def observe(self, monitor: BusMonitor, now_us: int) -> None:
        """Handle the claims and requests among the last frames."""
        for source, name in monitor.claims:
            self.claim.on_claim(source, name, now_us)
        for request in monitor.requests:
            if request.destination in (j1939.GLOBAL_ADDRESS, self.claim.address):
                self._handle_request(request, now_us)
        self._update_group_user(monitor, now_us)

    def poll(self, now_us: int, boottime_us: int | None = None) -> list[Frame]:
        """Return the claims to send now (times as in `AddressClaim.poll`)."""
        return self.claim.poll(now_us, boottime_us)

    def refusals(self, now_us: int, available: Set[int]) -> list[Frame]:
        """Return the acknowledgments due: each directed request is owed an answer (SAE J1939-21, PGN 59392).

        available: the groups that are sent now; a directed request for any other one is refused.
        """
        for request in self._directed:
            if request[1] in available or request in self._answers:
                continue
            if len(self._answers) < _ANSWERS_QUEUED:
                self._answers.append(request)
            else:
                self.counters["requests_unanswered"] += 1
        self._directed.clear()
        address = self.claim.address
        if address is None or not self._answers or now_us < self._answer_at_us:
            return []
        requester, pgn = self._answers.popleft()
        self._answer_at_us = now_us + _ANSWER_EVERY_US
        self.counters["requests_refused"] += 1
        payload = bytes([_NACK, 0xFF, 0xFF, 0xFF, requester]) + pgn.to_bytes(3, "little")
        return [(j1939.pack(_ACKNOWLEDGE_PGN, address), payload)]

    def broadcast_address(self, now_us: int) -> int | None:
        """Return the address to broadcast from, None while nothing may be sent."""
        if self.silence_reason(now_us):
            return None
        self._has_sent = True
        return self.claim.address

    def silence_reason(self, now_us: int) -> str:
        """Return one sentence on why nothing is broadcast ('' when something is)."""
        if self.claim.address is None:
            return f"no address ({self.claim.reason or self.claim.state.value})"
        if self.group_user is not None:
            return f"PGN {self._own_pgn:#x} is already used from address {self.group_user:#04x}"
        if now_us - self._listening_since_us < LISTEN_US:
            return "listening before the first broadcast"
        return ""

    def _handle_request(self, request: Request, now_us: int) -> None:
        if request.pgn == CLAIM_PGN:
            self.counters["requests_for_claim"] += 1
            self.claim.on_request(now_us)
            return
        if request.pgn in self._groups:
            self.counters["requests_for_our_groups"] += 1
            self.requested.add(request.pgn)
        if request.destination != j1939.GLOBAL_ADDRESS:
            self._directed[request.source, request.pgn] = None

    def _update_group_user(self, monitor: BusMonitor, now_us: int) -> None:
        for source in [s for s, received in monitor.group_users.items() if now_us - received > QUIET_US]:
            del monitor.group_users[source]
        others = [s for s in monitor.group_users if s != self.claim.address]
        if not others:
            self.group_user = None
        elif not self._has_sent:
            self.group_user = others[0]
        # a later user of our group is reported, but does not stop our broadcast: one forged frame could
