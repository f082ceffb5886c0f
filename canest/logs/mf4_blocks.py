"""The blocks of an MDF 4 file (ASAM MDF 4.1): links, texts, and the data behind lists and compression.

Whatever is not in the standard's common subset raises `UnsupportedMf4Error`: another reader may know more.
"""

from __future__ import annotations

import bisect
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from canest.logs.budget import Meter

_HEADER = struct.Struct("<4s4xQQ")
_LINK_BYTES = 8
#: of a block that is no data; the longest real ones are texts of some kB and lists of some thousand links
_BLOCK_BYTES_MAX = 1 << 24
#: blocks in one chain, deep or long; a damaged link may lead in a circle
_CHAIN_MAX = 100_000
#: of one compressed block; writers use at most 4 MB
_UNPACKED_MAX = 1 << 26
_DEFLATE, _TRANSPOSED = 0, 1


class UnsupportedMf4Error(Exception):
    """The file has something that this reader does not know, or is damaged."""


@dataclass(frozen=True, slots=True)
class Block:
    """One block: its four-letter name, what it links to, and the bytes behind the links."""

    name: bytes
    address: int
    length: int
    links: tuple[int, ...]
    data: bytes

    def link(self, index: int) -> int:
        """Return a link, 0 for none."""
        return self.links[index] if index < len(self.links) else 0


