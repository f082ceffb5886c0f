"""Records of an MF4 file to frames, a block of records at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, IntColumn
from canest.logs.frame_columns import FrameColumns, payload_words
from canest.logs.mf4_blocks import DataStream, UnsupportedMf4Error
from canest.logs.mf4_groups import KINDS, Field, Group

_DATA, _ERROR, _REMOTE = KINDS
_CHUNK_BYTES = 1 << 22  #: that are walked together
_LENGTH_BYTES = 4  #: in front of bytes that stand elsewhere
_PAYLOAD_MAX = 64
_INTEGER_MAX = 2.0**53

Elsewhere = Callable[[Field], DataStream]


class RecordReader:
    """Turns records of one group into frames.

    start_s: added to the stamps. streams: gives the bytes that stand elsewhere than in the records.
    cut_short: bytes of some records are missing at the end of the file.
    """

    def __init__(self, group: Group, start: float, streams: Elsewhere) -> None:
        self._group, self._start, self._streams = group, start, streams
        self._elsewhere: DataStream | None = None
        self.cut_short = False

    def frames(self, records: NDArray[np.uint8]) -> FrameColumns:
        """Return the frames of records uint8 (n, size). Errors: UnsupportedMf4Error."""
        fields, kind = self._group.fields, self._group.kind
        t_s = fields["Time"].values(records).astype(np.float64) + self._start
        can_id = self._integers("ID", records, 0).astype(np.uint32) & np.uint32(ID_MASK)
        if kind == _ERROR:
            can_id |= np.uint32(ERROR)
            can_id |= (self._integers("RTR", records, 0) != 0) * np.uint32(REMOTE)
        else:
            can_id |= (self._integers("IDE", records, 1) != 0) * np.uint32(EXTENDED)
        if kind == _REMOTE:
            can_id |= np.uint32(REMOTE)
            length, data = self._integers("DLC", records, 0), np.zeros(len(records), np.uint64)
        else:
            length, data = self._payload(records)
            if kind == _ERROR:
                remote = (can_id[: len(length)] & np.uint32(REMOTE)) != 0
                length, data = np.where(remote, 0, length), np.where(remote, np.uint64(0), data)
        channel = self._integers("BusChannel", records, 0) if "BusChannel" in fields else None
        return FrameColumns(t_s, can_id, length, data, channel)[: len(length)]

    def _integers(self, name: str, records: NDArray[np.uint8], otherwise: int) -> IntColumn:
        field = self._group.fields.get(name)
        if field is None:
            return np.full(len(records), otherwise, np.int64)
        values = field.values(records)
        if values.dtype == np.float64 and not (np.abs(values) < _INTEGER_MAX).all():
            raise UnsupportedMf4Error(f"{name} is no integer")
        return values.astype(np.int64)

    def _payload(self, records: NDArray[np.uint8]) -> tuple[IntColumn, NDArray[np.uint64]]:
        field = self._group.fields.get("DataBytes")
        if field is None or "DataLength" not in self._group.fields:
            return np.zeros(len(records), np.int64), np.zeros(len(records), np.uint64)
        announced = self._integers("DataLength", records, 0)
        if field.data_address:
            return self._payload_elsewhere(field, records, announced)
        count = min(field.bits // 8, 8)
        words = np.zeros((len(records), 8), np.uint8)
        words[:, :count] = records[:, field.byte : field.byte + count]
        length = np.minimum(announced, field.bits // 8)
        return length, payload_words(words.view("<u8")[:, 0], length)

    def _payload_elsewhere(
        self, field: Field, records: NDArray[np.uint8], announced: IntColumn
    ) -> tuple[IntColumn, NDArray[np.uint64]]:
        """Return length and bytes that stand in a stream of their own, fewer rows where it is cut short."""
        if self._elsewhere is None:
            self._elsewhere = self._streams(field)
        at = field.values(records).astype(np.int64)
        begin = int(at[0])
        if (at[1:] <= at[:-1]).any() or at[-1] - begin > len(at) * 2 * (_LENGTH_BYTES + _PAYLOAD_MAX):
            raise UnsupportedMf4Error("data bytes out of order")
        there = self._elsewhere.read(begin, int(at[-1]) - begin + _LENGTH_BYTES + _PAYLOAD_MAX)
        at -= begin
        chars = np.frombuffer(there + bytes(8), np.uint8)
        known = int(np.searchsorted(at, len(there) - _LENGTH_BYTES, side="right"))
        at, announced = at[:known], announced[:known]
        sizes = np.ndarray(len(chars) - 3, "<u4", chars, strides=(1,))[at].astype(np.int64)
        whole = at + _LENGTH_BYTES + sizes <= len(there)
        known = len(at) if whole.all() else int(whole.argmin())
        if known < len(records):
            if not self._elsewhere.cut_short:
                raise UnsupportedMf4Error("data bytes that are not there")
            self.cut_short = True
            at, announced, sizes = at[:known], announced[:known], sizes[:known]
        length = np.minimum(announced, sizes)
        words = np.ndarray(len(chars) - 7, "<u8", chars, strides=(1,))[at + _LENGTH_BYTES]
        return length, payload_words(words, length)


def sorted_records(stream: DataStream, group: Group, count: int, at_once: int) -> Iterator[NDArray[np.uint8]]:
    """Yield the records of a stream that has those of one group only, ``at_once`` at a time."""
    for first in range(0, count, at_once):
        rows = min(at_once, count - first)
        text = stream.read(first * group.record_bytes, rows * group.record_bytes)
        yield np.frombuffer(text, np.uint8).reshape(rows, group.record_bytes)


def mixed_records(
    stream: DataStream, id_bytes: int, groups: tuple[Group, ...], at_once: int
) -> Iterator[list[tuple[Group, NDArray[np.uint8]]]]:
    """Yield blocks of a stream in which records of several groups stand one behind the other.

    Each block: for every group with frames, the group and its records.
    A record that is cut off at the end of the file is left out.
    Errors: UnsupportedMf4Error for what belongs to no group.
    """
    sizes = {
        group.record_id: _LENGTH_BYTES if group.variable_length else group.record_bytes for group in groups
    }
    variable = {group.record_id for group in groups if group.variable_length}
    wanted = {group.record_id: group for group in groups if group.kind}
    longest = id_bytes + max(sizes.values(), default=0)
    begin, chunk_bytes = 0, min(at_once * longest, max(_CHUNK_BYTES, longest))
    while begin < stream.size:
        text = stream.read(begin, chunk_bytes)
        places, at = _walk(text, id_bytes, sizes, variable)
        if not at:
            if begin + len(text) >= stream.size:
                return
            chunk_bytes *= 2  # one long record of another group
            continue
        begin += at
        chars = np.frombuffer(text, np.uint8)
        block = []
        for record_id, group in wanted.items():
            if found := places.get(record_id):
                if any(field.data_address for field in group.fields.values()):
                    raise UnsupportedMf4Error("data bytes among mixed records")
                number = np.array(found, np.int64)
                windows = np.ndarray(
                    len(chars) - group.record_bytes + 1, f"V{group.record_bytes}", chars, strides=(1,)
                )
                records = windows[number + id_bytes].view(np.uint8).reshape(len(number), group.record_bytes)
                block.append((group, records))
        yield block


def _walk(
    text: bytes, id_bytes: int, sizes: dict[int, int], variable: set[int]
) -> tuple[dict[int, list[int]], int]:
    """Return where the records of each identifier begin, and where the first one that is not whole does."""
    places: dict[int, list[int]] = {record_id: [] for record_id in sizes}
    at, end = 0, len(text)
    while at + id_bytes <= end:
        record_id = text[at] if id_bytes == 1 else int.from_bytes(text[at : at + id_bytes], "little")
        size = sizes.get(record_id)
        if size is None:
            raise UnsupportedMf4Error(f"a record of no group ({record_id})")
        beyond = at + id_bytes + size
        if record_id in variable and beyond <= end:
            beyond += int.from_bytes(text[beyond - _LENGTH_BYTES : beyond], "little")
        if beyond > end:
            break
        places[record_id].append(at)
        at = beyond
    return places, at
