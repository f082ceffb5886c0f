"""Slow signals: joined from report to report, as far behind as that takes, the same in any cut."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from test_grid import HOLD_US, MS, feed, ticks

from canest.grid.between import earlier, larger, line, smaller, unchanged
from canest.grid.clock import Clock
from canest.grid.grid import Channel, Feed, Grid

PERIOD_US = 100 * MS
SLOW = {"stale_us": 250 * MS, "wait_us": 120 * MS}


def test_a_slow_signal_lies_on_the_line_from_report_to_report() -> None:
    grid = Grid([Channel("a", between=line, **SLOW), Channel("b", stale_us=50 * MS)], HOLD_US)
    a, b = [(0, 0.0), (100, 10.0), (200, 10.0), (300, 0.0)], [(20.0 * k, float(k)) for k in range(16)]
    seen = ticks(grid.take(feed({"a": a, "b": b}, 301, "gap")), "a")
    assert seen[120] == 0.0 and seen[140] == 2.0 and seen[220] == 10.0 and seen[300] == 10.0
    assert all(math.isnan(v) for t, v in seen.items() if t < 120)


def test_a_fast_signal_beside_it_is_shown_as_of_the_same_moment() -> None:
    grid = Grid([Channel("a", between=line, **SLOW), Channel("b", stale_us=50 * MS)], HOLD_US)
    ramp = [(20.0 * k, 20.0 * k) for k in range(31)]
    blocks = grid.take(feed({"a": ramp[::5], "b": ramp}, 601, "gap"))
    a, b = ticks(blocks, "a"), ticks(blocks, "b")
    assert all(a[t] == b[t] == t - 120 for t in a if t >= 120)


def test_while_a_report_is_overdue_the_signal_is_stale_and_nothing_is_guessed() -> None:
    grid = Grid([Channel("a", between=line, **SLOW)], HOLD_US)
    reports = [(0, 0.0), (100, 1.0), (300, 3.0), (400, 4.0), (800, 8.0)]
    seen = ticks(grid.take(feed({"a": reports}, 1000, "gap")), "a")
    assert math.isnan(seen[280])  # what is 60 ms after the report of 100, and the next one is not here
    assert seen[300] == 1.8  # now it is
    assert seen[500] == 3.8
    assert all(math.isnan(seen[t]) for t in range(540, 920, 20))  # too far apart to be joined


def test_a_report_without_a_number_leaves_nothing_on_either_side() -> None:
    grid = Grid([Channel("a", between=line, **SLOW)], HOLD_US)
    reports = [(0, 0.0), (100, math.nan), (200, 2.0), (300, 3.0)]
    seen = ticks(grid.take(feed({"a": reports}, 421, "gap")), "a")
    assert all(math.isnan(seen[t]) for t in range(140, 320, 20))
    assert seen[340] == 2.2


def test_a_brake_counts_from_the_report_before_it_was_seen_until_the_one_after() -> None:
    grid = Grid([Channel("a", between=larger, **SLOW), Channel("b", between=earlier, **SLOW)], HOLD_US)
    reports = [(0, 0.0), (100, 1.0), (200, 0.0), (300, 0.0)]
    blocks = grid.take(feed({"a": reports, "b": reports}, 421, "gap"))
    braked, held = ticks(blocks, "a"), ticks(blocks, "b")
    assert [braked[t] for t in (140, 200, 240, 300, 320, 340)] == [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]
    assert [held[t] for t in (140, 200, 240, 300, 320)] == [0.0, 0.0, 1.0, 1.0, 0.0]


CHANNELS = [
    Channel("a", 0, 250 * MS, line, 120 * MS),
    Channel("b", 30_000, 100_000),
    Channel("c", 15_000, 500 * MS, larger, 70 * MS),
]
steps = st.one_of(
    st.integers(0, 80_000),
    st.sampled_from([0, 1, 20_000, 100_000, 250_000, 250_001, 600_000, -1, -10_000, -300_000]),
)
values = st.one_of(st.floats(-10, 10).map(lambda v: v + 0.0), st.just(math.nan))


def rows(frames: list[tuple[int, int, float]], cuts: list[int]) -> list[tuple[int, bool, tuple[str, ...]]]:
    from canest.core.frames import FrameBlock

    numbers = np.array([v for *_, v in frames])
    block = FrameBlock.from_frames(
        [(t, role, i.to_bytes(8, "little")) for i, (t, role, _) in enumerate(frames)]
    )
    clock, grid = Clock(400 * MS, 50 * MS), Grid(CHANNELS, 400 * MS)
    blocks = []
    for begin, end in zip([0, *cuts], [*cuts, len(frames)], strict=True):
        for s in clock.split(block[begin:end]):
            picked = {
                name: (s.frames.t_us[at], numbers[s.frames.data[at].astype(int)])
                for role, name in enumerate("abc")
                if (at := s.frames.can_id == role).any()
            }
            t = s.frames.t_us
            blocks += grid.take(Feed(picked, s.jump, s.before_us, int(t[0]), int(t[-1])))
    if clock.last_us is not None:
        blocks.append(grid.ticks_until(clock.last_us, inclusive=True))
    return [
        (t, i == 0 and not b.continues, tuple(repr(float(b.values[r][i])) for r in "abc"))
        for b in filter(None, blocks)
        for i, t in enumerate(b.t_us.tolist())
    ]


@settings(max_examples=200, deadline=None)
@given(
    moves=st.lists(st.tuples(steps, st.integers(0, 2), values), min_size=1, max_size=40),
    data=st.data(),
)
def test_any_cut_gives_the_same_ticks(moves: list, data: st.DataObject) -> None:
    frames, now = [(1_000_000, 0, 1.0)], 1_000_000
    for step, role, value in moves:
        now += step
        frames.append((now, role, value))
    whole = rows(frames, [])
    cuts = sorted(data.draw(st.lists(st.integers(0, len(frames)), max_size=8)))
    assert rows(frames, cuts) == whole
    assert rows(frames, list(range(1, len(frames)))) == whole


def test_what_lies_between_two_gears_is_none_and_a_driveline_open_at_one_end_is_open() -> None:
    grid = Grid([Channel("a", between=unchanged, **SLOW), Channel("b", between=smaller, **SLOW)], HOLD_US)
    gears, engaged = (
        [(0, 5.0), (100, 5.1), (200, 7.0), (300, 7.0)],
        [(0, 1.0), (100, 0.0), (200, 1.0), (300, 1.0)],
    )
    blocks = grid.take(feed({"a": gears, "b": engaged}, 421, "gap"))
    gear, closed = ticks(blocks, "a"), ticks(blocks, "b")
    assert gear[140] == 5.0 and gear[200] == 5.0 and gear[340] == 7.0  # 2 % apart is one ratio, rounded
    assert all(math.isnan(gear[t]) for t in range(220, 320, 20))
    assert [closed[t] for t in (140, 240, 320, 340)] == [0.0, 0.0, 1.0, 1.0]
