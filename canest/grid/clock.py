"""Event time: cuts the stream of wanted frames where its clock jumps.

Nothing here looks at a wall clock. A stamp that goes back a little (two channels interleaved, a
reordered pair) is clamped and counted; one that goes back further, or a silence longer than the grid
holds, starts a new stretch of time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from canest.core.frames import FrameBlock


@dataclass(frozen=True, slots=True)
class Stretch:
    """Frames whose stamps never decrease. ``jump`` says how it follows what came before."""

    frames: FrameBlock
    #: "" continues; "gap" after a silence; "back" when the clock was set back
    jump: str
    #: stamp of the last frame before the jump, None at the start of the stream
    before_us: int | None = None


class Clock:
    """Splits blocks into monotone stretches; carries the last stamp; counts what it had to mend."""

    def __init__(self, hold_us: int, max_backward_us: int) -> None:
        self.hold_us, self._max_backward_us = hold_us, max_backward_us
        self.first_us: int | None = None
        self.last_us: int | None = None
        self.stamps = 0  #: seen so far
        self.counters = {"reordered": 0, "gaps": 0, "clock_set_back": 0}

    def split(self, frames: FrameBlock) -> Iterator[Stretch]:
        """Yield the stretches of a block (in order)."""
        if not len(frames):
            return
        self.stamps += len(frames)
        t_us = frames.t_us
        first = self.last_us is None
        if first:
            self.first_us = int(t_us[0])
        step = 0 if self.last_us is None else int(t_us[0]) - self.last_us
        steps = t_us[1:] - t_us[:-1]
        if min(step, steps.min(initial=0)) < 0 or max(step, steps.max(initial=0)) > self.hold_us:
            yield from self._split_slowly(frames)
            return
        self.last_us = int(t_us[-1])
        yield Stretch(frames, "gap" if first else "")

    def _split_slowly(self, frames: FrameBlock) -> Iterator[Stretch]:
        """Walk a block that holds a jump: frame by frame, since every clamp moves the reference."""
        t_us = frames.t_us.copy()
        begin, jump, before = 0, "gap" if self.last_us is None else "", None
        last = int(t_us[0]) if self.last_us is None else self.last_us
        for i, stamp in enumerate(frames.t_us.tolist()):
            step = stamp - last
            if step < -self._max_backward_us or step > self.hold_us:
                if i > begin:
                    yield Stretch(self._part(frames, t_us, begin, i), jump, before)
                begin, jump, before = i, "back" if step < 0 else "gap", last
                self.counters["clock_set_back" if step < 0 else "gaps"] += 1
                last = stamp
            elif step < 0:
                self.counters["reordered"] += 1
                t_us[i] = last
            else:
                last = stamp
        self.last_us = last
        yield Stretch(self._part(frames, t_us, begin, len(t_us)), jump, before)

    @staticmethod
    def _part(frames: FrameBlock, t_us: np.ndarray, begin: int, end: int) -> FrameBlock:
        cut = slice(begin, end)
        return FrameBlock(t_us[cut], frames.can_id[cut], frames.length[cut], frames.data[cut])
