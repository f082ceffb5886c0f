"""MF4 logs of a CAN bus, their channel groups read as columns; python-can and asammdf read what is odd."""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FrameBlock
from canest.logs.frame_columns import FrameColumns, HeldFrames, merged, take_merged
from canest.logs.mf4_blocks import DataStream, Mf4File, UnsupportedMf4Error
from canest.logs.mf4_frames import RecordReader, mixed_records, sorted_records
from canest.logs.mf4_groups import (
    COUNTS_MISSING,
    LENGTH_MISSING,
    VARIABLE_BYTES_MISSING,
    DataGroup,
    Field,
    Group,
    data_groups,
    start_s,
)
from canest.logs.python_can import PythonCanReader

_IDENTIFICATION_BYTES = 64
_FINISHED, _UNFINISHED = b"MDF     ", b"UnFinMF "
#: how far mixed records may be from the order of their stamps
_DISORDER_S = 60.0
#: of one block of records
_BLOCK_BYTES = 1 << 22


class Mf4Reader(PythonCanReader):
    """An MF4 log: plain or packed records, sorted or mixed, also of unfinished recordings."""

    def _blocks(self) -> Generator[FrameBlock]:
        with self.stored() as file:
            try:
                mf4 = _Mf4(Mf4File(file, self.meter), self._block_frames)
                for columns in mf4.columns():
                    self._show_progress(file)
                    yield self._select_columns(columns)
            except (UnsupportedMf4Error, struct.error, IndexError, ValueError, OverflowError) as error:
                if self._frames:
                    self.truncated_reason = f"damaged after {self._frames:,} frames: {error}"
                else:
                    yield from super()._blocks()
                return
            if mf4.signal_groups and not self._frames:
                raise LogError(
                    "holds decoded signals and no CAN frames", where=str(self.path),
                    expected="a recording of the bus, or the signals as a table (.csv or .parquet)",
                )  # fmt: skip
            if mf4.cut_short:
                self.truncated_reason = f"ends early, after {self._frames:,} frames"
                if not self._frames:
                    yield from super()._blocks()


class _Mf4:
    """One file. cut_short: the file ends before the last of its records. signal_groups: of no CAN frames."""

    def __init__(self, file: Mf4File, at_once: int) -> None:
        self._file, self._at_once = file, at_once
        self.cut_short = False
        self.signal_groups = 0
        identification = file.read(0, _IDENTIFICATION_BYTES)
        (self._missing, custom) = struct.unpack_from("<HH", identification, _IDENTIFICATION_BYTES - 4)
        if identification.startswith(_FINISHED):
            self._missing = custom = 0
        if not identification.startswith((_FINISHED, _UNFINISHED)) or custom:
            raise UnsupportedMf4Error("an unfinished recording of a special kind")
        if self._missing & ~(COUNTS_MISSING | LENGTH_MISSING | VARIABLE_BYTES_MISSING):
            raise UnsupportedMf4Error(f"an unfinished recording ({self._missing:#x})")
        self._start_s = start_s(file)

    def columns(self) -> Iterator[FrameColumns]:
        """Yield the frames of all groups, merged by time. Errors: UnsupportedMf4Error."""
        streams: list[Iterator[FrameColumns]] = []
        for group in data_groups(self._file):
            self.signal_groups += sum(bool(part.cycles) and not part.kind for part in group.groups)
            if group.record_id_bytes:
                streams.append(self._mixed(group))
            elif group.groups and group.groups[0].kind:
                streams.append(self._sorted(group))
        return merged(streams) if streams else iter(())

    def _sorted(self, shared: DataGroup) -> Iterator[FrameColumns]:
        stream, group = self._stream(shared), shared.groups[0]
        there = stream.size // group.record_bytes if group.record_bytes else 0
        count = there if self._missing & COUNTS_MISSING else min(there, group.cycles)
        self._mark(stream.cut_short and (there < group.cycles or bool(self._missing)))
        reader = self._reader(group)
        at_once = max(min(self._at_once, _BLOCK_BYTES // max(group.record_bytes, 1)), 1)
        for records in sorted_records(stream, group, count, at_once):
            yield reader.frames(records)
            if reader.cut_short:
                self._mark(True)
                return

    def _mixed(self, shared: DataGroup) -> Iterator[FrameColumns]:
        stream = self._stream(shared)
        self._mark(stream.cut_short)
        held = {group.record_id: HeldFrames() for group in shared.groups if group.kind}
        readers = {group.record_id: self._reader(group) for group in shared.groups if group.kind}
        left = {group.record_id: group.cycles for group in shared.groups}
        for block in mixed_records(stream, shared.record_id_bytes, shared.groups, self._at_once):
            for group, records in block:
                if not self._missing & COUNTS_MISSING:
                    records = records[: left[group.record_id]]
                    left[group.record_id] -= len(records)
                if len(records):
                    held[group.record_id].add(readers[group.record_id].frames(records))
            latest_s = max((frames.latest_s for frames in held.values()), default=-np.inf)
            ready = take_merged(held.values(), latest_s - _DISORDER_S)
            if ready is not None:
                yield ready
        ready = take_merged(held.values(), np.inf)
        if ready is not None:
            yield ready

    def _stream(self, shared: DataGroup) -> DataStream:
        return DataStream(self._file, shared.data_address, bool(self._missing & LENGTH_MISSING))

    def _reader(self, group: Group) -> RecordReader:
        return RecordReader(group, self._start_s, self._elsewhere)

    def _elsewhere(self, field: Field) -> DataStream:
        return DataStream(self._file, field.data_address)

    def _mark(self, cut_short: bool) -> None:
        self.cut_short |= cut_short
