"""From frames to samples of roles: matches parameter groups and addresses, decodes what the config wants.

Two paths give the same bits. A long block is grouped by (group, source address) and decoded in columns; a
short one, as it arrives live every 20 ms, goes frame by frame, where numpy's cost per call would rule.
Multi-packet groups always go frame by frame: they are rare, and their packets depend on each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import (
    ERROR,
    EXTENDED,
    ID_MASK,
    REMOTE,
    FloatColumn,
    FrameBlock,
    IntColumn,
    RoleSamples,
)
from canest.decode import j1939
from canest.decode.counters import Counters
from canest.decode.groups import Group, Want, build_groups
from canest.decode.senders import Found, RoleColumns, Sender
from canest.decode.transport_protocol import Transport

if TYPE_CHECKING:
    from cantools.database.can import Database

SHORT_BLOCK = 200  #: frames up to which the path frame by frame is faster (measured: benchmarks/decode.py)
IDS_KEPT = 4096  #: identifiers resolved and kept; a bus has some hundreds, noise has millions

_UNWANTED, _FRAME_BY_FRAME, _FIRST_COLUMNAR = range(3)  #: slots of the table over parameter groups


class _Route(NamedTuple):
    """Who takes the data frames of one identifier: a sender, or else the transport protocol."""

    sender: Sender | None
    source: int = 0
    destination: int = 0
    manages: bool = False  #: TP.CM, else TP.DT


class Decoder:
    """Decodes the roles of a signal map out of a stream of frames.

    A frame belongs to a role by parameter group and, where the want names one, source address (the
    identifier in the DBC may carry any address and priority). Messages that are not J1939 are matched by
    their exact identifier. Without a source, `canest.decode.ownership` decides between several senders.

    A frame counts only with the length its message has in the DBC; groups longer than eight bytes come
    in editions of several lengths, and the signals inside the received bytes are used.

    wants: role -> Want. databases: cantools databases in order of precedence.
    Errors: ConfigError for a message, signal or validity rule that does not exist.
    """

    def __init__(self, wants: Mapping[str, Want], databases: Sequence[Database]) -> None:
        self.counters = Counters()
        self.databases = list(databases)
        self._groups = build_groups(wants, databases)
        self._by_pgn = {g.pgn: g for g in self._groups if g.pgn is not None}
        self._by_exact = {g.exact_id: g for g in self._groups if g.exact_id is not None}
        self._transport = Transport(self._is_wanted, self._transport_error)
        self.counters.transport = self._transport.counts
        self._senders: dict[tuple[int, int | None], Sender] = {}
        self._routes: dict[int, _Route] = {}
        self._is_wanted_id: dict[int, bool] = {}  #: identifiers of data frames in short blocks
        self._transport_pgns = (
            {j1939.TP_CM_PGN, j1939.TP_DT_PGN} if any(g.multi_packet for g in self._groups) else set()
        )
        self._columnar = [g for g in self._groups if not g.multi_packet]
        self._table = np.zeros(1 << j1939.PGN_BITS, np.uint8)
        self._fill_table()

    @property
    def pgns(self) -> list[int]:
        """Parameter groups that must be received, transport protocol included."""
        return sorted([*self._by_pgn, *self._transport_pgns])

    @property
    def open_sessions(self) -> int:
        """Multi-packet messages that are waiting for packets."""
        return self._transport.open_sessions

    def can_filters(self) -> list[tuple[int, int]]:
        """Return (id, mask) pairs for the kernel, flags as in Linux' struct can_filter."""
        exact = [(i, EXTENDED | REMOTE | ID_MASK) for i in sorted(self._by_exact)]
        return [j1939.kernel_filter(pgn) for pgn in self.pgns] + exact

    def push(self, block: FrameBlock) -> RoleSamples:
        """Decode the next frames of a bus or log: `select`, then `decode`."""
        return self.decode(self.select(block))

    def select(self, block: FrameBlock) -> FrameBlock:
        """Return the data frames that the signal map wants, from any address; count the others.

        These are the frames that the kernel lets through with `can_filters`.
        """
        ids = block.can_id
        self.counters.frames += len(block)
        known = self._known_rows(ids.tolist()) if len(block) <= SHORT_BLOCK else None
        rows: list[int] | IntColumn = self._find_rows(ids) if known is None else known
        self.counters.wanted += len(rows)
        return block if len(rows) == len(block) else block[np.asarray(rows, np.int64)]

    def _known_rows(self, ids: list[int]) -> list[int] | None:
        """Return the rows of the wanted frames, None when an identifier has not been seen before."""
        wanted = self._is_wanted_id
        try:
            return [row for row, can_id in enumerate(ids) if wanted[can_id]]
        except KeyError:
            return None

    def _find_rows(self, ids: NDArray[np.uint32]) -> IntColumn:
        """Return the rows of the wanted frames (k,), and keep the identifiers of a short block."""
        odd = (ids >> np.uint32(29)) != np.uint32(EXTENDED >> 29)
        wanted = self._table[(ids >> np.uint32(8)) & np.uint32(j1939.PGN_MASK)] != _UNWANTED
        if odd.any():
            wanted &= ~odd
            self._count_odd(ids[odd])
        for exact_id in self._by_exact:
            wanted |= ids == np.uint32(exact_id)
            if np.any(ids == np.uint32(exact_id ^ EXTENDED)):
                self.counters.other_format.add(exact_id)
        if len(ids) <= SHORT_BLOCK:
            if len(self._is_wanted_id) >= IDS_KEPT:
                self._is_wanted_id.clear()
            data = (ids & np.uint32(ERROR | REMOTE)) == 0  # the others are counted each time
            self._is_wanted_id.update(zip(ids[data].tolist(), wanted[data].tolist(), strict=True))
        return np.flatnonzero(wanted)

    def decode(self, block: FrameBlock) -> RoleSamples:
        """Decode frames that `select` has let through.

        Roles without a sample in this block are absent from the result. Columns may be shared between
        roles: read them, do not write into them.
        """
        if not len(block):
            return RoleSamples({}, None)
        samples = self._one_by_one(block) if len(block) <= SHORT_BLOCK else self._in_columns(block)
        return RoleSamples(samples, int(block.t_us[-1]))

    def _count_odd(self, ids: NDArray[np.uint32]) -> None:
        """Count error frames, and remote frames of wanted messages."""
        self.counters.error_frames += int(np.count_nonzero(ids & np.uint32(ERROR)))
        for can_id in ids[(ids & np.uint32(ERROR | REMOTE)) == np.uint32(REMOTE)].tolist():
            route = self._route(can_id & ~REMOTE)
            if route is not None and route.sender is not None:
                route.sender.counters.remote_frames += 1

    def _fill_table(self) -> None:
        for pgn in self.pgns:
            carried = self._by_pgn.get(pgn)
            slot = _FRAME_BY_FRAME
            if carried is not None and not carried.multi_packet:
                slot = _FIRST_COLUMNAR + self._columnar.index(carried)
            self._table[pgn : pgn + (256 if j1939.is_destination_specific(pgn) else 1)] = slot

    # -- frame by frame ------------------------------------------------------------------------------

    def _one_by_one(self, block: FrameBlock) -> dict[str, tuple[IntColumn, FloatColumn]]:
        found: Found = {}
        routes = self._routes
        for t_us, can_id, length, word in zip(
            block.t_us.tolist(),
            block.can_id.tolist(),
            block.length.tolist(),
            block.data.tolist(),
            strict=True,
        ):
            route = routes.get(can_id) or self._resolved(can_id)
            if route.sender is not None:
                route.sender.push(t_us, length, word, found)
            elif route.manages:
                self._transport.manage(t_us, route.source, route.destination, length, word)
            else:
                message = self._transport.packet(t_us, route.source, route.destination, length, word)
                if message is not None:
                    pgn, payload = message
                    self._sender(self._by_pgn[pgn], route.source).push_payload(t_us, payload, found)
        return _columns(found)

    def _resolved(self, can_id: int) -> _Route:
        route = self._route(can_id)
        assert route is not None  # `select` has let it through
        if len(self._routes) >= IDS_KEPT:
            self._routes.clear()
        self._routes[can_id] = route
        return route

    def _route(self, can_id: int) -> _Route | None:
        """Return who takes the data frames of an identifier, None when nobody wants them."""
        exact = self._by_exact.get(can_id)
        if exact is not None:
            return _Route(self._sender(exact, None))
        if not can_id & EXTENDED:
            return None
        pgn, source = j1939.pgn_of(can_id), j1939.source_of(can_id)
        group = self._by_pgn.get(pgn)
        if group is not None:
            return _Route(self._sender(group, source))
        if pgn in self._transport_pgns:
            return _Route(None, source, j1939.destination_of(can_id), manages=pgn == j1939.TP_CM_PGN)
        return None

    def _sender(self, group: Group, source: int | None) -> Sender:
        key = group.number, source  # an exact identifier has no source, so none is a group's number too
        sender = self._senders.get(key)
        if sender is None:
            sender = self._senders[key] = Sender(group, source)
            self.counters.senders[key] = sender.counters
        return sender

    def _is_wanted(self, pgn: int, source: int) -> bool:
        group = self._by_pgn.get(pgn)
        return group is not None and group.multi_packet and bool(self._sender(group, source).signals)

    def _transport_error(self, pgn: int, source: int) -> None:
        self._sender(self._by_pgn[pgn], source).counters.transport_errors += 1

    # -- in columns ----------------------------------------------------------------------------------

    def _in_columns(self, block: FrameBlock) -> dict[str, tuple[IntColumn, FloatColumn]]:
        """Group by (slot, source address) in one stable sort, then decode each group's rows at once."""
        ids = block.can_id
        slots = self._table[(ids >> np.uint32(8)) & np.uint32(j1939.PGN_MASK)]
        for slot, group in enumerate(self._columnar, start=_FIRST_COLUMNAR):
            if group.exact_id is not None:
                slots[ids == np.uint32(group.exact_id)] = slot
        key = slots.astype(np.uint16) << np.uint16(8) | (ids & np.uint32(0xFF)).astype(np.uint16)
        rows = np.argsort(key, kind="stable")
        key = key[rows]
        edges = (np.flatnonzero(key[1:] != key[:-1]) + 1).tolist()
        sequential = int(np.searchsorted(key, _FIRST_COLUMNAR << 8))
        samples = self._one_by_one(block[np.sort(rows[:sequential])]) if sequential else {}
        columns = RoleColumns(block)
        for start, end in zip([0, *edges], [*edges, len(key)], strict=True):
            slot, low = divmod(int(key[start]), 256)
            if slot >= _FIRST_COLUMNAR:
                group = self._columnar[slot - _FIRST_COLUMNAR]
                sender = self._sender(group, None if group.exact_id is not None else low)
                sender.push_columns(columns, rows[start:end])
        return samples | columns.samples()


def _columns(
    found: Found,
) -> dict[str, tuple[IntColumn, FloatColumn]]:
    """Turn lists per role into columns: two conversions in all, then views."""
    all_times: list[int] = []
    all_values: list[float] = []
    for times, values in found.values():
        all_times += times
        all_values += values
    time_column, value_column = np.array(all_times, np.int64), np.array(all_values, np.float64)
    samples, start = {}, 0
    for role, (times, _) in found.items():
        end = start + len(times)
        samples[role] = time_column[start:end], value_column[start:end]
        start = end
    return samples
