"""Estimates of a replay as a log of frames: those that a daemon would have sent meanwhile."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from canest.core.errors import UsageError
from canest.core.frames import EXTENDED, FrameBlock, IntColumn, MonotonicClock
from canest.core.samples import STEP_US
from canest.logs import TableBlock, open_log
from canest.logs.candump_writer import candump_text
from canest.logs.estimate_file import Columns, Decimals, EstimateWriter
from canest.node.broadcast import Broadcaster
from canest.node.estimate_frame import Estimate

if TYPE_CHECKING:
    from canest.config.bus import Broadcast
    from canest.core.estimates import Estimates


#: where a clock is set back, the ticks around it differ by so much from the frames at most
_TICKS_US = 2 * STEP_US


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
        self._monotonic = MonotonicClock()  # a frame is due also where the log's clock was set back
        self._beside, self._held = beside, [FrameBlock.empty()]
        #: when each was due, as time goes on where the log's clock was set back
        self._held_us: list[int] = []
        self._set_back_us: list[int] = []
        self._ahead_us = 0
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
        passed_us = self._monotonic(e.t_us)
        self._note_set_backs(passed_us - e.t_us)
        for t_us, now_us, *values in zip(
            e.t_us.tolist(), passed_us.tolist(), *(column.tolist() for column in columns), strict=True
        ):
            self._broadcaster.set_estimate(Estimate(*values), now_us)
            if now_us >= self._broadcaster.due_us:
                sent = self._broadcaster.frames(now_us, self._address, frozenset())
                frames += [(t_us, can_id | EXTENDED, payload) for can_id, payload in sent]
                self._held_us += [now_us] * len(sent) if self._beside is not None else []
        if self._beside is not None:
            self._held.append(FrameBlock.from_frames(frames))
        elif frames:
            self._append(FrameBlock.from_frames(frames))

    def _note_set_backs(self, ahead_us: IntColumn) -> None:
        """Keep by how much the clock was set back. ahead_us: what time is ahead of it (n,)."""
        if len(ahead_us):
            steps_us = np.diff(ahead_us, prepend=self._ahead_us)
            self._set_back_us += steps_us[steps_us > 0].tolist()
            self._ahead_us = int(ahead_us[-1])

    def _append(self, frames: FrameBlock) -> None:
        if self._blf is None:
            self._out.write(candump_text(frames))
            return
        with self._out.errors():
            self._blf.write(frames)

    def _finish(self) -> None:
        if self._beside is not None:
            clock, due_us = _LogClock(self._set_back_us), np.array(self._held_us, np.int64)
            for frames in _merged(self._beside, clock, FrameBlock.concatenate(self._held), due_us):
                self._append(frames)
        if self._blf is not None:
            with self._out.errors():
                self._blf.close()


def _merged(log: RecordedLog, clock: _LogClock, own: FrameBlock, due_us: IntColumn) -> Generator[FrameBlock]:
    """Yield the frames of a log in their order, and each of ``own`` behind all that are not later.

    due_us: when these were due (n,), by ``clock``.
    Errors: LogError; UsageError for a table, which has no frames.
    """
    with closing(open_log(log.path, channel=log.channel)) as reader:
        for block in reader:
            if isinstance(block, TableBlock):
                raise UsageError(
                    "a table of decoded signals has no frames", where="--with-frames", found=str(log.path)
                )
            so_far_us = np.maximum.accumulate(clock.passed_us(block.t_us))
            count = int(np.searchsorted(due_us, so_far_us[-1], "left")) if len(so_far_us) else 0
            places = np.searchsorted(so_far_us, due_us[:count], "right")
            yield FrameBlock(
                *(
                    np.insert(getattr(block, name), places, getattr(own, name)[:count])
                    for name in ("t_us", "can_id", "length", "data")
                )
            )
            own, due_us = own[count:], due_us[count:]
    yield own


class _LogClock:
    """Time of a log that goes on where its clock was set back, by as much as that of our ticks was.

    set_back_us: by how much they go back. A stamp that goes back where they do not is an order of arrival.
    """

    def __init__(self, set_back_us: Sequence[int]) -> None:
        self._set_back_us = deque(set_back_us)  #: those that are still to come
        self._last_us: int | None = None
        self._ahead_us = 0

    def passed_us(self, t_us: IntColumn) -> IntColumn:
        """Return the next stamps (n,) in this time."""
        if not len(t_us):
            return t_us
        ahead_us = np.zeros(len(t_us), np.int64)
        back_us = -np.diff(t_us, prepend=t_us[0] if self._last_us is None else self._last_us)
        for at in np.flatnonzero(back_us > 0).tolist():
            if self._set_back_us and abs(self._set_back_us[0] - int(back_us[at])) <= _TICKS_US:
                ahead_us[at] = self._set_back_us.popleft()
        ahead_us = self._ahead_us + ahead_us.cumsum()
        self._last_us, self._ahead_us = int(t_us[-1]), int(ahead_us[-1])
        return np.asarray(t_us + ahead_us)


def open_broadcast_log(
    broadcast: Broadcast, beside: RecordedLog | None, path: Path, more: Decimals
) -> BroadcastLogWriter:
    """Open the log. Errors: OutputError; UsageError for columns, which frames do not have."""
    if more:
        raise UsageError("a log of frames has no further columns", where="--columns", found=", ".join(more))
    return BroadcastLogWriter(path, broadcast, beside)
