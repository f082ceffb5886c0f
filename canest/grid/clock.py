"""Event time: cuts the stream of wanted frames where its clock jumps.

Nothing here looks at a wall clock. A stamp that goes back a little (two channels interleaved, a
reordered pair) is clamped and counted; one that goes back further, or a silence longer than the grid
holds, starts a new stretch of time. Where that happens again and again two clocks are interleaved: one is
then followed, and frames of the other are left out, since stretches of one frame give no samples. Where one
silence follows another with a few frames in between, again and again, the stamps are hardly in seconds: such
frames are left out then, since their ticks would take hours and give nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from canest.core.frames import EXTENDED, SET_BACKS_MOST, BoolColumn, FrameBlock, IntColumn

#: so many frames of the other one in a row, and it is followed
_OTHER_IN_A_ROW = 100
#: a stretch of fewer frames is a scrap
_SCRAP = 10
#: so many scraps more than frames in other stretches, and they are left out
_SCRAPS_TAKEN = 200


class Stretch(NamedTuple):
    """Frames whose stamps never decrease. ``jump``: how it follows what came before."""

    frames: FrameBlock
    #: "" continues; "gap" after a silence; "back" when the clock was set back
    jump: str
    #: stamp of the last frame before the jump, None at the start of the stream
    before_us: int | None = None


class Clock:
    """Splits blocks into monotone stretches; carries the last stamp; counts what it had to correct."""

    def __init__(self, hold_us: int, max_backward_us: int) -> None:
        self.hold_us, self._max_backward_us = hold_us, max_backward_us
        self.first_us: int | None = None
        self.last_us: int | None = None  #: of what was not left out
        self.stamps = 0  #: seen so far
        self.counters = {"reordered": 0, "gaps": 0, "clock_set_back": 0}
        self.most_set_back_us = 0  #: of these, by how much at most
        self.of_another_clock = 0  #: frames left out
        self.in_scraps = 0  #: frames of stretches that are too short to give anything
        self.scraps_left_out = 0  #: frames of them
        self.decreasing = 0  #: stamps before the one that precedes them
        self.other_addresses: set[int] = set()  #: who sent the frames of another clock, where they are J1939
        self._others = 0  #: of them since the last frame of the one that is followed
        self._seen_us = 0  #: the newest stamp that was followed, also where it was left out
        self._run = 0  #: frames since the last jump
        self._scraps = 0  #: more than frames in other stretches
        self._skips = False  #: leaves out what may be a scrap

    def split(self, frames: FrameBlock) -> Iterator[Stretch]:
        """Yield the stretches of a block (in order)."""
        if not len(frames):
            return
        self.stamps += len(frames)
        t_us = frames.t_us
        first = self.last_us is None
        if first:
            self.first_us = int(t_us[0])
        step = 0 if first else int(t_us[0]) - self._seen_us
        steps = t_us[1:] - t_us[:-1]
        jumps = min(step, steps.min(initial=0)) < 0 or max(step, steps.max(initial=0)) > self.hold_us
        if jumps or self._skips:
            yield from self._split_slowly(frames)
            return
        self.last_us = self._seen_us = int(t_us[-1])
        self._others, self._run = 0, self._run + len(frames)
        yield Stretch(frames, "gap" if first else "")

    def _split_slowly(self, frames: FrameBlock) -> Iterator[Stretch]:
        """Walk a block that holds a jump: frame by frame, since every clamp moves the reference."""
        t_us, kept = frames.t_us.copy(), np.ones(len(frames), np.bool_)
        self._note_decreasing(frames.t_us)
        begin, jump, before = 0, "gap" if self.last_us is None else "", None
        last, others = int(t_us[0]) if self.last_us is None else self._seen_us, []
        for i, stamp in enumerate(frames.t_us.tolist()):
            step = stamp - last
            if step < -self._max_backward_us or step > self.hold_us:
                self._others += 1
                if self.counters["clock_set_back"] >= SET_BACKS_MOST and self._others <= _OTHER_IN_A_ROW:
                    kept[i] = False
                    others.append(i)
                    continue
                if kept[begin:i].any():
                    yield Stretch(self._part(frames, t_us, kept, slice(begin, i)), jump, before)
                begin, jump, before = i, "back" if step < 0 else "gap", self.last_us
                self.counters["clock_set_back" if step < 0 else "gaps"] += 1
                self.most_set_back_us = max(self.most_set_back_us, -step)
                self._begin_run(after_gap=step > 0)
                last = stamp
            elif step < 0:
                self.counters["reordered"] += 1
                t_us[i] = last
            else:
                last = stamp
            self._others, self._seen_us = 0, last
            if self._skips:
                kept[i], self._skips = self._run >= _SCRAP, self._run < _SCRAP
                if kept[i]:
                    begin, jump, before = i, "gap", self.last_us
            self._run += 1
            if kept[i]:
                self.last_us = last
        self._count_left_out(frames, kept, others)
        if kept[begin:].any():
            yield Stretch(self._part(frames, t_us, kept, slice(begin, None)), jump, before)

    def _begin_run(self, after_gap: bool) -> None:
        """Begin a stretch; count the one before as a scrap, or its frames against those."""
        if self._run >= _SCRAP or not after_gap:
            self._scraps = max(0, self._scraps - max(_SCRAP, self._run))
        else:
            self.in_scraps += self._run
            self._scraps = min(_SCRAPS_TAKEN, self._scraps + 1)
        self._run, self._skips = 0, self._scraps == _SCRAPS_TAKEN

    def _note_decreasing(self, t_us: IntColumn) -> None:
        self.decreasing += int(np.count_nonzero(t_us[1:] < t_us[:-1]))
        if self.last_us is not None:
            self.decreasing += bool(t_us[0] < self._seen_us)

    def _count_left_out(self, frames: FrameBlock, kept: BoolColumn, others: list[int]) -> None:
        self.of_another_clock += len(others)
        self.scraps_left_out += int(np.count_nonzero(~kept)) - len(others)
        can_id = frames.can_id[others]
        extended = can_id[(can_id & np.uint32(EXTENDED)) != 0]
        self.other_addresses.update(np.unique(extended & np.uint32(0xFF)).tolist())

    @staticmethod
    def _part(frames: FrameBlock, t_us: np.ndarray, kept: BoolColumn, cut: slice) -> FrameBlock:
        part = FrameBlock(t_us[cut], frames.can_id[cut], frames.length[cut], frames.data[cut])
        return part if kept[cut].all() else part[np.flatnonzero(kept[cut])]
