"""Candump text to frame blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.frames import BoolColumn, FrameBlock, IntColumn
from canest.logs.base import SHOWN_CHARS, SKIPPED_SHOWN
from canest.logs.candump_layout import Layout
from canest.logs.candump_line import Line, is_ignorable, parse_line
from canest.logs.line_parser import LINE_CHARS_MAX, LineParser, Piece, Wanted


class CandumpParser(LineParser):
    """Parses whole lines of candump text, counts what it could not read."""

    def __init__(self, wanted: Wanted | None = None, channel: str | None = None) -> None:
        super().__init__(wanted, channel)
        self.ignored_lines = 0  #: blank lines and details of error frames
        self.skipped_lines = 0  #: lines that should be a frame and are not
        self.skipped: list[tuple[int, str, str]] = []  #: the first of them: (line number, text, reason)

    def skip_line(self, text: bytes, reason: str) -> None:
        """Count a line that is not even worth parsing."""
        self.lines += 1
        self._skip(self.lines, text, reason)

    def _learn(self, line: bytes) -> Layout | None:
        parsed = parse_line(line)
        return Layout.learn(line, parsed) if isinstance(parsed, Line) else None

    def _parse_rows(
        self, layout: Layout, chars: NDArray[np.uint8], starts: IntColumn, width: int
    ) -> tuple[FrameBlock, BoolColumn]:
        if jit.enabled():
            from canest.logs import candump_kernel

            return candump_kernel.parse(layout, chars, starts)
        return super()._parse_rows(layout, chars, starts, width)

    def _parse_odd(self, text: bytes, starts: IntColumn, widths: IntColumn, odd: IntColumn) -> list[Piece]:
        lines: list[tuple[int, Line]] = []
        for index in odd.tolist():
            start, width = int(starts[index]), int(widths[index])
            shown = text[start : start + width]
            line = parse_line(shown) if width <= LINE_CHARS_MAX else "line too long"
            if isinstance(line, Line):
                if self._count(line.channel, 1):
                    lines.append((index, line))
            elif is_ignorable(shown):
                self.ignored_lines += 1
            else:
                self._skip(self.lines + index + 1, shown, line)
        if not lines:
            return []
        frames = FrameBlock(
            np.array([line.t_us for _, line in lines], np.int64),
            np.array([line.can_id for _, line in lines], np.uint32),
            np.array([line.length for _, line in lines], np.uint8),
            np.array([line.data for _, line in lines], np.uint64),
        )
        return [(np.array([index for index, _ in lines], np.int64), frames)]

    def _skip(self, number: int, text: bytes, reason: str) -> None:
        self.skipped_lines += 1
        if len(self.skipped) < SKIPPED_SHOWN:
            shown = text[:SHOWN_CHARS].decode("ascii", "backslashreplace")
            self.skipped.append((number, shown, reason))