class Mf4File:
    """The file of an MF4 log. Errors of all methods: UnsupportedMf4Error."""

    def __init__(self, file: BinaryIO, meter: Meter) -> None:
        self._file, self._meter = file, meter
        self.size = file.seek(0, 2)

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of the file, fewer at its end."""
        if not 0 <= address <= self.size:
            raise UnsupportedMf4Error("a link that leads out of the file")
        self._file.seek(address)
        return self._file.read(size)

    def unpack(self, data: bytes, size: int) -> bytes:
        """Return what a compressed block holds, ``size`` bytes."""
        if size > _UNPACKED_MAX:
            raise UnsupportedMf4Error(f"a compressed block of {size:,} bytes")
        machine = zlib.decompressobj()
        try:
            unpacked = machine.decompress(data, size)
        except zlib.error as error:
            raise UnsupportedMf4Error(str(error)) from None
        self._meter.unpack(len(unpacked))
        if len(unpacked) != size:
            raise UnsupportedMf4Error("a compressed block ends early")
        return unpacked

    def block(self, address: int, *names: bytes) -> Block:
        """Return the block at an address, which has one of these names; its data too."""
        name, length, count = self.header(address, *names)
        if length > _BLOCK_BYTES_MAX:
            raise UnsupportedMf4Error(f"a block of {length:,} bytes")
        body = self.read(address + _HEADER.size, length - _HEADER.size)
        if len(body) < length - _HEADER.size or count * _LINK_BYTES > len(body):
            raise UnsupportedMf4Error("a block ends early")
        links = struct.unpack_from(f"<{count}Q", body)
        return Block(name, address, length, links, body[count * _LINK_BYTES :])

    def header(self, address: int, *names: bytes) -> tuple[bytes, int, int]:
        """Return name, length in bytes and number of links of a block."""
        head = self.read(address, _HEADER.size)
        if not 0 < address < self.size or len(head) < _HEADER.size:
            raise UnsupportedMf4Error("a link that leads out of the file")
        name, length, count = _HEADER.unpack(head)
        if name[2:] not in names or name[:2] != b"##" or length < _HEADER.size:
            raise UnsupportedMf4Error(f"found {name!r} where {names} is expected")
        return name[2:], length, count

    def chain(self, address: int, name: bytes) -> Iterator[Block]:
        """Yield blocks of one kind, each linked by the one before it."""
        seen = 0
        while address:
            seen += 1
            if seen > _CHAIN_MAX:
                raise UnsupportedMf4Error("a chain of blocks without end")
            block = self.block(address, name)
            yield block
            address = block.link(0)

    def text(self, address: int) -> str:
        """Return the text of a TX block, '' where there is none."""
        if not address:
            return ""
        return self.block(address, b"TX", b"MD").data.split(b"\0", 1)[0].decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class _Segment:
    """A piece of a data stream: where it stands in the file, and how it is packed."""

    address: int
    stored: int
    size: int
    packing: int | None
    columns: int  #: of a transposed block


class DataStream:
    """The bytes behind a data link (DT, SD, DZ, or a list of them) as one stream.

    size: bytes that there are. cut_short: the file ends before the last of them.
    open_end: a DT block of no length goes on to the end of the file (an unfinished recording).
    """

    def __init__(self, file: Mf4File, address: int, open_end: bool = False) -> None:
        self._file = file
        self._segments: list[_Segment] = []
        self._begins: list[int] = []
        self._held = (-1, b"")
        self.size, self.cut_short = 0, False
        if address:
            self._collect(address, open_end)

    def read(self, begin: int, size: int) -> bytes:
        """Return bytes of the stream, fewer at its end. Errors: UnsupportedMf4Error."""
        parts = []
        end = min(begin + size, self.size)
        while begin < end:
            index = bisect.bisect_right(self._begins, begin) - 1
            segment, within = self._segments[index], begin - self._begins[index]
            count = min(end - begin, segment.size - within)
            if segment.packing is None:
                part = self._file.read(segment.address + within, count)
                if len(part) < count:
                    raise UnsupportedMf4Error("the file became shorter")
            else:
                part = self._unpacked(index)[within : within + count]
            parts.append(part)
            begin += count
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _collect(self, address: int, open_end: bool) -> None:
        name, _, _ = self._file.header(address, b"DT", b"SD", b"DZ", b"DL", b"HL")
        if name == b"HL":
            address = self._file.block(address, b"HL").link(0)
            name = b"DL" if address else b""
        if name == b"DL":
            for block in self._file.chain(address, b"DL"):
                for link in block.links[1:]:
                    if link and not self.cut_short:
                        self._add(link, False)
        elif name:
            self._add(address, open_end)

    def _add(self, address: int, open_end: bool) -> None:
        if address >= self._file.size:  # the list came first, and the file ends before what it lists
            self.cut_short = True
            return
        name, length, count = self._file.header(address, b"DT", b"SD", b"DZ")
        begin = address + _HEADER.size + count * _LINK_BYTES
        if name == b"DZ":
            self._add_packed(address)
            return
        size = length - (begin - address)
        if open_end and name == b"DT" and size <= 0:
            size = self._file.size - begin
        there = max(min(size, self._file.size - begin), 0)
        self.cut_short |= there < size
        self._append(_Segment(begin, there, there, None, 0))

    def _add_packed(self, address: int) -> None:
        head = self._file.read(address + _HEADER.size, 24)
        if len(head) < 24:
            self.cut_short = True
            return
        packing, columns, size, stored = struct.unpack("<2xBxIQQ", head)
        begin = address + _HEADER.size + len(head)
        if packing not in (_DEFLATE, _TRANSPOSED) or (packing == _TRANSPOSED and not columns):
            raise UnsupportedMf4Error(f"packing {packing}")
        if begin + stored > self._file.size:
            self.cut_short = True
            return
        self._append(_Segment(begin, stored, size, packing, columns))

    def _append(self, segment: _Segment) -> None:
        if segment.size:
            self._segments.append(segment)
            self._begins.append(self.size)
            self.size += segment.size

    def _unpacked(self, index: int) -> bytes:
        if self._held[0] != index:
            segment, self._held = self._segments[index], (-1, b"")  # let go first: they are large
            data = self._file.unpack(self._file.read(segment.address, segment.stored), segment.size)
            if segment.packing == _TRANSPOSED:
                whole = segment.size - segment.size % segment.columns
                table = np.frombuffer(data, np.uint8, whole).reshape(segment.columns, -1)
                data = table.T.tobytes() + data[whole:]
            self._held = (index, data)
        return self._held[1]
