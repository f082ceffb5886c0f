"""Event time: what counts as a jump, what is mended, what is counted."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FrameBlock
from canest.grid.clock import Clock

HOLD_US, BACK_US = 2_000_000, 500_000


def block(*stamps: int) -> FrameBlock:
    return FrameBlock.from_frames([(t, i, bytes([i])) for i, t in enumerate(stamps)])


def split(clock: Clock, *stamps: int) -> list[tuple[str, int | None, list[int]]]:
    return [(s.jump, s.before_us, s.frames.t_us.tolist()) for s in clock.split(block(*stamps))]


def test_the_first_frame_starts_time() -> None:
    clock = Clock(HOLD_US, BACK_US)
    assert clock.last_us is None
    assert split(clock) == []
    assert split(clock, 7, 7, 9) == [("gap", None, [7, 7, 9])]
    assert split(clock, 10, 2_000_010) == [("", None, [10, 2_000_010])]
    assert clock.last_us == 2_000_010
    assert not any(clock.counters.values())


def test_a_silence_longer_than_the_hold_is_a_gap() -> None:
    clock = Clock(HOLD_US, BACK_US)
    assert split(clock, 0, 10, 2_000_011, 2_000_012) == [
        ("gap", None, [0, 10]),
        ("gap", 10, [2_000_011, 2_000_012]),
    ]
    assert split(clock, 9_000_000) == [("gap", 2_000_012, [9_000_000])]
    assert clock.counters == {"reordered": 0, "gaps": 2, "clock_set_back": 0}


def test_a_clock_set_back_starts_a_new_epoch() -> None:
    clock = Clock(HOLD_US, BACK_US)
    assert split(clock, 1_000_000, 499_999, 500_005) == [
        ("gap", None, [1_000_000]),
        ("back", 1_000_000, [499_999, 500_005]),
    ]
    assert clock.counters == {"reordered": 0, "gaps": 0, "clock_set_back": 1}


def test_a_little_backward_is_clamped_and_counted() -> None:
    clock = Clock(HOLD_US, BACK_US)
    original = block(1_000_000, 999_000, 500_000, 1_000_001)
    (stretch,) = clock.split(original)
    assert stretch.frames.t_us.tolist() == [1_000_000, 1_000_000, 1_000_000, 1_000_001]
    assert original.t_us.tolist() == [1_000_000, 999_000, 500_000, 1_000_001]
    assert np.array_equal(stretch.frames.data, original.data)
    assert clock.counters == {"reordered": 2, "gaps": 0, "clock_set_back": 0}


def test_a_clamped_stamp_does_not_move_the_reference() -> None:
    clock = Clock(HOLD_US, BACK_US)
    split(clock, 1_000_000)
    for stamp in (600_000, 550_000, 500_000):  # each within the limit of the newest, not of the one before
        assert split(clock, stamp) == [("", None, [1_000_000])]
    assert split(clock, 499_999) == [("back", 1_000_000, [499_999])]
