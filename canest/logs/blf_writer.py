"""Frames as a BLF log, by python-can's writer: for CANalyzer, CANoe, asammdf and others."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO, cast

from canest.core.errors import OutputError
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.logs.candump_line import CLASSIC_BYTES

_CHANNEL = 0  #: the first one, which the file numbers 1
#: 1990-01-01: a clock below it does not count from 1970, and a BLF has no date for it
FIRST_DATE_S = 631_152_000


class BlfFrames:
    """Appends frames to a file that is open for writing. `close` completes it and leaves the file open.

    A clock that counts from the start of a log (below 1990) is kept: the file then has no date.
    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        from canest.system.python_can import can  # heavy

        self._path = path
        self._writer = can.BLFWriter(cast(Any, _KeptOpen(file)), channel=_CHANNEL + 1)

    def write(self, frames: FrameBlock) -> None:
        """Append the next frames.

        Errors: OutputError for one of more than eight bytes (CAN FD), and for one before the file's first.
        """
        from canest.system.python_can import can  # loaded by now

        if len(frames) and self._writer.start_timestamp is None:
            first_s = int(frames.t_us.min()) // 1000 / 1e3  # as the file has it, in ms
            self._writer.start_timestamp = first_s if first_s >= FIRST_DATE_S else 0.0
        for t_us, can_id, length, word in zip(
            frames.t_us.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data.tolist(),
            strict=True,
        ):  # fmt: skip
            if length > CLASSIC_BYTES and not can_id & REMOTE:
                raise OutputError(
                    "a BLF of frames has eight bytes each", where=str(self._path),
                    found=f"a frame of {length} bytes (CAN FD)", expected="a name that ends in .log",
                )  # fmt: skip
            if t_us / 1e6 < self._writer.start_timestamp:
                raise OutputError(
                    "the clock was set back to before the first frame, and a BLF holds no such time",
                    where=str(self._path), expected="a name that ends in .log",
                )  # fmt: skip
            message = can.Message(
                timestamp=t_us / 1e6, arbitration_id=can_id & ID_MASK, channel=_CHANNEL,
                is_extended_id=bool(can_id & EXTENDED), is_remote_frame=bool(can_id & REMOTE),
                is_error_frame=bool(can_id & ERROR), dlc=length,
                data=None if can_id & REMOTE else word.to_bytes(8, "little")[:length],
            )  # fmt: skip
            self._writer.on_message_received(message)

    def close(self) -> None:
        """Complete the file."""
        self._writer.stop()


class _KeptOpen:
    """A file that its writer may not close: who opened it does."""

    closed = False

    def __init__(self, file: BinaryIO) -> None:
        self.write, self.flush = file.write, file.flush
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def close(self) -> None:
        self.closed = True
