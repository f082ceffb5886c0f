"""Clock and grid against a slow reference that takes one frame at a time, however the stream is cut."""

from __future__ import annotations

import math
from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core.frames import FrameBlock
from canest.grid import grid as module
from canest.grid.clock import Clock
from canest.grid.grid import Channel, Feed, Grid

ROLES = ("a", "b", "c")
STEP_US = 20_000
HOLD_US, BACK_US = 200_000, 50_000
CHANNELS = [Channel("a", 0, 45_000), Channel("b", 30_000, 100_000), Channel("c", 70_000)]
Row = tuple[int, bool, tuple[str, ...]]


def reference(frames: list[tuple[int, int, float]]) -> list[Row]:
    """Ticks as (stamp, whether a run begins, values as text): one frame, one tick, one channel at a time."""
    wait = max(c.delay_us for c in CHANNELS)
    received: dict[str, list[tuple[int, float]]] = {r: [] for r in ROLES}
    rows: list[Row] = []
    last = next_tick = None
    fresh = True

    def emit(before: float) -> None:
        nonlocal next_tick, fresh
        while next_tick < before:
            held = []
            for channel in CHANNELS:
                seen = next_tick - (wait - channel.delay_us)
                value, age = math.nan, math.inf
                for t, v in received[channel.role]:
                    if t <= seen:
                        value, age = v, seen - t
                held.append(repr(value if age <= channel.stale_us else math.nan))
            rows.append((next_tick, fresh, tuple(held)))
            next_tick, fresh = next_tick + STEP_US, False

    for stamp, role, value in frames:
        if last is None or not -BACK_US <= stamp - last <= HOLD_US:
            if last is not None:
                emit(last + HOLD_US if stamp > last else last + 1)
                if stamp < last:
                    kept = [(stamp - wait, value) for _, value in received["c"][-1:]]  # never grows too old
                    received = {"a": [], "b": [], "c": kept}
            next_tick, fresh = math.ceil(stamp / STEP_US) * STEP_US, True
            last = stamp
        last = max(stamp, last)
        emit(last)
        received[ROLES[role]].append((last, value))
    if last is not None:
        emit(last + 1)
    return rows


def under_test(frames: list[tuple[int, int, float]], cuts: list[int]) -> list[Row]:
    values = np.array([v for *_, v in frames])
    block = FrameBlock.from_frames(
        [(t, role, i.to_bytes(8, "little")) for i, (t, role, _) in enumerate(frames)]
    )
    clock, grid = Clock(HOLD_US, BACK_US), Grid(CHANNELS, HOLD_US)
    blocks = []
    for begin, end in zip([0, *cuts], [*cuts, len(frames)], strict=True):
        for s in clock.split(block[begin:end]):
            picked = {
                name: (s.frames.t_us[rows], values[s.frames.data[rows].astype(int)])
                for role, name in enumerate(ROLES)
                if (rows := s.frames.can_id == role).any()
            }
            t = s.frames.t_us
            blocks += grid.take(Feed(picked, s.jump, s.before_us, int(t[0]), int(t[-1])))
    if clock.last_us is not None:
        blocks.append(grid.ticks_until(clock.last_us, inclusive=True))
    rows = []
    for b in filter(None, blocks):
        for i, t in enumerate(b.t_us.tolist()):
            held = tuple(repr(float(b.values[c.role][i])) for c in CHANNELS)
            rows.append((t, i == 0 and not b.continues, held))
    return rows


steps = st.one_of(
    st.integers(0, 30_000),
    st.sampled_from([0, 1, 19_999, 20_000, 20_001, 199_999, 200_000, 200_001, 500_000]),
    st.sampled_from([-1, -10_000, -49_999, -50_000, -50_001, -300_000]),
)
values = st.one_of(st.floats(-10, 10).map(lambda v: v + 0.0), st.just(math.nan))  # never minus zero


@settings(max_examples=300, deadline=None)
@given(
    first=st.integers(1_000_000, 1_100_000),
    moves=st.lists(st.tuples(steps, st.integers(0, 2), values), max_size=40),
    data=st.data(),
)
def test_any_stream_in_any_cut_is_as_the_reference(first: int, moves: list, data: st.DataObject) -> None:
    frames, now = [(first, 0, 1.0)], first
    for step, role, value in moves:
        now += step
        frames.append((now, role, value))
    expected = reference(frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(frames)), max_size=8)))
    for few in (0, 2, 50):  # everything in columns, some of it, everything one by one
        with patch.object(module, "_FEW", few):
            assert under_test(frames, []) == expected
            assert under_test(frames, cuts) == expected
            assert under_test(frames, list(range(1, len(frames)))) == expected
