""".asc logs, whose common lines are parsed in columns; python-can reads the others, one at a time."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FrameBlock, IntColumn
from canest.logs.asc_layout import AscLayout
from canest.logs.candump_layout import Layout
from canest.logs.compression import Source
from canest.logs.line_parser import LineParser, Piece, Wanted
from canest.logs.line_splitting import LINE_CHARS_MAX, text_parts
from canest.logs.python_can import PythonCanReader
from canest.logs.python_can_lines import OneLine, asc_base, in_plain_words

#: text parsed at once: fits the second-level cache together with what is made of it
_TEXT_BYTES = 1 << 19
_RELATIVE = re.compile(rb"(?im)^\s*base\s+\S+\s+timestamps\s+relative")
#: what python-can reads in front of the one line
_HEADER = "base hex  timestamps absolute\nno internal events logged\n"

Frame = tuple[int, int, int, int]  #: stamp in microseconds, identifier with flags, length, data


class AscReader(PythonCanReader):
    """An .asc log; numbers in base 10, and headers that python-can ends in its own way, are left to it."""

    def __init__(
        self,
        source: Source,
        head: bytes,
        suffix: str,
        wanted: Wanted | None,
        channel: str | None,
        block_frames: int,
    ) -> None:
        super().__init__(source, head, suffix, wanted, channel, block_frames)
        self._parser = _AscParser(wanted, channel, self._odd_line)

    @property
    def frames(self) -> int:
        """Frames so far, delivered or not."""
        return self._frames + self._parser.frames

    @property
    def channels(self) -> Mapping[str, int]:
        """Frames per interface so far, as the format names them."""
        counted = dict(self._parser.channels)
        for name, frames in self._channels.items():
            counted[name] = counted.get(name, 0) + frames
        return counted

    def _blocks(self) -> Generator[FrameBlock]:
        if _RELATIVE.search(self._head):
            raise LogError(
                "gives the time from each event to the next",
                where=str(self.path),
                found="timestamps relative",
                expected="an export with `timestamps absolute`",
            )
        if asc_base(self._head.decode("utf-8", "replace")) != "hex":
            yield from super()._blocks()
            return
        held: list[FrameBlock] = []
        for block in self._parsed():
            held.append(block)
            if sum(map(len, held)) >= self._block_frames:
                yield FrameBlock.concatenate(held)
                held = []
        if held:
            yield FrameBlock.concatenate(held)

    def _parsed(self) -> Iterator[FrameBlock]:
        for kind, text, end in text_parts(self._source, self._head, LINE_CHARS_MAX, _TEXT_BYTES):
            if kind == "lines":
                yield self._parser.parse(text, end)
            elif kind == "cut off":
                self._skip_line(self._parser.lines + 1, _decoded(text).strip())
            else:
                yield self._parser.parse(text + b"\n")

    def _odd_line(self, number: int, text: bytes) -> Frame | None:
        """Return the frame of a line as python-can reads it; count one that should hold a frame."""
        self._lines = line = OneLine(number, _decoded(text))
        if not line.looks_like_a_frame:
            if not line.holds_no_frame:
                self._skip_line(number, line.current.strip())
            return None
        from canest.system.python_can import can  # wanted for odd lines only

        try:
            message: Any = next(iter(can.ASCReader(io.StringIO(f"{_HEADER}{line.current}\n"))), None)
        except MemoryError:
            raise
        except Exception as error:  # whatever a damaged line makes of it
            self._skip(number, line.current.strip(), in_plain_words(error))
            return None
        if message is None:
            if not line.holds_no_frame:
                self._skip_line(number, line.current.strip())
            return None
        return self._frame(message)


class _AscParser(LineParser):
    """Parses the lines of an .asc log. odd_line: number and text of a line without layout -> its frame."""

    def __init__(
        self, wanted: Wanted | None, channel: str | None, odd_line: Callable[[int, bytes], Frame | None]
    ) -> None:
        super().__init__(wanted, channel)
        self._odd_line = odd_line

    def _learn(self, line: bytes) -> Layout | None:
        return AscLayout.learn_line(line)

    def _parse_odd(self, text: bytes, starts: IntColumn, widths: IntColumn, odd: IntColumn) -> list[Piece]:
        places: list[int] = []
        frames: list[Frame] = []
        for index in odd.tolist():
            start = int(starts[index])
            end = text.index(b"\n", start)
            frame = self._odd_line(self.lines + index + 1, text[start:end])
            if frame is not None:
                places.append(index)
                frames.append(frame)
        if not frames:
            return []
        t_us, can_id, length, data = zip(*frames, strict=True)
        block = FrameBlock(
            np.array(t_us, np.int64),
            np.array(can_id, np.uint32),
            np.array(length, np.uint8),
            np.array(data, np.uint64),
        )
        return [(np.array(places, np.int64), block)]


def _decoded(text: bytes) -> str:
    return text.decode("utf-8", "replace").replace("\r", "")
