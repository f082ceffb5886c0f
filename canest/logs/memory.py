"""Logs that a program holds in memory: read like those in files, by the same readers' interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Generator
from pathlib import Path
from typing import TYPE_CHECKING

from canest.core.errors import LogError
from canest.core.frames import FrameBlock
from canest.logs.base import BLOCK_FRAMES, LogReader
from canest.logs.budget import NO_BUDGET, Meter, log_budget
from canest.logs.compression import Source

if TYPE_CHECKING:
    from canest.core.table_block import TableBlock

#: of one frame or row as candump text, for what depends on a log's size
_TEXT_BYTES = 45


class MemoryLog(ABC):
    """Frames or rows in memory. name: how messages call it."""

    name = "memory"
    #: the error for whoever asks for one interface of it
    no_channel = "a log in memory has no interfaces"

    @abstractmethod
    def __len__(self) -> int:
        """Return how many frames or rows there are."""

    @abstractmethod
    def reader(
        self, time_column: str, columns: Collection[str] | None, as_text: Collection[str]
    ) -> LogReader:
        """Return a reader for one pass; the arguments are those of `open_log`."""

    def open(
        self,
        *,
        channel: str | None,
        time_column: str,
        columns: Collection[str] | None,
        as_text: Collection[str],
    ) -> LogReader:
        """Return a reader for one pass, as `open_log` does. Errors: LogError for a channel: there is none."""
        if channel is not None:
            raise LogError(self.no_channel, where=self.name, found=channel, expected="none")
        return self.reader(time_column, columns, as_text)

    @property
    def text_bytes(self) -> int:
        """Return how long it would be as candump text, about."""
        return _TEXT_BYTES * len(self)

    def __str__(self) -> str:
        return self.name


class MemorySource(Source):
    """What stands in a reader for its file: nothing to open, read or pay for."""

    def __init__(self, name: str) -> None:
        self.path = Path(name)
        self.damage = ""
        self.bytes_done = self.bytes_total = 0
        self.is_file = False
        self.archive = ""
        with log_budget(NO_BUDGET):
            self.meter = Meter(self.path, 0)

    def close(self) -> None:
        """Nothing is open."""


class FrameLog(MemoryLog):
    """A block of frames as a log."""

    name = "frames"
    no_channel = "frames in memory have no interfaces"

    def __init__(self, frames: FrameBlock, name: str = "frames") -> None:
        self.frames, self.name = frames, name

    def __len__(self) -> int:
        return len(self.frames)

    def reader(
        self, time_column: str, columns: Collection[str] | None, as_text: Collection[str]
    ) -> LogReader:
        """Return a reader."""
        return FrameLogReader(self)


class FrameLogReader(LogReader):
    """Reads a block of frames, a part at a time."""

    format = "frames"

    def __init__(self, log: FrameLog) -> None:
        super().__init__(MemorySource(log.name))
        self._log = log
        self._frames = 0
        if not len(log):
            self.kind = "nothing"

    @property
    def frames(self) -> int:
        """Frames so far."""
        return self._frames

    @property
    def skipped_lines(self) -> int:
        """None: every frame is one."""
        return 0

    @property
    def skipped(self) -> list[tuple[int, str, str]]:
        """None."""
        return []

    def _blocks(self) -> Generator[FrameBlock | TableBlock]:
        for first in range(0, len(self._log), BLOCK_FRAMES):
            block = self._log.frames[first : first + BLOCK_FRAMES]
            self._frames += len(block)
            yield block
