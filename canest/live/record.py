"""Writes what was received as candump logs: one file on demand, or a bounded ring of compressed segments.

The frames are written as they came, with the stamps the estimator saw, so that a replay of the file gives
the same estimates to the last bit.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gzip
import os
import re
import stat
import time
from collections.abc import Callable, Sized
from io import FileIO
from pathlib import Path
from typing import Generic, TypeVar

from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.logs.candump_writer import candump_text
from canest.logs.estimate_writer import estimates_csv
from canest.system.atomic_file import not_regular, require_regular
from canest.system.files import Background, file_name_in_errors

Block = TypeVar("Block", bound=Sized)

WRITE_EVERY_S = 1.0
_SEGMENT_SHARE = 40  #: the ring is bounded by this many segments of equal size
_SEGMENT_S = 900.0  #: and each is closed after this long, so that a crash costs little
_SEGMENT_NAME = re.compile(r"\d{8}T\d{6}Z-[\w.-]+\.log\.gz")


class _Spool(Generic[Block]):
    """Collects blocks and hands them, rendered as text, to the writing thread once a second."""

    _path: Path  #: the file that is being written

    def __init__(self, kind: str, render: Callable[[list[Block]], bytes], background: Background) -> None:
        self._kind, self._render, self._background = kind, render, background
        self._blocks: list[Block] = []
        self._write_at_s = 0.0

    def add(self, block: Block, now_s: float) -> None:
        """Take the next block; ``now_s``: monotonic time."""
        if len(block):
            self._blocks.append(block)
        if now_s >= self._write_at_s:
            self._write_at_s = now_s + WRITE_EVERY_S
            self.flush()

    def flush(self) -> None:
        """Queue what has been collected. A queue that is full (the disk hangs) loses it, and counts."""
        blocks, self._blocks = self._blocks, []
        if blocks and not self._background.submit(self._kind, lambda: self._put(blocks)):
            self._background.counters[f"{self._kind}_rows_lost"] += sum(map(len, blocks))

    def close(self) -> None:
        """Queue what has been collected, and the end of the file."""
        self.flush()
        self._background.submit(self._kind, self._finish)

    def _put(self, blocks: list[Block]) -> None:
        with file_name_in_errors(self._path):
            self._write(self._render(blocks))

    def _finish(self) -> None:
        with file_name_in_errors(self._path):
            self._end()

    def _write(self, text: bytes) -> None:
        raise NotImplementedError

    def _end(self) -> None:
        raise NotImplementedError


def candump_renderer(channel: str) -> Callable[[list[FrameBlock]], bytes]:
    """Return what turns frames into candump's log form under a channel's name."""
    name = re.sub(r"[^\w.-]", "_", channel)
    return lambda blocks: candump_text(FrameBlock.concatenate(blocks), name)


def render_estimates(blocks: list[Estimates]) -> bytes:
    """Return rows of est.csv."""
    return estimates_csv(Estimates.concatenate(blocks), slice(None))


class TextLog(_Spool[Block]):
    """One growing text file (a candump log, est.csv). ``header`` is its first line when it is new."""

    def __init__(
        self,
        path: Path,
        render: Callable[[list[Block]], bytes],
        background: Background,
        *,
        kind: str,
        header: bytes = b"",
    ) -> None:
        super().__init__(kind, render, background)
        self._path, self._header = path, header
        self._file: FileIO | None = None

    def _write(self, text: bytes) -> None:
        if self._file is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _open_to_append(self._path)
        if self._header and _is_empty(self._file):  # also where somebody has truncated it since
            text = self._header + text
        # an unbuffered write may be cut short by a full disk: take back what makes no whole line
        begin = self._file.seek(0, os.SEEK_END)
        try:
            complete = self._file.write(text) == len(text)
        except OSError:
            self._take_back(begin)
            raise
        if not complete:
            self._take_back(begin)
            raise OSError(errno.ENOSPC, "no space left on device")

    def _end(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _take_back(self, begin: int) -> None:
        assert self._file is not None
        with contextlib.suppress(OSError):  # a device or pipe cannot; the error reported is that of the write
            self._file.truncate(begin)
            self._file.seek(begin)


def _is_empty(file: FileIO) -> bool:
    """Return whether a file that grows has nothing in it; a device never had."""
    status = os.fstat(file.fileno())
    return stat.S_ISREG(status.st_mode) and status.st_size == 0


def _open_to_append(path: Path) -> FileIO:
    """Open a growing file. Errors: OSError, also for what would keep the writing thread waiting."""
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o666)
    mode = os.fstat(descriptor).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISCHR(mode)):  # a FIFO opened for both ends waits for nobody
        os.close(descriptor)
        raise not_regular(mode, path)
    if stat.S_ISREG(mode):  # held until the file is closed: rows of two daemons would be one useless file
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise OSError(errno.EBUSY, "another process writes this file", str(path)) from None
        except OSError:  # a file system without locks
            pass
    return FileIO(descriptor, "ab")


class Ring(_Spool[FrameBlock]):
    """Compressed segments in one folder, together never larger than ``max_bytes``: what the bus carried.

    Named by time and channel, readable by every command that reads logs; the oldest go first. Those
    of a time yet to come were written before the clock was set back: they go before all others.
    """

    def __init__(
        self,
        folder: Path,
        channel: str,
        max_bytes: int,
        background: Background,
        clock_s: Callable[[], float] = time.time,
    ) -> None:
        super().__init__("ring", candump_renderer(channel), background)
        self._folder, self._max_bytes, self._clock_s = folder, max_bytes, clock_s
        self._channel = re.sub(r"[^\w.-]", "_", channel)
        self._file: gzip.GzipFile | None = None
        self._path = folder
        self._begun_s = 0.0
        self._holds_frames = False

    def _put(self, blocks: list[FrameBlock]) -> None:
        try:
            super()._put(blocks)
        except OSError as error:
            error.filename = str(self._folder)  # every segment has another name; the failure is one
            raise

    def _write(self, text: bytes) -> None:
        if self._file is None:
            self._begin_segment()
        assert self._file is not None
        try:
            self._file.write(text)
            self._file.flush()  # a sync flush: what is on the disk so far can be read after a crash
            size = self._path.stat().st_size
            self._holds_frames = True
        except OSError:
            self._give_up()
            raise
        age_s = self._clock_s() - self._begun_s
        if size > self._max_bytes // _SEGMENT_SHARE or not 0 <= age_s <= _SEGMENT_S:
            self._end()

    def _give_up(self) -> None:
        """Leave the segment as far as it is on the disk; one that has nothing yet leaves no file behind."""
        file, self._file = self._file, None
        with contextlib.suppress(OSError):  # closing writes too
            if file is not None:
                file.close()
        with contextlib.suppress(OSError):
            if not self._holds_frames:
                self._path.unlink()

    def _begin_segment(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        self._begun_s = self._clock_s()
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(self._begun_s))
        self._drop_oldest(stamp)
        self._path = self._folder / f"{stamp}-{self._channel}.log.gz"
        self._holds_frames = self._path.exists()  # of the same second
        require_regular(self._path)
        self._file = gzip.open(self._path, "ab", compresslevel=1)  # noqa: SIM115 - lives for a quarter of an hour

    def _end(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _drop_oldest(self, now: str) -> None:
        segments = [p for p in self._folder.iterdir() if _SEGMENT_NAME.fullmatch(p.name)]
        segments.sort(key=lambda p: (p.name[: len(now)] <= now, p.name))
        sizes = [p.stat().st_size for p in segments]
        # room for the segment that begins now, and for the last write, which may carry it beyond its share
        limit = self._max_bytes - 2 * (self._max_bytes // _SEGMENT_SHARE)
        excess = sum(sizes) - limit
        for path, size in zip(segments, sizes, strict=True):
            if excess <= 0:
                break
            path.unlink()
            excess -= size
