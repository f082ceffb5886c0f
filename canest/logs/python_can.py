"""Logs in the formats that python-can reads, through its readers, into frame blocks."""

from __future__ import annotations

import contextlib
import gc
import math
import tempfile
from collections.abc import Generator, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.logs.base import CountingReader
from canest.logs.candump_line import CLASSIC_BYTES
from canest.logs.compression import Source
from canest.logs.damaged import (
    blf_reader,
    find_asammdf,
    mf4_reader,
    quiet_lines,
    quiet_messages,
    silenced,
    sqlite_reader,
)
from canest.logs.frame_columns import NO_CHANNEL, FrameColumns
from canest.logs.line_parser import Wanted
from canest.logs.python_can_lines import Lines, OneLine, in_plain_words
from canest.system.installation import how_to_add

_TEXT_BYTES = 1 << 18
_SECONDS_MAX = 9e12
_TEXT_SUFFIXES = (".asc", ".trc", ".csv")
_UNNAMED = "unnamed"  #: the interface of a format that names none
_BYTES_MAX = 64  #: payload of CAN FD


class PythonCanReader(CountingReader):
    """A log that python-can reads; a record it stumbles over is counted, text formats go on behind it."""

    def __init__(
        self,
        source: Source,
        head: bytes,
        suffix: str,
        wanted: Wanted | None,
        channel: str | None,
        block_frames: int,
    ) -> None:
        super().__init__(source, channel)
        self.format = suffix.removeprefix(".")
        self._head, self._suffix, self._wanted = head, suffix, wanted
        self._block_frames = block_frames
        self._lines: Lines | OneLine | None = None
        self._stored: BinaryIO | None = None

    def _blocks(self) -> Generator[FrameBlock]:
        held: list[tuple[int, int, int, int]] = []
        for message in self._messages():
            frame = self._frame(message)
            if frame is not None:
                held.append(frame)
                if len(held) >= self._block_frames:
                    yield self._select(held)
                    held = []
        if held:
            yield self._select(held)

    def _messages(self) -> Iterator[Any]:
        if self._suffix in _TEXT_SUFFIXES:
            yield from self._text_messages()
            return
        with self.stored() as file:
            yield from self._binary_messages(file)

    @contextlib.contextmanager
    def stored(self) -> Iterator[BinaryIO]:
        """Yield a file that can be read at any place: of an archive or a pipe a copy."""
        if self._stored is not None:
            self._stored.seek(0)
            yield self._stored
        elif self._source.is_plain:
            with self.path.open("rb") as self._stored:
                yield self._stored
        else:
            with tempfile.NamedTemporaryFile(suffix=self._suffix) as unpacked:
                self._unpack(unpacked)
                self._stored = cast(BinaryIO, unpacked.file)  # asammdf knows no wrapper
                yield self._stored

    def _show_progress(self, file: BinaryIO) -> None:
        if self._source.is_plain:
            self._source.bytes_done = max(self._source.bytes_done, file.tell())

    def _unpack(self, file: Any) -> None:
        try:
            file.write(self._head)
            while piece := self._source.read(_TEXT_BYTES):
                file.write(piece)
            file.seek(0)
        except OSError as error:
            raise LogError(
                f"cannot be unpacked into {file.name}: {error.strerror or error}",
                where=str(self.path),
                expected="room for it (TMPDIR names another place)",
            ) from None

    def _binary_messages(self, file: Any) -> Iterator[Any]:
        of_database = partial(sqlite_reader, log=self.path)
        make: Any = {".blf": blf_reader, ".mf4": mf4_reader, ".db": of_database}[self._suffix]
        source = file.name if self._suffix == ".db" else file  # sqlite opens by name only
        damage, announced = "", 0
        with silenced():
            try:
                reader = self._reader(make, source)
            except (LogError, MemoryError):
                raise
            except Exception as error:  # whatever a damaged file makes of python-can
                damage = _reason(error)
            if damage:
                gc.collect()  # the destructor of what could not be constructed runs now
        if not damage:
            try:
                announced = getattr(reader, "file_size", 0)
                self._resume(reader, file)
                with reader:
                    yield from quiet_messages(reader)
            except MemoryError:
                raise
            except Exception as error:  # as above
                damage = _reason(error)
        if damage and not self._frames:
            what = f"damaged or cut short, nothing in it can be read ({damage})"
            raise LogError(what, where=str(self.path), expected=f"a whole {self._suffix} file")
        actual = Path(file.name).stat().st_size
        if actual < announced:  # python-can may end quietly here
            self.truncated_reason = f"holds {actual:,} of the {announced:,} bytes its header announces"
        elif damage:
            self.truncated_reason = f"damaged after {self._frames:,} frames: {damage}"

    def _resume(self, reader: Any, file: BinaryIO) -> None:
        """Let python-can's reader begin where another one stopped."""

    def _text_messages(self) -> Iterator[Any]:
        """Iterate with a fresh reader behind every line that ends one; the header is read again each time."""
        from canest.system.python_can import can  # heavy

        kind = {".asc": can.ASCReader, ".trc": can.TRCReader, ".csv": can.CSVReader}[self._suffix]
        lines = self._lines = Lines(self._source, self._head, self._suffix, self._skip_line)
        while not lines.ended:
            seen = lines.number
            lines.rewind_header()
            try:
                with quiet_lines():
                    for message in self._reader(kind, lines):
                        lines.claim()
                        yield message
            except (LogError, MemoryError):
                raise
            except Exception as error:  # as above
                lines.claim()
                self._skip(lines.number, lines.current.strip(), in_plain_words(error))
            if lines.number == seen:  # it stumbles over the header itself, and would do so for ever
                lines.drop_header()

    def _skip_line(self, number: int, text: str) -> None:
        self._skip(number, text, "holds no frame that can be read")

    def _reader(self, make: Any, source: Any) -> Any:
        if self._suffix == ".mf4":
            find_asammdf()
        try:
            return make(source)
        except (ImportError, NotImplementedError):
            raise LogError(
                f"log is in {self._suffix} format",
                where=str(self.path),
                expected=f"the asammdf package: {how_to_add('formats')}",
            ) from None

    def _frame(self, message: Any) -> tuple[int, int, int, int] | None:
        try:
            stamp, can_id = float(message.timestamp), int(message.arbitration_id)
            payload = bytes(message.data or b"")
            length = int(message.dlc) if message.is_remote_frame else len(payload)
        except (TypeError, ValueError, OverflowError) as error:  # a damaged database holds anything anywhere
            self._skip_message(in_plain_words(error))
            return None
        if self._lines is not None and not (message.is_remote_frame or message.is_error_frame):
            announced = min(int(message.dlc), _BYTES_MAX if message.is_fd else CLASSIC_BYTES)
            if length < announced:  # cut off
                self._skip_message(f"{length} data bytes where {announced} are announced")
                return None
        if not math.isfinite(stamp) or abs(stamp) > _SECONDS_MAX:
            self._skip_message("impossible time stamp", str(stamp))
            return None
        if not (0 <= can_id <= ID_MASK and 0 <= length <= _BYTES_MAX):
            self._skip_message("no CAN frame", f"{can_id:x}")
            return None
        self._frames += 1
        channel = _UNNAMED if message.channel is None else str(message.channel)
        self._channels[channel] = self._channels.get(channel, 0) + 1
        if self._channel is not None and channel != self._channel:
            return None
        can_id |= EXTENDED * message.is_extended_id if not message.is_error_frame else ERROR
        can_id |= REMOTE * message.is_remote_frame
        return round(stamp * 1e6), can_id, length, int.from_bytes(payload[:8], "little")

    def _select_columns(self, columns: FrameColumns) -> FrameBlock:
        """Count frames, and return those that are wanted; as `_frame` does with one message."""
        timely = np.abs(columns.t_s) <= _SECONDS_MAX  # false for NaN
        good = timely & (columns.length <= _BYTES_MAX)
        if not good.all():
            before = self._frames + np.cumsum(good)
            for row in np.flatnonzero(~good).tolist():
                can_id = int(columns.can_id[row]) & ID_MASK
                self._skip(
                    int(before[row]) + 1,
                    f"{can_id:x}" if timely[row] else str(columns.t_s[row]),
                    "no CAN frame" if timely[row] else "impossible time stamp",
                )
            columns = columns[good]
        self._frames += len(columns)
        columns = self._of_channel(columns)
        block = FrameBlock(
            np.rint(columns.t_s * 1e6).astype(np.int64),
            columns.can_id,
            columns.length.astype(np.uint8),
            columns.data,
        )
        return block if self._wanted is None else block[self._wanted(block.can_id)]

    def _of_channel(self, columns: FrameColumns) -> FrameColumns:
        if columns.channel is None:
            numbers, counts = [NO_CHANNEL], [len(columns)]
        else:
            found = np.unique(columns.channel, return_counts=True)
            numbers, counts = found[0].tolist(), found[1].tolist()
        keep = np.ones(len(columns), np.bool_)
        for number, count in zip(numbers, counts, strict=True):
            name = _UNNAMED if number == NO_CHANNEL else str(number)
            if count:
                self._channels[name] = self._channels.get(name, 0) + count
            if self._channel is not None and name != self._channel:
                keep &= False if columns.channel is None else columns.channel != number
        return columns if keep.all() else columns[keep]

    def _select(self, frames: list[tuple[int, int, int, int]]) -> FrameBlock:
        t_us, can_id, length, data = zip(*frames, strict=True)
        block = FrameBlock(
            np.array(t_us, np.int64),
            np.array(can_id, np.uint32),
            np.array(length, np.uint8),
            np.array(data, np.uint64),
        )
        return block if self._wanted is None else block[self._wanted(block.can_id)]

    def _skip_message(self, reason: str, shown: str = "") -> None:
        """Count what python-can made of the current line, or of a record."""
        if self._lines is None:
            self._skip(self._frames + 1, shown, reason)
        else:
            self._skip(self._lines.number, self._lines.current.strip(), reason)


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".replace("\n", " ")[:200]
