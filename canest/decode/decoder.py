"""From frames to samples of roles: matches parameter groups and addresses, decodes what the config wants.

Two paths give the same bits. A long block is grouped by (group, source address) and decoded in columns; a
short one, as it arrives live every 20 ms, goes frame by frame, where numpy's cost per call would rule.
Multi-packet groups always go frame by frame: they are rare, and their packets depend on each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from canest.decode import j1939
from canest.decode.counters import Counters
from canest.decode.groups import Group, Want, build_groups
from canest.decode.senders import Columns, Found, Sender
from canest.decode.transport import Transport
from canest.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FloatColumn, FrameBlock, IntColumn, RoleSamples

if TYPE_CHECKING:
    from cantools.database.can import Database

SHORT_BLOCK = 200  #: frames up to which the path frame by frame is faster (measured: benchmarks/decode.py)
_IDS_REMEMBERED = 4096  #: identifiers resolved and kept; a bus has some hundreds, noise has millions

_UNWANTED, _FRAME_BY_FRAME, _FIRST_COLUMNAR = range(3)  #: slots of the table over parameter groups
_DATA, _MANAGE, _PACKET, _REMOTE, _ERROR, _NOTHING = range(6)


@dataclass(frozen=True, slots=True)
class _Route:
    """What becomes of the frames of one identifier (with flags)."""

    kind: int
    source: int = 0
    destination: int = 0
    sender: Sender | None = None


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
        self._groups = build_groups(wants, databases)
        self._by_pgn = {g.pgn: g for g in self._groups if g.pgn is not None}
        self._by_exact = {g.exact_id: g for g in self._groups if g.exact_id is not None}
        self._transport = Transport(self._is_wanted, self._transport_error)
        self.counters.transport = self._transport.counts
        self._routes: dict[int, _Route] = {}
        self._columnar = [g for g in self._groups if not g.multi_packet]
        self._table = np.zeros(1 << j1939.PGN_BITS, np.uint8)
        self._exact_slots: list[tuple[np.uint32, int]] = []
        self._fill_table()

    @property
    def pgns(self) -> list[int]:
        """Parameter groups that must be received, transport protocol included."""
        extra = [j1939.TP_CM_PGN, j1939.TP_DT_PGN] if any(g.multi_packet for g in self._groups) else []
        return sorted([*self._by_pgn, *extra])

    def can_filters(self) -> list[tuple[int, int]]:
        """Return (id, mask) pairs for the kernel, flags as in Linux' struct can_filter."""
        exact = [(i, EXTENDED | REMOTE | ID_MASK) for i in sorted(self._by_exact)]
        return [j1939.kernel_filter(pgn) for pgn in self.pgns] + exact

    def wanted(self, can_id: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Return which identifiers (with flags) this decoder listens to, from any source address."""
        mask = self._table[(can_id >> np.uint32(8)) & np.uint32(j1939.PGN_MASK)] != _UNWANTED
        for exact_id, _ in self._exact_slots:
            mask |= (can_id & ~np.uint32(REMOTE)) == exact_id
        return mask

    def push(self, block: FrameBlock) -> RoleSamples:
        """Decode the next frames.

        Roles without a sample in this block are absent from the result. Columns may be shared between
        roles: read them, do not write into them.
        """
        self.counters.frames += len(block)
        return self._push_frames(block) if len(block) <= SHORT_BLOCK else self._push_columns(block)

    def _fill_table(self) -> None:
        for slot, group in enumerate(self._columnar, start=_FIRST_COLUMNAR):
            if group.exact_id is not None:
                self._exact_slots.append((np.uint32(group.exact_id), slot))
        for pgn in self.pgns:
            carried = self._by_pgn.get(pgn)
            slot = _FRAME_BY_FRAME
            if carried is not None and not carried.multi_packet:
                slot = _FIRST_COLUMNAR + self._columnar.index(carried)
            self._table[pgn : pgn + (256 if j1939.is_destination_specific(pgn) else 1)] = slot

    # -- frame by frame ------------------------------------------------------------------------------

    def _push_frames(self, block: FrameBlock) -> RoleSamples:
        found: Found = {}
        end_us: int | None = None
        routes = self._routes
        for t_us, can_id, length, word in zip(
            block.t_us.tolist(),
            block.can_id.tolist(),
            block.length.tolist(),
            block.data.tolist(),
            strict=True,
        ):
            route = routes.get(can_id)
            if route is None:
                route = self._resolve(can_id)
            if route.kind <= _PACKET:
                end_us = t_us
                self._take(route, t_us, length, word, found)
            elif route.kind != _NOTHING:
                self._note(route)
        return RoleSamples(_columns(found), end_us)

    def _take(
        self,
        route: _Route,
        t_us: int,
        length: int,
        word: int,
        found: Found,
    ) -> None:
        self.counters.wanted += 1
        if route.kind == _DATA:
            assert route.sender is not None
            route.sender.push(t_us, length, word, found)
        elif route.kind == _MANAGE:
            self._transport.manage(t_us, route.source, route.destination, length, word)
        else:
            message = self._transport.packet(t_us, route.source, route.destination, length, word)
            if message is not None:
                pgn, payload = message
                self._sender(self._by_pgn[pgn], route.source).push_payload(t_us, payload, found)

    def _note(self, route: _Route) -> None:
        if route.kind == _ERROR:
            self.counters.error_frames += 1
        elif route.sender is not None:
            route.sender.counters.remote_frames += 1

    def _resolve(self, can_id: int) -> _Route:
        route = self._route(can_id)
        if len(self._routes) >= _IDS_REMEMBERED:
            self._routes.clear()
        self._routes[can_id] = route
        return route

    def _route(self, can_id: int) -> _Route:
        if can_id & ERROR:
            return _Route(_ERROR)
        kind = _REMOTE if can_id & REMOTE else _DATA
        plain = can_id & ~REMOTE
        exact = self._by_exact.get(plain)
        if exact is not None:
            return _Route(kind, sender=self._sender(exact, None))
        if not can_id & EXTENDED:
            return _Route(_NOTHING)
        pgn, source = j1939.pgn_of(plain), j1939.source_of(plain)
        group = self._by_pgn.get(pgn)
        if group is not None:
            return _Route(kind, sender=self._sender(group, source))
        if kind == _DATA and pgn in (j1939.TP_CM_PGN, j1939.TP_DT_PGN) and pgn in self.pgns:
            manage_or_packet = _MANAGE if pgn == j1939.TP_CM_PGN else _PACKET
            return _Route(manage_or_packet, source, j1939.destination_of(plain))
        return _Route(_NOTHING)

    def _sender(self, group: Group, source: int | None) -> Sender:
        sender = group.senders.get(source)
        if sender is None:
            sender = group.senders[source] = Sender(group, source)
            key = group.pgn if group.pgn is not None else group.exact_id
            assert key is not None
            self.counters.senders[key, source] = sender.counters
        return sender

    def _is_wanted(self, pgn: int, source: int) -> bool:
        group = self._by_pgn.get(pgn)
        return group is not None and group.multi_packet and bool(self._sender(group, source).signals)

    def _transport_error(self, pgn: int, source: int) -> None:
        self._sender(self._by_pgn[pgn], source).counters.transport_errors += 1

    # -- in columns ----------------------------------------------------------------------------------

    def _push_columns(self, block: FrameBlock) -> RoleSamples:
        ids = block.can_id
        slots = self._table[(ids >> np.uint32(8)) & np.uint32(j1939.PGN_MASK)]
        for exact_id, slot in self._exact_slots:
            slots[(ids & ~np.uint32(REMOTE)) == exact_id] = slot
        if (ids & np.uint32(ERROR)).any():
            self.counters.error_frames += int(np.count_nonzero(ids & np.uint32(ERROR)))
        picked = np.flatnonzero(slots)
        picked = self._refuse_odd(ids, slots, picked)
        if not len(picked):
            return RoleSamples({}, None)
        self.counters.wanted += len(picked)
        end_us = int(block.t_us[picked[-1]])

        key = slots[picked].astype(np.uint16) << np.uint16(8) | (ids[picked] & np.uint32(0xFF)).astype(
            np.uint16
        )
        order = np.argsort(key, kind="stable")
        key, picked = key[order], picked[order]
        edges = np.flatnonzero(key[1:] != key[:-1]) + 1
        starts = [0, *edges.tolist()]
        ends = [*edges.tolist(), len(key)]
        single = int(np.searchsorted(key, _FIRST_COLUMNAR << 8))
        samples = self._in_order(block, np.sort(picked[:single])) if single else {}
        columns = Columns(block)
        for start, end in zip(starts, ends, strict=True):
            slot, low = divmod(int(key[start]), 256)
            if slot >= _FIRST_COLUMNAR:
                group = self._columnar[slot - _FIRST_COLUMNAR]
                source = None if group.exact_id is not None else low
                self._sender(group, source).push_columns(columns, picked[start:end])
        samples.update(columns.samples())
        return RoleSamples(samples, end_us)

    def _refuse_odd(self, ids: NDArray[np.uint32], slots: NDArray[np.uint8], picked: IntColumn) -> IntColumn:
        """Count and drop what looks like a wanted identifier and is no data frame of it."""
        flags = ids[picked] & np.uint32(EXTENDED | REMOTE | ERROR)
        odd = flags != np.uint32(EXTENDED)
        if not odd.any():
            return picked
        keep = np.ones(len(picked), np.bool_)
        for at in np.flatnonzero(odd).tolist():
            route = self._route(int(ids[picked[at]]))
            keep[at] = route.kind <= _PACKET
            if route.kind == _REMOTE:
                self._note(route)
        return picked[keep]

    def _in_order(self, block: FrameBlock, rows: IntColumn) -> dict[str, tuple[IntColumn, FloatColumn]]:
        found: Found = {}
        part = block[rows]
        for t_us, can_id, length, word in zip(
            part.t_us.tolist(), part.can_id.tolist(), part.length.tolist(), part.data.tolist(), strict=True
        ):
            self._take(self._routes.get(can_id) or self._resolve(can_id), t_us, length, word, found)
        self.counters.wanted -= len(rows)  # counted by the caller
        return _columns(found)


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
