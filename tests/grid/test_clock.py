"""Event time: what counts as a jump, what is mended, what is counted."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.frames import FrameBlock
from canest.grid.clock import Clock

HOLD_US, BACK_US = 2_000_000, 500_000


HOUR_US = 3_600_000_000


def block(*stamps: int) -> FrameBlock:
    return FrameBlock.from_frames([(t, i, bytes([i % 256])) for i, t in enumerate(stamps)])


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


def interleaved(count: int, apart_us: int) -> list[int]:
    return [1000 * (i // 2) + (apart_us if i % 2 else 0) for i in range(count)]


@pytest.mark.parametrize("apart_us", [-HOUR_US, HOUR_US, 1_500_000])
def test_of_two_interleaved_clocks_one_is_followed(apart_us: int) -> None:
    clock = Clock(hold_us=2_000_000, max_backward_us=1_000_000)
    stretches = list(clock.split(block(*interleaved(100_000, apart_us))))
    assert clock.counters["clock_set_back"] == 200
    assert clock.of_another_clock > 49_000
    assert len(stretches) < 500
    last = stretches[-1].frames.t_us
    assert len(last) > 49_000
    assert set(np.diff(last[2:]).tolist()) == {1000}


def test_interleaved_clocks_are_cut_the_same_wherever_the_blocks_end() -> None:
    stamps = interleaved(5000, HOUR_US)
    whole, parts = (Clock(hold_us=2_000_000, max_backward_us=1_000_000) for _ in range(2))
    at_once = [t for s in whole.split(block(*stamps)) for t in s.frames.t_us.tolist()]
    piecewise: list[int] = []
    for first in range(0, len(stamps), 7):
        for stretch in parts.split(block(*stamps[first : first + 7])):
            assert len(stretch.frames)
            piecewise += stretch.frames.t_us.tolist()
    assert at_once == piecewise
    assert (whole.counters, whole.of_another_clock) == (parts.counters, parts.of_another_clock)


def test_when_the_followed_clock_falls_silent_the_other_one_is_followed() -> None:
    clock = Clock(hold_us=2_000_000, max_backward_us=1_000_000)
    stamps = interleaved(5000, HOUR_US)
    followed = [s.frames.t_us[-1] for s in clock.split(block(*stamps))][-1]
    other = [int(followed) % HOUR_US + (0 if followed >= HOUR_US else HOUR_US) + 1000 * k for k in range(500)]
    stretches = list(clock.split(block(*other)))
    assert sum(len(s.frames) for s in stretches) >= 400
    assert clock.last_us == other[-1]


def test_a_few_hundred_clocks_set_back_lose_no_frame() -> None:
    clock = Clock(hold_us=2_000_000, max_backward_us=1_000_000)
    stamps = [5_000_000 * (i % 2) for i in range(400)]
    assert sum(len(s.frames) for s in clock.split(block(*stamps))) == 400
    assert clock.of_another_clock == 0


def bursts(count: int, frames: int = 3, apart_us: int = 10_000_000) -> list[int]:
    return [apart_us * (i // frames) + 300_000 * (i % frames) for i in range(count * frames)]


def test_scraps_between_gaps_are_left_out_until_time_goes_on() -> None:
    clock = Clock(HOLD_US, BACK_US)
    drive_us = 10_000_000 * 5000 + np.arange(1000) * 20_000
    stretches = list(clock.split(block(*bursts(5000), *drive_us.tolist())))
    assert clock.counters["gaps"] == 5000
    assert len(stretches) == 201
    last = stretches[-1]
    assert (last.jump, last.before_us) == ("gap", stretches[-2].frames.t_us[-1])
    assert last.frames.t_us.tolist() == drive_us.tolist()[10:]
    assert clock.in_scraps == 15_000
    assert clock.scraps_left_out == 15_000 - 3 * 200 + 10
    assert clock.last_us == drive_us[-1]


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_scraps_are_cut_the_same_wherever_the_blocks_end(size: int) -> None:
    stamps = [*bursts(300), *(3_000_000_000 + np.arange(100) * 20_000).tolist(), *range(10**10, 10**10 + 9)]
    whole, parts = Clock(HOLD_US, BACK_US), Clock(HOLD_US, BACK_US)
    at_once = [t for s in whole.split(block(*stamps)) for t in s.frames.t_us.tolist()]
    piecewise = [
        t
        for first in range(0, len(stamps), size)
        for s in parts.split(block(*stamps[first : first + size]))
        for t in s.frames.t_us.tolist()
    ]
    assert at_once == piecewise
    assert (whole.last_us, whole.counters) == (parts.last_us, parts.counters)
    assert (whole.in_scraps, whole.scraps_left_out) == (parts.in_scraps, parts.scraps_left_out)


def test_short_drives_between_long_pauses_lose_no_frame() -> None:
    for frames, step_us in ((50, 20_000), (10, 1_000_000)):
        clock = Clock(HOLD_US, BACK_US)
        stamps = [HOUR_US * k + step_us * i for k in range(500) for i in range(frames)]
        assert sum(len(s.frames) for s in clock.split(block(*stamps))) == len(stamps)
        assert clock.counters["gaps"] == 499
        assert not clock.in_scraps and not clock.scraps_left_out
