"""Frames as a candump log, streamed. The file appears under its name only when it is complete."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import TracebackType

import numpy as np

from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.logs import text_fields as text
from canest.logs.candump_line import CLASSIC_BYTES
from canest.logs.growing_result import GrowingResult

_FRAMES_AT_ONCE = 1 << 13


class CandumpWriter:
    """A candump log (its log form); use as a context manager, as `EstimateWriter`."""

    def __init__(self, path: str | Path, channel: str = "can0") -> None:
        self._out = GrowingResult(Path(path))
        self._channel = channel

    def write(self, frames: FrameBlock) -> None:
        """Append the next frames."""
        for first in range(0, len(frames), _FRAMES_AT_ONCE):
            self._out.write(candump_text(frames[first : first + _FRAMES_AT_ONCE], self._channel))

    def __enter__(self) -> CandumpWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._out.commit()
        else:
            self._out.discard()


def candump_text(frames: FrameBlock, channel: str = "can0") -> bytes:
    """Return frames as candump lines: its log form, and its screen form for CAN FD beyond eight bytes.

    A block holds eight bytes of a frame, and no others are made up: the screen form announces the length
    as sent, and reads back as the same frame.
    """
    long = (frames.length > CLASSIC_BYTES) & ((frames.can_id & np.uint32(REMOTE)) == 0)
    if not long.any():
        return _log_form(frames, channel)
    edges = [0, *(np.flatnonzero(long[1:] != long[:-1]) + 1).tolist(), len(frames)]
    return b"".join(
        (_screen_form if long[first] else _log_form)(frames[first:end], channel)
        for first, end in pairwise(edges)
    )


def _screen_form(frames: FrameBlock, channel: str) -> bytes:
    """Return CAN FD frames with the first eight of their bytes."""
    columns = (frames.t_us, frames.can_id, frames.length, frames.data)
    lines = []
    for t_us, can_id, length, word in zip(*(column.tolist() for column in columns), strict=True):
        number = f"{can_id & ID_MASK:08X}" if can_id & EXTENDED else f"{can_id & ID_MASK:03X}"
        payload = word.to_bytes(CLASSIC_BYTES, "little").hex(" ").upper()
        seconds, micros = divmod(t_us, 1_000_000)
        lines.append(f"({seconds:010d}.{micros:06d})  {channel}  {number}  [{length}]  {payload}\n")
    return "".join(lines).encode()


def _log_form(frames: FrameBlock, channel: str) -> bytes:
    count = len(frames)
    t_us = frames.t_us
    whole = t_us // 1_000_000
    error = (frames.can_id & np.uint32(ERROR)) != 0
    standard = (frames.can_id & np.uint32(EXTENDED | ERROR)) == 0
    remote = (frames.can_id & np.uint32(REMOTE)) != 0
    number = (frames.can_id & np.uint32(ID_MASK)) | np.where(error, np.uint32(ERROR), np.uint32(0))
    identifier = text.hexadecimal(number.astype(">u4").view(np.uint8).reshape(count, 4)).copy()
    identifier[:, :5][standard] = 0
    payload = text.hexadecimal(frames.data.astype("<u8").view(np.uint8).reshape(count, 8)).copy()
    unsent = np.arange(16) >= 2 * frames.length[:, None]
    payload[unsent | remote[:, None]] = 0
    request = text.blank_where(text.constant(b"R", count), ~remote)
    announced = text.digits(frames.length.astype(np.int64), 1)
    return text.join(
        [
            text.constant(b"(", count),
            text.integer(whole, 10),
            text.constant(b".", count),
            text.digits(t_us - whole * 1_000_000, 6),
            text.constant(f") {channel} ".encode(), count),
            identifier,
            text.constant(b"#", count),
            payload,
            request,
            text.blank_where(announced, ~remote),
            text.constant(b"\n", count),
        ]
    )
