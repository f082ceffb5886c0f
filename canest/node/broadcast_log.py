"""Estimates of a replay as a log of frames: those that a daemon would have sent meanwhile."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from canest.core.errors import UsageError
from canest.core.frames import EXTENDED, FrameBlock
from canest.logs import TableBlock, open_log
from canest.logs.candump_writer import candump_text
from canest.logs.estimate_file import Columns, Decimals, EstimateWriter
from canest.node.broadcast import Broadcaster
from canest.node.estimate_frame import Estimate

if TYPE_CHECKING:
    from canest.config.bus import Broadcast
    from canest.core.estimates import Estimates


class RecordedLog(NamedTuple):
    """A log, and the interface of it that is wanted (None: all)."""

    path: Path
    channel: str | None = None


class BroadcastLogWriter(EstimateWriter):
    """The broadcast of every tick, in the log's clock, from the preferred address; not the address claim.

    The end of the name is the format: .blf, else candump. beside: a log whose own frames come too, as it was
    recorded, each of ours behind those that it was estimated from. Ours are then held back to the end.
    """

    def __init__(self, path: Path, broadcast: Broadcast, beside: RecordedLog | None = None) -> None:
        super().__init__(path)
        self._broadcaster, self._address = Broadcaster(broadcast), broadcast.preferred_address
        self._beside, self._held = beside, [FrameBlock.empty()]
        self._blf = None
        if path.name.lower().endswith(".blf"):
            from canest.logs.blf_writer import BlfFrames  # with python-can, for this format alone

            with self._out.errors():
                self._blf = BlfFrames(self._out.file, path)

    def write(self, estimates: Estimates, more: Columns | None = None) -> None:
        """Append the frames that are due at the next ticks."""
        e = estimates
        columns = (e.mass_kg, e.mass_std_kg, e.grade, e.grade_std, e.status, e.gate)
        frames: list[tuple[int, int, bytes]] = []
        for t_us, *values in zip(e.t_us.tolist(), *(column.tolist() for column in columns), strict=True):
            self._broadcaster.set_estimate(Estimate(*values), t_us)
            if t_us >= self._broadcaster.due_us:
                sent = self._broadcaster.frames(t_us, self._address, frozenset())
                frames += [(t_us, can_id | EXTENDED, payload) for can_id, payload in sent]
        if self._beside is not None:
            self._held.append(FrameBlock.from_frames(frames))
        elif frames:
            self._append(FrameBlock.from_frames(frames))

    def _append(self, frames: FrameBlock) -> None:
        if self._blf is None:
            self._out.write(candump_text(frames))
            return
        with self._out.errors():
            self._blf.write(frames)

    def _finish(self) -> None:
        if self._beside is not None:
            for frames in merged(self._beside, FrameBlock.concatenate(self._held)):
                self._append(frames)
        if self._blf is not None:
            with self._out.errors():
                self._blf.close()


def merged(log: RecordedLog, own: FrameBlock) -> Generator[FrameBlock]:
    """Yield the frames of a log in their order, and each of ``own`` behind all that are not later.

    Errors: LogError; UsageError for a table, which has no frames.
    """
    with closing(open_log(log.path, channel=log.channel)) as reader:
        for block in reader:
            if isinstance(block, TableBlock):
                raise UsageError(
                    "a table of decoded signals has no frames", where="--with-frames", found=str(log.path)
                )
            so_far_us = np.maximum.accumulate(block.t_us)
            count = int(np.searchsorted(own.t_us, so_far_us[-1], "left")) if len(so_far_us) else 0
            places = np.searchsorted(so_far_us, own.t_us[:count], "right")
            yield FrameBlock(
                *(
                    np.insert(getattr(block, name), places, getattr(own, name)[:count])
                    for name in ("t_us", "can_id", "length", "data")
                )
            )
            own = own[count:]
    yield own


def open_broadcast_log(
    broadcast: Broadcast, beside: RecordedLog | None, path: Path, more: Decimals
) -> BroadcastLogWriter:
    """Open the log. Errors: OutputError; UsageError for columns, which frames do not have."""
    if more:
        raise UsageError("a log of frames has no further columns", where="--columns", found=", ".join(more))
    return BroadcastLogWriter(path, broadcast, beside)
