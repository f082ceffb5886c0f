"""Frames as the columns of a file, and several streams of them merged by time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FloatColumn, IntColumn

#: of a payload of 0 to 8 bytes
_BYTES_MASK = np.array([(1 << (8 * count)) - 1 for count in range(9)], np.uint64)


@dataclass(frozen=True, slots=True)
class FrameColumns:
    """Frames of one format, n of them.

    t_s: float64 (n,), seconds. can_id: uint32 (n,) with the flags of `FrameBlock`. length: int64 (n,).
    data: uint64 (n,), the first eight payload bytes, unused ones zero.
    channel: int64 (n,), number of the interface; None where the format names none.
    """

    t_s: FloatColumn
    can_id: NDArray[np.uint32]
    length: IntColumn
    data: NDArray[np.uint64]
    channel: IntColumn | None

    def __len__(self) -> int:
        return len(self.t_s)

    def __getitem__(self, index: slice | BoolColumn | IntColumn) -> FrameColumns:
        channel = None if self.channel is None else self.channel[index]
        return FrameColumns(
            self.t_s[index], self.can_id[index], self.length[index], self.data[index], channel
        )


def payload_words(data: NDArray[np.uint64], length: IntColumn) -> NDArray[np.uint64]:
    """Return eight bytes (n,) with those beyond the length (n,) set to zero."""
    masked: NDArray[np.uint64] = data & _BYTES_MASK[np.clip(length, 0, 8)]
    return masked


class HeldFrames:
    """Frames of one stream that wait to be merged with others by time.

    Frames are ranked by the latest stamp up to each: what stands behind a later stamp stays behind it.
    """

    def __init__(self) -> None:
        self.latest_s = -np.inf
        self._held: list[FrameColumns] = []
        self._ranks: list[FloatColumn] = []

    def __len__(self) -> int:
        return sum(map(len, self._held))

    def add(self, block: FrameColumns) -> None:
        """Append the next frames."""
        if len(block):
            rank = np.maximum(np.maximum.accumulate(block.t_s), self.latest_s)
            self.latest_s = float(rank[-1])
            self._held.append(block)
            self._ranks.append(rank)

    def take(self, limit_s: float) -> tuple[FrameColumns, FloatColumn] | None:
        """Remove and return the frames before ``limit_s`` with their ranks, None where there are none."""
        if not self._held:
            return None
        block, rank = joined(self._held), np.concatenate(self._ranks)
        count = int(np.searchsorted(rank, limit_s)) if limit_s < np.inf else len(rank)
        self._held = [block[count:]] if count < len(rank) else []
        self._ranks = [rank[count:]] if count < len(rank) else []
        return (block[:count], rank[:count]) if count else None


def take_merged(streams: Iterable[HeldFrames], limit_s: float) -> FrameColumns | None:
    """Remove the frames before ``limit_s`` from all streams, and return them in the order of their ranks.

    Of equal ranks the earlier stream's come first, as `heapq.merge` has it.
    """
    parts = [part for stream in streams if (part := stream.take(limit_s)) is not None]
    if not parts:
        return None
    order = np.argsort(np.concatenate([rank for _, rank in parts]), kind="stable")
    return joined([block for block, _ in parts])[order]


def merged(streams: list[Iterator[FrameColumns]]) -> Iterator[FrameColumns]:
    """Merge streams by time, a block of each at a time."""
    if len(streams) == 1:
        yield from streams[0]
        return
    held = [HeldFrames() for _ in streams]
    ended = [False] * len(streams)
    while not all(ended):
        limit_s = min(frames.latest_s for frames, end in zip(held, ended, strict=True) if not end)
        block = take_merged(held, limit_s)
        if block is not None:
            yield block
        for index, stream in enumerate(streams):
            if not ended[index] and held[index].latest_s <= limit_s:
                more = next(stream, None)
                ended[index] = more is None
                if more is not None:
                    held[index].add(more)
    block = take_merged(held, np.inf)
    if block is not None:
        yield block


def joined(blocks: list[FrameColumns]) -> FrameColumns:
    """Join blocks in order; -1 is the interface of those that have none."""
    if len(blocks) == 1:
        return blocks[0]
    channels = [np.full(len(b), NO_CHANNEL) if b.channel is None else b.channel for b in blocks]
    return FrameColumns(
        np.concatenate([b.t_s for b in blocks]),
        np.concatenate([b.can_id for b in blocks]),
        np.concatenate([b.length for b in blocks]),
        np.concatenate([b.data for b in blocks]),
        np.concatenate(channels),
    )


NO_CHANNEL = -(1 << 62)  #: the interface of a frame whose format names none
