"""Reads frames in separated text with a header line: Vehicle Spy, trace exports of CANalyzer and CANoe."""

from __future__ import annotations

import csv
import re
from collections.abc import Generator

from canest.core.errors import LogError
from canest.core.frames import FrameBlock
from canest.logs.base import SKIPPED_SHOWN, CountingReader
from canest.logs.compression import Source
from canest.logs.frame_table import FrameTable, cells_of
from canest.logs.line_parser import Wanted
from canest.logs.line_splitting import text_lines

#: where int64 microseconds end, with room to spare
_SECONDS_MAX = 9e12


class FrameTableReader(CountingReader):
    """A line for each frame. Lines before the header and further header lines are passed over."""

    format = "csv of frames"

    def __init__(
        self, source: Source, head: bytes, table: FrameTable, wanted: Wanted | None, channel: str | None,
        block_frames: int,
    ) -> None:  # fmt: skip
        super().__init__(source, channel)
        self._head, self._table, self._wanted, self._block_frames = head, table, wanted, block_frames
        self._line = 0
        self._past_header = False

    def _blocks(self) -> Generator[FrameBlock]:
        held: list[tuple[int, int, bytes]] = []
        for line in text_lines(self._source, self._head, self._cut_off):
            self._line += 1
            frame = self._frame(line)
            if frame is not None:
                held.append(frame)
                if len(held) >= self._block_frames:
                    yield self._delivered(held)
                    held = []
        if held:
            yield self._delivered(held)

    def _frame(self, line: str) -> tuple[int, int, bytes] | None:
        """Return the frame of a line, None for one that is not delivered."""
        if not line.strip():
            return None
        try:
            cells = cells_of(line, self._table)
            if self._is_header(cells) or not self._past_header:
                return None
            found = self._table.frame(cells)
        except (ValueError, csv.Error) as error:
            self._skip(self._line, line, str(error))
            return None
        if found is None:
            return None
        seconds, can_id, payload = found
        if not abs(seconds) < _SECONDS_MAX:
            self._skip(self._line, line, "no time")
            return None
        self._frames += 1
        if self._table.channel is not None:
            channel = cells[self._table.channel].strip()
            if channel in self._channels or len(self._channels) < SKIPPED_SHOWN:
                self._channels[channel] = self._channels.get(channel, 0) + 1
            if self._channel not in (None, channel):
                return None
        return round(seconds * 1e6), can_id, payload

    def _is_header(self, cells: list[str]) -> bool:
        """Return whether cells name columns; Vehicle Spy has a header for every kind of network."""
        time = cells[self._table.time].strip().lower() if len(cells) > self._table.time else ""
        if re.match(r"(abs )?time", time):
            self._past_header = True
            return True
        return False

    def _delivered(self, frames: list[tuple[int, int, bytes]]) -> FrameBlock:
        block = FrameBlock.from_frames(frames)
        return block if self._wanted is None else block[self._wanted(block.can_id)]

    def _cut_off(self, line: str) -> None:
        self._line += 1
        self._skip(self._line, line, "cut off by the archive's end")


def refuse_channel_of(table: FrameTable, source: Source, channel: str | None) -> None:
    """Refuse a channel where the file has no column for it. Errors: LogError."""
    if channel is not None and table.channel is None:
        source.close()
        raise LogError(
            "this log names no interfaces",
            where=str(source.path),
            found=f"--channel {channel}",
            expected="none",
        )
