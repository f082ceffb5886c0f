"""What every log reader offers."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Mapping
from types import TracebackType

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FrameBlock
from canest.core.table_block import TableBlock
from canest.logs.budget import Meter
from canest.logs.compression import Source

#: frames per block: large enough that the pipeline's fixed cost per block vanishes, a few MB of columns
BLOCK_FRAMES = 1 << 17

#: formats of frames that are read
KNOWN_LOGS = "candump text, .asc .blf .trc .mf4 .db, .csv of python-can, Vehicle Spy or a CANalyzer trace"
#: a damaged log may name any number of interfaces
_CHANNELS_SHOWN = 8
SKIPPED_SHOWN = 50  #: of the lines that could not be read, so many are kept ...
SHOWN_CHARS = 80  #: ... with so much of their text
#: glibc's largest adaptive limit is 32 MB
_HEAP_BYTES = 1 << 24


def _keep_heap() -> None:
    """Let the C library keep the memory of freed columns instead of handing it back each time.

    glibc takes blocks above a limit (128 kB at first) from the kernel, page by page and zeroed, which costs
    as much as parsing. The limit adapts to the largest such block ever freed: free one (never touched, so it
    costs no memory). Elsewhere this does nothing.
    """
    np.empty(_HEAP_BYTES, np.uint8)


class LogReader(ABC):
    """A log: iterate once over its blocks, then look at what could not be read.

    frames: well-formed frames (table: rows) so far, delivered or not.
    skipped_lines, skipped: lines (records) that could not be read; the first as (number, text, reason).
    truncated, truncated_reason: the file ends before it should.
    bytes_done, bytes_total: progress through the file.
    channels: frames per interface. Iteration ends with a LogError when the one asked for has none.
    """

    #: what iteration yields: "frames" (FrameBlock), "table" (TableBlock) or "nothing" (an empty file)
    kind = "frames"
    format = ""

    def __init__(self, source: Source, channel: str | None = None) -> None:
        self._source, self._channel = source, channel
        self.path = source.path
        self.truncated_reason = ""

    @property
    def truncated(self) -> bool:
        """True when the file ends before it should."""
        return bool(self.truncated_reason)

    @property
    def bytes_done(self) -> int:
        """Bytes of the stored file taken in so far."""
        return self._source.bytes_done

    @property
    def bytes_total(self) -> int:
        """Size of the stored file, 0 when it is not known."""
        return self._source.bytes_total

    @property
    def meter(self) -> Meter:
        """What reading it has cost so far."""
        return self._source.meter

    @property
    def channels(self) -> Mapping[str, int]:
        """Frames per interface so far; a table has none."""
        return {}

    @property
    def channel(self) -> str | None:
        """The interface that was asked for, None for all."""
        return self._channel

    @property
    def remarks(self) -> list[str]:
        """What else a user should know of the content, one sentence each."""
        return []

    def channels_text(self) -> str:
        """Return the interfaces with most frames, in words."""
        named = sorted(self.channels.items(), key=lambda item: -item[1])[:_CHANNELS_SHOWN]
        # a damaged one may hold anything, also what steers a terminal
        return ", ".join(f"{n if n.isprintable() else ascii(n)} ({frames:,} frames)" for n, frames in named)

    @property
    @abstractmethod
    def frames(self) -> int:
        """Well-formed frames (rows of a table) so far."""

    @property
    @abstractmethod
    def skipped_lines(self) -> int:
        """Lines or records that could not be read."""

    @property
    @abstractmethod
    def skipped(self) -> list[tuple[int, str, str]]:
        """The first unreadable lines: (number, text, reason)."""

    def __iter__(self) -> Iterator[FrameBlock | TableBlock]:
        _keep_heap()
        with self._source:
            yield from self._metered()
            self.truncated_reason = self.truncated_reason or self._source.damage
        if not self.frames and self.skipped_lines:
            number, text, reason = self.skipped[0]
            raise LogError(
                f"nothing to read in {self.skipped_lines} lines; line {number}: {reason}",
                where=str(self.path),
                found=text,
            )
        if not self.frames and self.truncated:
            raise LogError(
                "nothing to read",
                where=str(self.path),
                found=self.truncated_reason,
                expected="frames or rows",
            )
        if self._channel is not None and self.channels and self._channel not in self.channels:
            raise LogError(
                "no frame on this channel",
                where=str(self.path),
                found=self._channel,
                expected=f"one of {self.channels_text()}",
            )

    def _metered(self) -> Iterator[FrameBlock | TableBlock]:
        """Yield the blocks; what is done with them in between costs the log nothing."""
        with contextlib.closing(self._blocks()) as blocks:
            while True:
                with self._source.meter:
                    block = next(blocks, None)
                if block is None:
                    return
                yield block

    def close(self) -> None:
        """Close the file (iterating to the end does)."""
        self._source.close()

    def __enter__(self) -> LogReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _blocks(self) -> Generator[FrameBlock | TableBlock]: ...


class CountingReader(LogReader):
    """A reader that counts what it reads and what it skips."""

    def __init__(self, source: Source, channel: str | None = None) -> None:
        super().__init__(source, channel)
        self._frames = self._skipped_lines = 0
        self._skipped: list[tuple[int, str, str]] = []
        self._channels: dict[str, int] = {}

    @property
    def frames(self) -> int:
        """Frames (rows of a table) so far, delivered or not."""
        return self._frames

    @property
    def channels(self) -> Mapping[str, int]:
        """Frames per interface so far, as the format names them; a table has none."""
        return self._channels

    @property
    def skipped_lines(self) -> int:
        """Lines or records that could not be read."""
        return self._skipped_lines

    @property
    def skipped(self) -> list[tuple[int, str, str]]:
        """The first of them: (number, text, reason)."""
        return self._skipped

    def _skip(self, number: int, text: str, reason: str) -> None:
        """Count a line or record that could not be read; keep the first."""
        self._skipped_lines += 1
        if len(self._skipped) < SKIPPED_SHOWN:
            self._skipped.append((number, text[:SHOWN_CHARS], reason))
