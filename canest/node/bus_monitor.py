"""Frames that concern a node rather than the estimate: claims, requests, commands, masses, the odometer."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from canest.bus.protocols import Filters
from canest.core.frames import ERROR, EXTENDED, REMOTE, FrameBlock
from canest.decode import j1939
from canest.node.address_claim import CLAIM_PGN, REQUEST_PGN
from canest.node.odometer import Odometer

CVW_PGN = 65136  #: Combination Vehicle Weight
CVW_STEP_KG, CVW_LARGEST = 10.0, 0xFAFF  #: SPN 1760, bytes 3-4
OTHER_MASS_TIMEOUT_US = 60_000_000  #: who has sent a mass within this time still does
TSC1_PGN = 0  #: Torque/Speed Control 1: somebody commands the engine or the retarder
_VD_PGN, _VDHR_PGN = 65248, 65217  #: Vehicle Distance, the same in high resolution
#: group -> first bit and km per step of the total distance (SPN 245, SPN 917), both of 32 bits
_ODOMETERS = {_VD_PGN: (32, 0.125), _VDHR_PGN: (0, 0.005)}
_DISTANCE_LARGEST = 0xFAFF_FFFF
_NO_ADDRESS = 0xFE  #: the source of "cannot claim"
_IDS_KEPT = 4096  #: a bus has some hundreds of identifiers, noise has millions


@dataclass(slots=True)
class ReceivedMass:
    """The gross combination mass that another ECU last sent (SPN 1760)."""

    mass_kg: float
    t_us: int
    received_us: int = 0  #: monotonic
    frames: int = 0


@dataclass(frozen=True, slots=True)
class Request:
    """A request of ``source`` to ``destination`` (255: every node) for a parameter group."""

    source: int
    destination: int
    pgn: int


class BusMonitor:
    """Reads the frames that concern a node rather than the estimate.

    own_pgn: the group we broadcast in; its other users are noted. `claims` and `requests` hold what came
    with the last `observe`.
    """

    def __init__(self, own_pgn: int) -> None:
        self._own_pgn = own_pgn
        self._watched = frozenset({CLAIM_PGN, REQUEST_PGN, CVW_PGN, TSC1_PGN, *_ODOMETERS, own_pgn})
        self.ignored_ids: set[int] = set()  #: identifiers that do not concern a node
        self.claims: list[tuple[int, int]] = []
        self.requests: list[Request] = []
        self.other_masses: dict[int, ReceivedMass] = {}
        #: source address -> monotonic time (us) of its last frame in our group
        self.group_users: dict[int, int] = {}
        #: source address -> claims of it, and engine or retarder commands from it
        self.claimed: Counter[int] = Counter()
        self.torque_commands: Counter[int] = Counter()
        self.odometer = Odometer()
        self.counters: Counter[str] = Counter()

    @property
    def distance_km(self) -> float | None:
        """Return the total distance of the vehicle, as reported; None where nobody sends one."""
        return self.odometer.reported_km

    def filters(self) -> Filters:
        """Return the kernel filters for what is watched."""
        return [j1939.kernel_filter(p) for p in sorted(self._watched)]

    def mass_is_sent_by_others(self, now_us: int) -> bool:
        """Return whether another ECU sends its gross mass (SPN 1760)."""
        return any(now_us - m.received_us < OTHER_MASS_TIMEOUT_US for m in self.other_masses.values())

    def observe(self, frames: FrameBlock, now_us: int) -> None:
        """Take the next frames; ``now_us`` is the time of a monotonic clock."""
        self.claims, self.requests = [], []
        ids = frames.can_id.tolist()
        if self.ignored_ids.issuperset(ids):
            return
        for row, can_id in enumerate(ids):
            if can_id not in self.ignored_ids and (pgn := self._watched_pgn(can_id)) is not None:
                length, word = int(frames.length[row]), int(frames.data[row])
                self._dispatch(pgn, can_id, length, word, int(frames.t_us[row]), now_us)

    def _watched_pgn(self, can_id: int) -> int | None:
        """Return the group of an identifier, None (and kept) when it does not concern a node."""
        pgn = j1939.pgn_of(can_id)
        if can_id & EXTENDED and not can_id & (REMOTE | ERROR) and pgn in self._watched:
            return pgn
        if len(self.ignored_ids) >= _IDS_KEPT:
            self.ignored_ids.clear()
        self.ignored_ids.add(can_id)
        return None

    def _dispatch(self, pgn: int, can_id: int, length: int, word: int, t_us: int, now_us: int) -> None:
        source = j1939.source_of(can_id)
        if pgn == self._own_pgn:
            self.group_users[source] = now_us
        elif pgn == REQUEST_PGN:
            if length >= 3:
                self.requests.append(Request(source, j1939.destination_of(can_id), word & j1939.PGN_MASK))
        elif length != 8:
            self.counters["wrong_length"] += 1
        elif pgn == CLAIM_PGN:
            self._count_claim(source, word)
        elif pgn == TSC1_PGN:
            self.torque_commands[source] += 1
        elif pgn in _ODOMETERS:
            self._update_distance(pgn, source, word)
        else:
            self._update_mass(source, word >> 16 & 0xFFFF, t_us, now_us)

    def _count_claim(self, source: int, name: int) -> None:
        self.claims.append((source, name))
        if source == _NO_ADDRESS:
            self.counters["cannot_claim_received"] += 1
        else:
            self.counters["claims_received"] += 1
            self.claimed[source] += 1

    def _update_distance(self, pgn: int, source: int, word: int) -> None:
        first_bit, km = _ODOMETERS[pgn]
        raw = word >> first_bit & 0xFFFF_FFFF
        if raw <= _DISTANCE_LARGEST:
            self.odometer.update((pgn, source), raw * km)

    def _update_mass(self, source: int, raw: int, t_us: int, now_us: int) -> None:
        # some senders send 0 kg while they stand: no estimate, not a weight
        if not 0 < raw <= CVW_LARGEST:
            return
        known = self.other_masses.setdefault(source, ReceivedMass(0.0, 0))
        known.mass_kg, known.t_us, known.received_us = raw * CVW_STEP_KG, t_us, now_us
        known.frames += 1
