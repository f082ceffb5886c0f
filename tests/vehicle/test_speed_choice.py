"""Which signal gives the speed, and what becomes of the step where another one takes over."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from vehicle_helpers import ticks

from canest.vehicle.speed_choice import SpeedChoice

N = 400
ROLES = ("output_shaft_speed", "undriven_speed", "engine_speed")
SHAFT, AXLE, ENGINE = np.full(N, 15.0), np.full(N, 15.1), np.full(N, 15.05)


def lost(column: np.ndarray, *where: tuple[int, int]) -> np.ndarray:
    gone = column.copy()
    for begin, end in where:
        gone[begin:end] = np.nan
    return gone


def chosen(*speeds: np.ndarray, cuts: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    choice, parts = SpeedChoice(ROLES), []
    for begin, end in pairwise((0, *cuts, N)):
        block = ticks({"x": 0.0}, end - begin, begin, continues=begin > 0)
        parts.append(choice.choose([partial(s.__getitem__, slice(begin, end)) for s in speeds], block))
    speed, taken, _ = (np.concatenate(column) for column in zip(*parts, strict=True))
    return speed, taken


def test_the_finest_speed_is_taken_and_the_next_where_it_is_lost() -> None:
    speed, taken = chosen(lost(SHAFT, (100, 200)), AXLE, ENGINE)
    assert (taken[:100] == 0).all()
    # back for a second before it counts
    assert (taken[100:250] == 1).all()
    assert (taken[250:] == 0).all()
    # the steps between them are no speed; all else is one of the two
    assert np.flatnonzero(np.isnan(speed)).tolist() == [100, 250]
    assert set(speed[~np.isnan(speed)]) == {15.0, 15.1}


def test_a_speed_that_comes_and_goes_is_not_taken_again() -> None:
    flickering = lost(SHAFT, *((k, k + 5) for k in range(100, 400, 20)))
    speed, taken = chosen(flickering, AXLE, ENGINE)
    assert (taken[100:] == 1).all()
    assert np.count_nonzero(np.isnan(speed)) == 1


def test_where_there_is_no_step_nothing_is_lost() -> None:
    speed, _ = chosen(lost(SHAFT, (100, 200)), SHAFT, ENGINE)
    assert not np.isnan(speed).any()


def test_a_speed_that_first_comes_late_is_taken_at_once() -> None:
    _, taken = chosen(lost(SHAFT, (0, 7)), AXLE, ENGINE)
    assert taken.tolist() == [1] * 7 + [0] * (N - 7)


def test_the_engine_is_lost_in_every_shift_and_taken_again_with_the_gear() -> None:
    roles = ("engine_speed", "vehicle_speed")
    choice = SpeedChoice(roles)
    speed, taken, _ = choice.choose([lambda: lost(ENGINE, (100, 140)), lambda: AXLE], ticks({"x": 0.0}, N))
    assert (taken[140:] == 0).all()
    assert not np.isnan(speed).any()


def test_an_unreliable_speed_is_better_than_none() -> None:
    gone = (N - 100, N)
    speed, taken = chosen(lost(SHAFT, (200, 220), gone), lost(AXLE, gone), lost(ENGINE, gone))
    assert np.isnan(speed[-100:]).all() and (taken[-100:] == -1).all()
    speed, taken = chosen(lost(SHAFT, (200, 220)), lost(AXLE, (225, N)), lost(ENGINE, (0, N)))
    assert (taken[226:] == 0).all()


def test_any_cut_gives_the_same_bits() -> None:
    rng = np.random.default_rng(3)
    speeds = []
    for column in (SHAFT, AXLE, ENGINE):
        begins = rng.integers(0, N, 4)
        speeds.append(lost(column, *((int(b), int(b + rng.integers(1, 60))) for b in begins)))
    whole = chosen(*speeds)
    for pieces in (1, 3, 20, 200):
        cuts = tuple(np.sort(rng.choice(np.arange(1, N), pieces, replace=False)).tolist())
        cut = chosen(*speeds, cuts=cuts)
        assert whole[0].tobytes() == cut[0].tobytes()
        assert whole[1].tobytes() == cut[1].tobytes()


@pytest.mark.parametrize("cut", [1, 60, 100, 101, 150, 300])
def test_a_speed_that_was_never_received_is_not_the_finest(cut: int) -> None:
    choice, found = SpeedChoice(ROLES), []
    speeds = lost(SHAFT, (0, 100), (200, 300)), lost(AXLE, (0, 50)), lost(ENGINE, (0, 20))
    for begin, end in pairwise((0, cut, N)):
        block = ticks({"x": 0.0}, end - begin, begin, continues=begin > 0)
        found.append(choice.choose([partial(s.__getitem__, slice(begin, end)) for s in speeds], block)[2])
    finest = np.concatenate(found)
    assert finest.tolist() == [3] * 20 + [2] * 30 + [1] * 50 + [0] * (N - 100)
