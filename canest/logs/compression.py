"""Bytes of a file, decompressed as they are read; what a damaged archive still holds is delivered.

The kind of archive is known by its first bytes, never by its name. Memory stays bounded: compressed bytes are
fed in small pieces, and of what makes a gigabyte of a kilobyte no more comes out at once than is wanted.
"""

from __future__ import annotations

import bz2
import io
import lzma
import zlib
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from canest.core.errors import LogError
from canest.logs.budget import Meter, stored_bytes

#: how archives of one log are named
ARCHIVE_SUFFIXES = (".gz", ".xz", ".zst", ".bz2")
_PIECE_BYTES = 1 << 14
#: four bytes of zstd may stand for 128 kB, and its machine has no limit to what it gives
_ZSTD_PIECE_BYTES = 1 << 10
_OUT_BYTES = 1 << 22
_MAGIC_BYTES = 6


def _zstd() -> Any:
    import zstandard

    return zstandard.ZstdDecompressor().decompressobj()


#: first bytes -> (name, how to make a decompressor)
_ARCHIVES: dict[bytes, tuple[str, Callable[[], Any]]] = {
    b"\x1f\x8b": ("gzip", lambda: zlib.decompressobj(wbits=31)),
    b"\xfd7zXZ\x00": ("xz", lzma.LZMADecompressor),
    b"BZh": ("bzip2", bz2.BZ2Decompressor),
    b"\x28\xb5\x2f\xfd": ("zstd", _zstd),
}


class Source:
    """A log file opened for reading; use as a context manager.

    bytes_done, bytes_total: of the file as stored (for a progress bar); total is 0 for a pipe.
    damage: '' or why the archive ended before its end. meter: what reading it costs.

    Errors: LogError when the file cannot be opened or read, or costs more than its budget.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        self.bytes_done = 0
        try:
            self._file: BinaryIO = path.open("rb")
            self.bytes_total = path.stat().st_size
        except OSError as error:
            raise LogError(f"cannot open: {error.strerror or error}", where=str(path)) from None
        self.is_file = path.is_file()
        self.meter = Meter(path, stored_bytes(self._file) if self.is_file else 0)
        head = self._raw(_MAGIC_BYTES)
        self._head = head
        self._make: Callable[[], Any] | None = None
        self.archive = ""
        for magic, (name, make) in _ARCHIVES.items():
            if head.startswith(magic):
                self.archive, self._make = name, make
        # bzip2's and xz' machines hold back what would be too much
        self._limit = (_OUT_BYTES,) if self.archive in ("bzip2", "xz") else ()
        self._piece_bytes = _ZSTD_PIECE_BYTES if self.archive == "zstd" else _PIECE_BYTES
        self._machine = self._start()

    @property
    def is_plain(self) -> bool:
        """Return whether the file itself holds the log, and may be read at any place: no archive, no pipe."""
        return not self.archive and self.is_file

    def __enter__(self) -> Source:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self, size: int) -> bytes:
        """Return at least ``size`` bytes, and fewer only at the end."""
        if self._make is None:
            head, self._head = self._head, b""
            return head + self._raw(max(size - len(head), 0))
        out = io.BytesIO()
        while out.tell() < size:
            piece = b""
            if not self._holds_back:
                piece, self._head = self._head or self._raw(self._piece_bytes), b""
            if not (piece or self._holds_back) or self.damage:
                if not self.damage and not self._machine.eof:
                    self.damage = f"the {self.archive} archive ends early"
                break
            out.write(self._decompress(piece))
        return out.getvalue()

    def _decompress(self, piece: bytes) -> bytes:
        out = b""
        while (piece or self._holds_back) and not self.damage:
            if self._machine.eof:  # archives may be several, one behind the other
                piece = piece.lstrip(b"\0")
                if not piece:
                    break
                self._machine = self._start()
            try:
                unpacked = self._machine.decompress(piece, *self._limit)
            except MemoryError:
                raise
            except Exception as error:  # each library has its own, with no common root
                self.damage = f"the {self.archive} archive is damaged ({error})".replace("\n", " ")
                break
            self.meter.unpack(len(unpacked))
            out += unpacked
            if self._holds_back:
                break
            piece = self._machine.unused_data if self._machine.eof else b""
        return out

    @property
    def _holds_back(self) -> bool:
        return bool(self._limit) and not (self._machine.needs_input or self._machine.eof)

    def _start(self) -> Any:
        return self._make() if self._make else None

    def _raw(self, size: int) -> bytes:
        try:
            data = self._file.read(size)
        except OSError as error:
            raise LogError(f"cannot read: {error.strerror or error}", where=str(self.path)) from None
        self.bytes_done += len(data)
        if not self.is_file:  # a pipe's size is what has come through so far
            self.meter.stored = self.bytes_done
        return data
