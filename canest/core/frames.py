"""The input of the pipeline: a block of CAN frames as numpy columns.

A block may hold one frame or a million; every stage gives the same result however a stream is cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from canest.core.errors import UsageError

EXTENDED = 0x8000_0000  #: flag in `can_id`: 29-bit identifier (as in Linux' struct can_frame)
REMOTE = 0x4000_0000  #: flag in `can_id`: remote transmission request
ERROR = 0x2000_0000  #: flag in `can_id`: error frame
ID_MASK = 0x1FFF_FFFF  #: the 29 identifier bits
_STANDARD_MAX = 0x7FF
_MOST_BYTES = 64  #: of CAN FD

IntColumn = NDArray[np.int64]
FloatColumn = NDArray[np.float64]
BoolColumn = NDArray[np.bool_]


#: a clock that was set back more often than this is two clocks
SET_BACKS_MOST = 200


class MonotonicClock:
    """Makes stamps that never go back, block by block: where the clock was set back, time goes on.

    disorder_us: a stamp that goes back by no more is one of an order of arrival, and stays. What goes back
    more often than `SET_BACKS_MOST` comes from two clocks in turn, and stays too.
    """

    def __init__(self, disorder_us: int = 0) -> None:
        self._disorder_us, self._set_backs = disorder_us, 0
        self._last_us: int | None = None
        self._ahead_us = 0  # of the clock

    @property
    def is_two_clocks(self) -> bool:
        """Return whether stamps went back so often that they are those of two clocks."""
        return self._set_backs >= SET_BACKS_MOST

    def __call__(self, t_us: IntColumn) -> IntColumn:
        """Return the next stamps, int64 (n,), ahead of the clock by as much as it was set back so far.

        They may be the array that was given.
        """
        if not len(t_us):
            return t_us
        before = np.empty_like(t_us)
        before[0], before[1:] = t_us[0] if self._last_us is None else self._last_us, t_us[:-1]
        back = before - t_us
        set_back = back > self._disorder_us
        self._last_us = int(t_us[-1])
        if not set_back.any():  # as nearly always
            return t_us + self._ahead_us if self._ahead_us else t_us
        if self._disorder_us:
            set_back &= self._set_backs + set_back.cumsum() <= SET_BACKS_MOST
            self._set_backs += int(np.count_nonzero(set_back))
        ahead = self._ahead_us + np.where(set_back, back, 0).cumsum()
        self._ahead_us = int(ahead[-1])
        return np.asarray(t_us + ahead)


@dataclass(frozen=True, slots=True, eq=False)
class FrameBlock:
    """Frames in order of arrival.

    Attributes:
        t_us: int64 (n,), event time in integer microseconds of the log's or the kernel's clock.
        can_id: uint32 (n,), identifier with the flags of Linux' can_frame: 0x80000000 for 29 bits
            (`EXTENDED`), 0x40000000 for a remote request (`REMOTE`), 0x20000000 for an error (`ERROR`).
        length: uint8 (n,), payload bytes as sent (0..8; up to 64 for CAN FD).
        data: uint64 (n,), the first eight payload bytes, first byte least significant, unused bytes zero.
    """

    t_us: IntColumn
    can_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    data: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.t_us)

    def __getitem__(self, index: slice | NDArray[np.bool_] | IntColumn) -> FrameBlock:
        """Return the selected frames (a slice, a mask or an index array)."""
        return FrameBlock(self.t_us[index], self.can_id[index], self.length[index], self.data[index])

    @staticmethod
    def empty() -> FrameBlock:
        """Return a block without frames."""
        return FrameBlock(
            np.empty(0, np.int64), np.empty(0, np.uint32), np.empty(0, np.uint8), np.empty(0, np.uint64)
        )

    @staticmethod
    def from_frames(frames: list[tuple[int, int, bytes]]) -> FrameBlock:
        """Build a block from ``(t_us, can_id with flags, payload)`` tuples (tests, small sources)."""
        return FrameBlock(
            np.array([f[0] for f in frames], np.int64),
            np.array([f[1] for f in frames], np.uint32),
            np.array([len(f[2]) for f in frames], np.uint8),
            np.array([int.from_bytes(f[2][:8], "little") for f in frames], np.uint64),
        )

    @staticmethod
    def from_messages(messages: Iterable[Any]) -> FrameBlock:
        """Build a block from python-can messages (``can.Message``), in order of arrival.

        messages: each with ``timestamp`` (s), ``arbitration_id``, ``data``, ``is_extended_id``,
        ``is_remote_frame`` and ``is_error_frame``; of CAN FD the first eight bytes are kept.

        Errors: UsageError for what are no messages.

        Example:
            >>> import can, canest
            >>> message = can.Message(timestamp=1.5, arbitration_id=0x0CF00400, data=bytes(8))
            >>> canest.FrameBlock.from_messages([message]).t_us.tolist()
            [1500000]
        """
        try:
            return FrameBlock.from_frames([frame_of(message) for message in messages])
        except (TypeError, AttributeError):
            found, expected = type(messages).__name__, "a list of can.Message"
            raise UsageError("no messages", where="from_messages", found=found, expected=expected) from None

    @staticmethod
    def from_arrays(
        t_s: ArrayLike,
        can_id: ArrayLike,
        data: Sequence[bytes] | NDArray[np.uint8],
        *,
        extended: ArrayLike | None = None,
    ) -> FrameBlock:
        """Build a block from columns, in order of arrival.

        t_s: (n,), seconds. can_id: (n,), identifiers without flags. data: n payloads of at most 64 bytes,
        or uint8 (n, length). extended: one truth value, or (n,): whether an identifier has 29 bits; by
        default those above 0x7FF do.

        Errors: UsageError for columns of different lengths, text, too long a payload, or a number that is no
        identifier or time.

        Example:
            >>> import canest
            >>> block = canest.FrameBlock.from_arrays([0.0, 0.01], [0x0CF00400, 0x100], [bytes(8), b"ab"])
            >>> len(block), block.length.tolist()
            (2, [8, 2])
        """
        try:
            seconds, numbers = np.asarray(t_s, np.float64), np.asarray(can_id, np.int64)
            payloads = [bytes(payload) for payload in data]
        except (TypeError, ValueError, OverflowError) as error:
            expected = "seconds, whole numbers and bytes"
            raise UsageError("no columns of frames", found=str(error), expected=expected) from None
        if not seconds.ndim == numbers.ndim == 1 or not len(seconds) == len(numbers) == len(payloads):
            raise UsageError(
                "columns of frames do not fit together",
                found=f"shapes {seconds.shape}, {numbers.shape} and {len(payloads)} payloads",
                expected="one length",
            )
        if max(map(len, payloads), default=0) > _MOST_BYTES:
            raise UsageError("data of a frame is too long", expected=f"at most {_MOST_BYTES} bytes")
        if not np.isfinite(seconds).all():
            raise UsageError("t_s of a frame is no number", expected="seconds")
        if ((numbers < 0) | (numbers > ID_MASK)).any():
            raise UsageError("can_id of a frame is no identifier", expected=f"0 to 0x{ID_MASK:X}")
        long = numbers > _STANDARD_MAX if extended is None else np.asarray(extended, np.bool_)
        return FrameBlock(
            np.rint(seconds * 1e6).astype(np.int64),
            np.where(long, numbers | EXTENDED, numbers).astype(np.uint32),
            np.array([len(p) for p in payloads], np.uint8),
            np.array([int.from_bytes(p[:8], "little") for p in payloads], np.uint64),
        )

    @staticmethod
    def concatenate(blocks: list[FrameBlock]) -> FrameBlock:
        """Join blocks in order."""
        if not blocks:
            return FrameBlock.empty()
        return FrameBlock(
            np.concatenate([b.t_us for b in blocks]),
            np.concatenate([b.can_id for b in blocks]),
            np.concatenate([b.length for b in blocks]),
            np.concatenate([b.data for b in blocks]),
        )


def frame_of(message: Any) -> tuple[int, int, bytes]:
    """Return (stamp in microseconds, identifier with flags, payload) of a python-can message."""
    can_id = message.arbitration_id & ID_MASK
    if message.is_extended_id:
        can_id |= EXTENDED
    if message.is_remote_frame:
        can_id |= REMOTE
    if message.is_error_frame:
        can_id = can_id & ~EXTENDED | ERROR
    payload = b"" if message.is_remote_frame else bytes(message.data)
    return round(message.timestamp * 1e6), can_id, payload


class RoleSamples(NamedTuple):
    """Decoded samples of one stretch of the stream, per role of the signal map.

    samples: role -> (t_us int64 (n,), value float64 (n,)), in order of arrival; NaN where the sender
    sent "not available" or "error". Values are in the role's unit (see `canest.core.roles`).
    end_us: stamp of the last frame of the stretch that the signal map wanted, None when there was none.
    """

    samples: dict[str, tuple[IntColumn, FloatColumn]]
    end_us: int | None
