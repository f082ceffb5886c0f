"""Estimates of a replay as a candump log: the frames that a daemon would have sent meanwhile."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canest.core.errors import UsageError
from canest.core.frames import EXTENDED, FrameBlock
from canest.logs.candump_writer import candump_text
from canest.logs.estimate_file import Columns, Decimals, EstimateWriter
from canest.node.broadcast import Broadcaster
from canest.node.estimate_frame import Estimate

if TYPE_CHECKING:
    from canest.config.bus import Broadcast
    from canest.core.estimates import Estimates


class BroadcastLogWriter(EstimateWriter):
    """The broadcast of every tick, in the log's clock, from the preferred address; not the address claim."""

    def __init__(self, path: Path, broadcast: Broadcast) -> None:
        super().__init__(path)
        self._broadcaster, self._address = Broadcaster(broadcast), broadcast.preferred_address

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
        if frames:
            self._out.write(candump_text(FrameBlock.from_frames(frames)))


def open_broadcast_log(broadcast: Broadcast, path: Path, more: Decimals) -> BroadcastLogWriter:
    """Open the log. Errors: OutputError; UsageError for columns, which frames do not have."""
    if more:
        raise UsageError("a log of frames has no further columns", where="--columns", found=", ".join(more))
    return BroadcastLogWriter(path, broadcast)
