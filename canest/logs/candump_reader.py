"""The reader of candump text: cuts it into whole lines, and joins the parsed frames to blocks."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator, Mapping

from canest.core.frames import FrameBlock
from canest.logs.base import SHOWN_CHARS, LogReader
from canest.logs.candump import CandumpParser
from canest.logs.compression import Source
from canest.logs.line_parser import LINE_CHARS_MAX
from canest.logs.line_splitting import text_parts

#: text parsed at once: fits the second-level cache together with what is made of it
_TEXT_BYTES = 1 << 19
#: a power cut leaves blocks of zeros where nothing had been written yet; the next line begins behind them
_NEVER_WRITTEN = re.compile(rb"(\A|\n)\0+")


class CandumpReader(LogReader):
    """Candump text, either form."""

    format = "candump"

    def __init__(self, source: Source, head: bytes, parser: CandumpParser, block_frames: int) -> None:
        super().__init__(source, parser.channel)
        self._head, self._parser, self._block_frames = head, parser, block_frames
        self._had_zeros = False
        if not head:
            self.kind = "nothing"

    @property
    def frames(self) -> int:
        """Well-formed frames so far, delivered or not."""
        return self._parser.frames

    @property
    def skipped_lines(self) -> int:
        """Lines that should be a frame and are not."""
        return self._parser.skipped_lines

    @property
    def skipped(self) -> list[tuple[int, str, str]]:
        """The first unreadable lines: (number, text, reason)."""
        return self._parser.skipped

    @property
    def channels(self) -> Mapping[str, int]:
        """Frames per interface so far."""
        return self._parser.channels

    def _blocks(self) -> Generator[FrameBlock]:
        blocks: list[FrameBlock] = []
        held = 0
        for block in self._parsed():
            blocks.append(block)
            held += len(block)
            if held >= self._block_frames:
                yield FrameBlock.concatenate(blocks)
                blocks, held = [], 0
        if held:
            yield FrameBlock.concatenate(blocks)

    def _parsed(self) -> Iterator[FrameBlock]:
        head, self._head = self._head, b""
        for kind, text, end in text_parts(
            self._source, head, LINE_CHARS_MAX, _TEXT_BYTES, self._without_zeros
        ):
            if kind == "lines":
                yield self._parser.parse(text, end)
            elif kind == "last":
                yield self._parser.parse(text + b"\n")
            elif kind == "overlong":
                self._parser.skip_line(text[:SHOWN_CHARS], "line too long")
            else:
                self._parser.skip_line(text, "cut off by the end of the archive")
        if self._had_zeros and not self.frames:
            self.truncated_reason = "zeros alone, as a power cut leaves them"

    def _without_zeros(self, text: bytes) -> bytes:
        if b"\0" not in text:
            return text
        self._had_zeros = True
        return _NEVER_WRITTEN.sub(rb"\1", text)
