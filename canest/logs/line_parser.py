"""Text logs to frame blocks: layouts for the many lines, a tolerant parser for the few odd ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FrameBlock, IntColumn
from canest.logs.candump_layout import Layout, Rows

NEWLINE = 10
LINE_CHARS_MAX = 1024  #: the longest line candump writes has some 330 characters
_WIDTH_MIN = 8  #: layouts read whole words
#: below this many lines of one width, one line at a time is quicker
_FEW_LINES = 24
#: lines that fit none of this many layouts of their width are read one at a time
_LAYOUTS_PER_WIDTH = 16

Wanted = Callable[[NDArray[np.uint32]], NDArray[np.bool_]]
Piece = tuple[IntColumn, FrameBlock]  #: line indices, and the frames of those lines


class LineParser(ABC):
    """Parses whole lines of a text log; one parser per log.

    wanted: takes identifiers uint32 (n,) with flags, returns which frames to deliver (all are counted).
    channel: deliver frames of this interface only; None for all.
    """

    def __init__(self, wanted: Wanted | None = None, channel: str | None = None) -> None:
        self._wanted = wanted
        self.channel = channel
        self._channel = channel.encode() if channel is not None else None
        self._layouts: dict[int, list[Layout]] = {}
        self.lines = 0  #: lines seen
        self.frames = 0  #: well-formed frames among them, delivered or not
        self.channels: dict[str, int] = {}  #: interface -> frames

    def parse(self, text: bytes, end: int | None = None) -> FrameBlock:
        """Return the frames of ``text[:end]``, which ends with a newline, in the order of its lines."""
        end = len(text) if end is None else end
        if len(text) < end + 8:  # whole words are read from the last line too
            text += bytes(8)
        chars = np.frombuffer(text, np.uint8)
        starts, widths = _lines(text, chars, end)
        pieces: list[Piece] = []
        odd: list[IntColumn] = []
        for width, index in _by_width(widths):
            if _WIDTH_MIN <= width <= LINE_CHARS_MAX:
                index = self._parse_width(text, chars, starts, index, width, pieces)
            if len(index):
                odd.append(index)
        if odd:
            pieces += self._parse_odd(text, starts, widths, np.sort(np.concatenate(odd)))
        self.lines += len(starts)
        return self._select(pieces, len(starts))

    def _parse_width(
        self,
        text: bytes,
        chars: NDArray[np.uint8],
        starts: IntColumn,
        pending: IntColumn,
        width: int,
        pieces: list[Piece],
    ) -> IntColumn:
        """Parse the lines of one width into ``pieces``; return the indices of lines left to do."""
        layouts = self._layouts.setdefault(width, [])
        odd: list[IntColumn] = []
        tried = 0
        while len(pending) > _FEW_LINES and tried < _LAYOUTS_PER_WIDTH:
            if tried == len(layouts):
                start = int(starts[pending[0]])
                layout = self._learn(text[start : start + width])
                if layout is None or layout in layouts:
                    odd.append(pending[:1])
                    pending = pending[1:]
                    continue
                layouts.append(layout)
            layout = layouts[tried]
            tried += 1
            frames, fits = self._parse_rows(layout, chars, starts[pending], width)
            if fits.all():
                done, pending = pending, pending[:0]
            else:
                done, pending, frames = pending[fits], pending[~fits], frames[fits]
            if self._count(layout.channel, len(done)):
                pieces.append((done, frames))
        return np.concatenate([*odd, pending])

    @abstractmethod
    def _learn(self, line: bytes) -> Layout | None:
        """Return the layout of a line, None for one that is too odd to have one."""

    @abstractmethod
    def _parse_odd(self, text: bytes, starts: IntColumn, widths: IntColumn, odd: IntColumn) -> list[Piece]:
        """Parse the lines of these indices one at a time."""

    def _parse_rows(
        self, layout: Layout, chars: NDArray[np.uint8], starts: IntColumn, width: int
    ) -> tuple[FrameBlock, BoolColumn]:
        """Return the frames of lines of one width, and which of them have the layout."""
        if starts[-1] - starts[0] == (len(starts) - 1) * (width + 1):  # back to back already: no need to copy
            return layout.parse(Rows(chars[starts[0] :], len(starts), width + 1))
        return layout.parse(Rows.gather(chars, starts, width))

    def _count(self, channel: bytes, frames: int) -> bool:
        """Count frames of an interface; return whether they are to be delivered."""
        if not frames:
            return False
        name = channel.decode("ascii", "backslashreplace")
        self.frames += frames
        self.channels[name] = self.channels.get(name, 0) + frames
        return self._channel is None or channel == self._channel

    def _select(self, pieces: list[Piece], lines: int) -> FrameBlock:
        """Put the pieces into the order of their lines, and keep what is wanted."""
        if len(pieces) == 1:
            block = pieces[0][1]
            keep = np.ones(len(block), np.bool_)
        else:
            keep = np.zeros(lines, np.bool_)
            block = FrameBlock(
                np.empty(lines, np.int64),
                np.empty(lines, np.uint32),
                np.empty(lines, np.uint8),
                np.empty(lines, np.uint64),
            )
            for index, piece in pieces:
                keep[index] = True
                block.t_us[index] = piece.t_us
                block.can_id[index] = piece.can_id
                block.length[index] = piece.length
                block.data[index] = piece.data
            block.can_id[~keep] = 0
        if self._wanted is not None:
            keep &= self._wanted(block.can_id)
        return block if keep.all() else block[np.flatnonzero(keep)]


def _lines(text: bytes, chars: NDArray[np.uint8], end: int) -> tuple[IntColumn, IntColumn]:
    """Return where each line of ``text[:end]`` starts, and its width (capped above the longest allowed)."""
    newline = chars[:end] == NEWLINE
    stride = text.find(b"\n", 0, end) + 1
    if stride and np.count_nonzero(newline) * stride == end and bool(newline[stride - 1 :: stride].all()):
        starts = np.arange(0, end, stride)
        return starts, np.full(len(starts), min(stride - 1, LINE_CHARS_MAX + 1))
    ends = np.flatnonzero(newline)
    starts = np.empty_like(ends)
    starts[:1] = 0
    starts[1:] = ends[:-1] + 1
    return starts, np.minimum(ends - starts, LINE_CHARS_MAX + 1)


def _by_width(widths: IntColumn) -> Iterator[tuple[int, IntColumn]]:
    """Yield every width that lines have (n,), with the indices of these lines."""
    if len(widths) and widths.min() == widths.max():
        yield int(widths[0]), np.arange(len(widths))
        return
    for width in np.flatnonzero(np.bincount(widths)).tolist():
        yield width, np.flatnonzero(widths == width)
