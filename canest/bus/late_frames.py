"""Frames that come after ticks which should have had them: a busy machine is late, not wrong."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FrameBlock


def restamp_late_frames(frames: FrameBlock, reached_us: int, max_backward_s: float) -> tuple[FrameBlock, int]:
    """Return the frames, late ones stamped with the time that the ticks have reached, and how many were late.

    max_backward_s: beyond it the clock was set, nothing is late.
    A recording then holds the order in which frames were used, and its replay is equal to the bit.
    """
    if not len(frames) or frames.t_us.min() >= reached_us:
        return frames, 0
    behind_us = reached_us - frames.t_us
    late = (behind_us > 0) & (behind_us <= max_backward_s * 1e6)
    if not late.any():
        return frames, 0
    t_us = np.where(late, reached_us, frames.t_us)
    return FrameBlock(t_us, frames.can_id, frames.length, frames.data), int(late.sum())
