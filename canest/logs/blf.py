"""BLF logs, a stretch of objects at a time; python-can goes on where something in them is odd."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Generator
from datetime import UTC, datetime
from typing import Any, BinaryIO

from canest.core.frames import FrameBlock
from canest.logs.blf_objects import OddBlfError, parse
from canest.logs.frame_columns import FrameColumns, joined
from canest.logs.python_can import PythonCanReader

#: of the file's header: signature, its size, the file's size, when the measurement began
_HEADER = struct.Struct("<4sL8xQ16x8H")
_HEADER_BYTES = 72
_BASE = struct.Struct("<4sHHLL")
_CONTAINER = struct.Struct("<H6xL4x")
_LOG_CONTAINER, _STORED, _DEFLATED = 10, 0, 2
#: unpacked bytes that are parsed at once
_STRETCH_BYTES = 1 << 20
#: of one container; writers use 128 kB
_UNPACKED_MAX = 1 << 26


class BlfReader(PythonCanReader):
    """A BLF log. Where a stretch is odd, python-can goes on from there."""

    _containers: _Containers | None = None

    def _blocks(self) -> Generator[FrameBlock]:
        with self.stored() as file:
            containers = self._containers = _Containers(file, self.meter.unpack)
            held: list[FrameColumns] = []
            odd = False
            while not odd and not containers.ended:
                try:
                    held.append(containers.next_frames())
                except (OddBlfError, zlib.error, struct.error):
                    odd = True
                self._show_progress(file)
                if held and (odd or containers.ended or sum(map(len, held)) >= self._block_frames):
                    yield self._select_columns(joined(held))
                    held = []
            if odd:
                yield from super()._blocks()
            elif containers.size < containers.announced:
                self.truncated_reason = (
                    f"holds {containers.size:,} of the {containers.announced:,} bytes its header announces"
                )

    def _resume(self, reader: Any, file: BinaryIO) -> None:
        if self._containers is not None and self._containers.begin:
            file.seek(self._containers.begin)
            reader._tail = self._containers.tail


class _Containers:
    """The containers of a file, one stretch after the other.

    begin, tail: where the stretch begins that is read next, and what the one before it left.
    announced: size of the file by its header.
    """

    def __init__(self, file: BinaryIO, count_unpacked: Callable[[int], None]) -> None:
        self._file, self._count_unpacked = file, count_unpacked
        self.size = file.seek(0, 2)
        self.begin, self.tail, self.ended = 0, b"", False
        self.announced, self._start_s = 0, 0.0

    def next_frames(self) -> FrameColumns:
        """Return the frames of the next stretch; begin and tail stay where that fails.

        Errors: OddBlfError, zlib.error, struct.error.
        """
        if not self.begin:
            self._read_header()
        self._file.seek(self.begin)
        stretch, size = [self.tail], len(self.tail)
        ended = False
        while size < _STRETCH_BYTES + len(self.tail):
            head = self._file.read(_BASE.size)
            if not head:
                ended = True
                break
            data = self._object(head)
            if data:
                stretch.append(data)
                size += len(data)
        whole = b"".join(stretch)
        frames, consumed = parse(whole if len(stretch) > 1 else b"", self._start_s)
        self.tail, self.begin, self.ended = whole[consumed:], self._file.tell(), ended
        return frames

    def _read_header(self) -> None:
        self._file.seek(0)
        header = self._file.read(_HEADER_BYTES)
        _, header_bytes, self.announced, *begin = _HEADER.unpack_from(header)
        year, month, _, day, hour, minute, second, milli = begin
        if header_bytes < len(header) or len(header) < _HEADER_BYTES:
            raise OddBlfError
        try:
            start = datetime(year, month, day, hour, minute, second, milli * 1000, tzinfo=UTC)
            self._start_s = start.timestamp()
        except ValueError:  # none is given
            self._start_s = 0.0
        self.begin = min(header_bytes, self.size)

    def _object(self, head: bytes) -> bytes:
        """Return what the object behind its header holds: of a container what it unpacks to, else nothing."""
        signature, _, _, size, kind = _BASE.unpack(head)
        if signature != b"LOBJ" or size < _BASE.size:
            raise OddBlfError
        body = self._file.read(min(size - _BASE.size, self.size))
        self._file.read(size % 4)
        if kind != _LOG_CONTAINER:
            return b""
        method, _ = _CONTAINER.unpack_from(body)
        data = body[_CONTAINER.size :]
        if method == _STORED:
            return data
        if method != _DEFLATED:
            return b""
        machine = zlib.decompressobj()
        data = machine.decompress(data, _UNPACKED_MAX)
        if machine.unconsumed_tail:
            raise OddBlfError
        self._count_unpacked(len(data))
        return data
