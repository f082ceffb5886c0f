"""One parameter group from one address: decodes its frames one by one or in columns, and counts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, FrameBlock, IntColumn
from canest.decode.compile import FRAME_BYTES
from canest.decode.counters import SenderCounters, SignalCounters
from canest.decode.groups import Group, WantedSignal
from canest.decode.ownership import Owner

Found = dict[str, tuple[list[int], list[float]]]  #: role -> stamps, values
_Step = tuple[WantedSignal, str, Callable[[int], float | None], SignalCounters, Owner | None]
_PADDING = b"\xff"


class RoleColumns:
    """The columns of a block on their way to roles."""

    def __init__(self, block: FrameBlock) -> None:
        self.block = block
        self._certain: dict[str, tuple[IntColumn, FloatColumn]] = {}
        self._contested: dict[str, list[tuple[Sender, WantedSignal, IntColumn, IntColumn, FloatColumn]]] = {}

    def add(
        self, sender: Sender, wanted: WantedSignal, rows: IntColumn, t_us: IntColumn, values: FloatColumn
    ) -> None:
        """Take the samples of one role from one sender."""
        if wanted.owner is None:
            self._certain[wanted.role] = t_us, values
        else:
            self._contested.setdefault(wanted.role, []).append((sender, wanted, rows, t_us, values))

    def samples(self) -> dict[str, tuple[IntColumn, FloatColumn]]:
        """Return the samples of every role that has some, after deciding who owns the others."""
        for role, offers in self._contested.items():
            sender, wanted, _, t_us, values = offers[0]
            owner = wanted.owner
            assert owner is not None
            if len(offers) == 1 and owner.address in (None, sender.address):
                valid = np.flatnonzero(~np.isnan(values))
                if len(valid):
                    owner.address, owner.last_us = sender.address, int(t_us[valid[-1]])
                self._certain[role] = t_us, values
            else:
                self._decide(role, offers)
        return self._certain

    def _decide(
        self, role: str, offers: list[tuple[Sender, WantedSignal, IntColumn, IntColumn, FloatColumn]]
    ) -> None:
        owner = offers[0][1].owner
        assert owner is not None
        order = np.argsort(np.concatenate([rows for _, _, rows, _, _ in offers]), kind="stable")
        t_us = np.concatenate([t for _, _, _, t, _ in offers])[order]
        values = np.concatenate([v for _, _, _, _, v in offers])[order]
        which = np.repeat(np.arange(len(offers)), [len(rows) for _, _, rows, _, _ in offers])[order]
        senders = [offer[0] for offer in offers]
        keep = np.ones(len(values), np.bool_)
        for at, (t, valid, k) in enumerate(
            zip(t_us.tolist(), (~np.isnan(values)).tolist(), which.tolist(), strict=True)
        ):
            if not owner.accepts(t, senders[k].address, valid):
                keep[at] = False
                senders[k].counters.roles[role].not_owner += 1
        if keep.any():
            self._certain[role] = t_us[keep], values[keep]


class Sender:
    """One group from one source address (None for an exact identifier)."""

    def __init__(self, group: Group, source: int | None) -> None:
        self.address = -1 if source is None else source
        self.signals = [w for w in group.signals if w.source is None or w.source == source]
        self.counters = SenderCounters(used=bool(self.signals))
        self.counters.roles = {w.role: SignalCounters() for w in self.signals}
        self._multi_packet = group.multi_packet
        self._length = group.length
        multiplexed = any(w.signal.multiplexer is not None for w in self.signals)
        self._selector = group.selector if multiplexed else None
        self._plan: list[_Step] = [
            (w, w.role, w.signal.one, self.counters.roles[w.role], w.owner) for w in self.signals
        ]

    def push(self, t_us: int, length: int, word: int, found: Found) -> None:
        """Decode one frame, given its payload as a little-endian integer."""
        if self._multi_packet and length <= FRAME_BYTES:
            self.push_payload(t_us, word.to_bytes(FRAME_BYTES, "little")[:length], found)
        elif self._begin(t_us):
            if self._multi_packet or length != self._length:
                self.counters.wrong_length += 1
            elif self._selector is not None and self._selector[0].one(word) not in self._selector[1]:
                self.counters.unknown_mux += 1
            else:
                self._decode(t_us, word, self._plan, found)

    def push_payload(self, t_us: int, payload: bytes, found: Found) -> None:
        """Decode a multi-packet message; signals beyond the end of a shorter edition are not sampled."""
        if self._begin(t_us):
            word = int.from_bytes(payload[: self._length].ljust(self._length, _PADDING), "little")
            self._decode(t_us, word, [p for p in self._plan if p[0].signal.needs <= len(payload)], found)

    def _decode(self, t_us: int, word: int, plan: list[_Step], found: Found) -> None:
        for wanted, role, one, counts, owner in plan:
            value = one(word)
            if value is None:
                continue
            valid = value == value  # noqa: PLR0124 - NaN alone is not equal to itself
            if valid:
                counts.valid += 1
            elif wanted.signal.raw(word) >= wanted.signal.first_not_available:
                counts.not_available += 1
            else:
                counts.error_value += 1
            if owner is not None and not owner.accepts(t_us, self.address, valid):
                counts.not_owner += 1
                continue
            at = found.get(role)
            if at is None:
                found[role] = [t_us], [value]
            else:
                at[0].append(t_us)
                at[1].append(value)

    def push_columns(self, columns: RoleColumns, rows: IntColumn) -> None:
        """Decode the frames at ``rows`` of a block (ascending)."""
        block = columns.block
        counters = self.counters
        t_us = block.t_us[rows]
        counters.take(t_us)
        if not self.signals:
            return
        fits = block.length[rows] == np.uint8(self._length)
        if not fits.all():
            counters.wrong_length += int(np.count_nonzero(~fits))
            rows, t_us = rows[fits], t_us[fits]
        words = block.data[rows]
        if self._selector is not None:
            field, known = self._selector
            knows: BoolColumn = np.isin(field.column(words), np.array(sorted(known), np.uint64))
            if not knows.all():
                counters.unknown_mux += int(np.count_nonzero(~knows))
                rows, words, t_us = rows[knows], words[knows], t_us[knows]
        if not len(rows):
            return
        for wanted in self.signals:
            at, values, bad, raw = wanted.signal.columns(words)
            if not len(values):
                continue
            counts = counters.roles[wanted.role]
            if bad is None:
                counts.valid += len(values)
            else:
                wrong = int(np.count_nonzero(bad))
                missing = int(np.count_nonzero(bad & (raw >= np.uint64(wanted.signal.first_not_available))))
                counts.valid += len(values) - wrong
                counts.not_available += missing
                counts.error_value += wrong - missing
            columns.add(
                self, wanted, rows if at is None else rows[at], t_us if at is None else t_us[at], values
            )

    def _begin(self, t_us: int) -> bool:
        self.counters.take_one(t_us)
        return bool(self.signals)
