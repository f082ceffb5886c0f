"""Sample and hold on 20 ms ticks: nothing later than the tick, nothing stale, late channels waited for."""

from __future__ import annotations

import math

import numpy as np

from canest.grid.grid import Channel, Feed, Grid, GridBlock

HOLD_US = 2_000_000
MS = 1_000


def feed(
    samples: dict[str, list[tuple[int, float]]], last_ms: float, jump: str = "", before_ms: float = 0
) -> Feed:
    columns = {
        role: (np.array([round(t * MS) for t, _ in s], np.int64), np.array([v for _, v in s]))
        for role, s in samples.items()
    }
    first = min((round(s[0][0] * MS) for s in samples.values()), default=round(last_ms * MS))
    before = round(before_ms * MS) if jump and before_ms else None
    return Feed(columns, jump, before, first, round(last_ms * MS))


def ticks(blocks: list[GridBlock], role: str) -> dict[float, float]:
    return {int(t) / MS: float(v) for b in blocks for t, v in zip(b.t_us, b.values[role], strict=True)}


def test_a_tick_takes_what_is_stamped_at_or_before_it_and_nothing_later() -> None:
    grid = Grid([Channel("a")], HOLD_US)
    samples = [(0, 1.0), (39.999, 2.0), (40, 3.0), (40.001, 4.0), (61, 5.0)]
    blocks = grid.take(feed({"a": samples}, 61, "gap"))
    assert ticks(blocks, "a") == {0: 1.0, 20: 1.0, 40: 3.0, 60: 4.0}


def test_a_tick_is_held_while_a_sample_may_still_belong_to_it() -> None:
    grid = Grid([Channel("a")], HOLD_US)
    assert ticks(grid.take(feed({"a": [(0, 1.0), (20, 2.0)]}, 20, "gap")), "a") == {0: 1.0}
    assert ticks(grid.take(feed({"a": [(20, 3.0)]}, 20)), "a") == {}
    assert ticks(grid.take(feed({"a": [(20.001, 4.0)]}, 20.001)), "a") == {20: 3.0}


def test_ticks_are_multiples_of_20_ms_of_the_logs_clock() -> None:
    grid = Grid([Channel("a")], HOLD_US)
    begin = 1_700_000_000_123.457
    blocks = grid.take(feed({"a": [(begin, 1.0)]}, begin + 90, "gap"))
    assert [t % 20 for t in ticks(blocks, "a")] == [0, 0, 0, 0]
    assert min(ticks(blocks, "a")) >= begin


def test_a_value_goes_stale_after_its_limit() -> None:
    grid = Grid([Channel("a", stale_us=50 * MS), Channel("b"), Channel("c")], HOLD_US)
    (block,) = grid.take(feed({"a": [(10, 1.0)], "b": [(10, 7.0)]}, 101, "gap"))
    assert block.t_us.tolist() == [20 * MS, 40 * MS, 60 * MS, 80 * MS, 100 * MS]
    assert block.stale["a"].tolist() == [False, False, False, True, True]  # 60 ms is 50 ms after 10 ms
    assert [math.isnan(v) for v in block.values["a"]] == block.stale["a"].tolist()
    assert block.values["b"].tolist() == [7.0] * 5
    assert block.stale["c"].all()
    assert np.isnan(block.values["c"]).all()


def test_not_available_is_held_like_any_value_and_is_not_stale() -> None:
    grid = Grid([Channel("a", stale_us=50 * MS)], HOLD_US)
    (block,) = grid.take(feed({"a": [(0, 1.0), (15, math.nan)]}, 41, "gap"))
    assert np.isnan(block.values["a"]).tolist() == [False, True, True]
    assert not block.stale["a"].any()


def test_channels_that_report_late_are_waited_for() -> None:
    # "late" reports 60 ms late: its value at 60 is of 0, as is that of "now" at 0
    channels = [Channel("now"), Channel("late", delay_us=60 * MS), Channel("later", delay_us=40 * MS)]
    grid = Grid(channels, HOLD_US)
    event = [(float(t), float(t)) for t in range(0, 200, 20)]
    late = [(t + 60.0, v) for t, v in event]
    later = [(t + 40.0, v) for t, v in event]
    blocks = grid.take(feed({"now": event, "late": late, "later": later}, 201, "gap"))
    for t in range(60, 201, 20):
        assert ticks(blocks, "now")[t] == ticks(blocks, "late")[t] == ticks(blocks, "later")[t] == t - 60


def test_a_silence_is_held_then_slept_through() -> None:
    grid = Grid([Channel("a"), Channel("b", stale_us=30 * MS)], HOLD_US)
    first = grid.take(feed({"a": [(0, 1.0)], "b": [(0, 2.0)]}, 0, "gap"))
    second = grid.take(feed({"a": [(10_050, 3.0)]}, 10_090, "gap", before_ms=0.001))
    stamps = ticks(first + second, "a")
    assert list(stamps) == [*(20.0 * k for k in range(101)), 10_060, 10_080]
    assert stamps[2_000] == 1.0
    assert stamps[10_060] == 3.0
    assert [b.continues for b in first + second] == [False, False]
    assert ticks(second, "b")[20.0] == 2.0
    assert math.isnan(ticks(second, "b")[40.0])


def test_an_old_value_survives_a_gap_if_it_may_be_that_old() -> None:
    grid = Grid([Channel("constant"), Channel("b")], HOLD_US)
    grid.take(feed({"constant": [(0, 5.0)]}, 0, "gap"))
    blocks = grid.take(feed({"b": [(60_000, 1.0)]}, 60_001, "gap", before_ms=0.001))
    assert ticks(blocks, "constant")[60_000] == 5.0


def test_a_clock_set_back_ends_the_old_epoch_and_forgets_its_values() -> None:
    grid = Grid([Channel("a", stale_us=10**12), Channel("b"), Channel("c"), Channel("never")], HOLD_US)
    first = grid.take(
        feed({"a": [(100_000, 1.0)], "b": [(100_000, 7.0)], "c": [(100_025, 8.0)]}, 100_030, "gap")
    )
    second = grid.take(feed({"b": [(50_020, 2.0)]}, 50_041, "back", before_ms=100_030))
    assert list(ticks(first + second, "b")) == [100_000, 100_020, 50_020, 50_040]
    assert math.isnan(ticks(second, "a")[50_020])
    assert not second[-1].continues
    # what never grows too old is no older by it, also where no tick has seen it yet
    assert ticks(second, "c")[50_020] == 8.0
    assert second[-1].stale["never"].all()
    assert not second[-1].stale["c"].any()


def test_consecutive_blocks_continue_each_other() -> None:
    grid = Grid([Channel("a")], HOLD_US)
    blocks = [
        b for k in range(5) for b in grid.take(feed({"a": [(25.0 * k, k)]}, 25.0 * k, "" if k else "gap"))
    ]
    assert [b.continues for b in blocks] == [False, *[True] * (len(blocks) - 1)]
    assert list(ticks(blocks, "a")) == [0, 20, 40, 60, 80]


def test_stamps_that_stand_still_do_not_pile_up() -> None:
    grid = Grid([Channel("a"), Channel("late", delay_us=60 * MS)], HOLD_US)
    for k in range(1000):
        assert not grid.take(feed({"a": [(20, k + i) for i in range(7)]}, 20, "" if k else "gap"))
    assert grid.waiting("a") < 200
    assert ticks(grid.take(feed({}, 81)), "a")[80] == 999 + 6
