"""The vehicle is found on the map while it drives: by position and direction, and never on another road."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from canest.road.build import build_map
from canest.road.matching import RoadMatcher
from tests.road.conftest import drive, grade_at, place_at

SPEED_MPS = 20.0


@pytest.fixture(scope="module")
def road():
    return build_map([drive(k, v) for k, v in enumerate("abcabc")])


def ticks(seconds: int = 200, begin_m: float = 300.0, side_m: float = 0.0, backwards: bool = False):
    """Return ticks of a vehicle on the road at a constant speed, a position per second; and the way."""
    n = 50 * seconds
    way = begin_m + SPEED_MPS * 0.02 * np.arange(n)
    way = 6000.0 - way if backwards else way
    held = way[np.arange(n) // 50 * 50]
    latitude, longitude = place_at(held, side_m)
    return (
        {"latitude": latitude, "longitude": longitude, "speed": np.full(n, SPEED_MPS)},
        way,
    )


def matched(road, columns, cuts=()):
    matcher = RoadMatcher(road)
    n = len(columns["speed"])
    sines, stds = [], []
    for number, (first, end) in enumerate(pairwise([0, *cuts, n])):
        part = {name: column[first:end] for name, column in columns.items()}
        block = Ticks(part, continues=number > 0)
        samples = SimpleNamespace(stopped=part["speed"] == 0.0, raw_speed_mps=part["speed"])
        sine, std = matcher.match(block, samples)
        sines.append(sine)
        stds.append(std)
    return np.concatenate(sines), np.concatenate(stds)


class Ticks:
    def __init__(self, columns, continues):
        self.values = {name: columns[name] for name in ("latitude", "longitude")}
        self.continues = continues

    def __len__(self):
        return len(self.values["latitude"])


def test_the_slope_is_that_of_the_place_between_positions_too(road):
    columns, way = ticks()
    sine, std = matched(road, columns)
    known = np.isfinite(sine)
    assert known[100:].mean() > 0.99
    error = sine[known] - np.sin(np.arctan(grade_at(way[known])))
    assert np.sqrt(np.mean(error**2)) < 0.001
    assert np.all(np.isfinite(std[known]))
    assert np.sqrt(np.mean((error / std[known]) ** 2)) < 1.5


@pytest.mark.parametrize("cuts", [[1], [49, 50, 51], [333, 334, 7777], list(range(20, 10_000, 20))])
def test_the_cut_of_the_ticks_changes_no_bit(road, cuts):
    columns, _ = ticks()
    for whole, cut in zip(matched(road, columns), matched(road, columns, cuts), strict=True):
        assert np.array_equal(whole, cut, equal_nan=True)


def test_the_other_direction_and_a_road_beside_are_not_this_road(road):
    for columns, _ in (ticks(backwards=True), ticks(side_m=35.0)):
        assert not np.isfinite(matched(road, columns)[0]).any()


def test_where_two_roads_lie_beside_each_other_none_is_taken():
    both = build_map([*(drive(k, noise_m=0.1) for k in range(3)),
                      *(drive(k, noise_m=0.1, side_m=22.0) for k in range(3, 6))])  # fmt: skip
    between, _ = ticks(side_m=11.0)
    assert np.isfinite(matched(both, between)[0]).mean() < 0.05


def test_a_jump_of_the_position_is_no_place_on_the_road(road):
    columns, _ = ticks()
    columns["latitude"][5000:5250] += 0.002  # 220 m for 5 s
    sine, _ = matched(road, columns)
    assert not np.isfinite(sine[5000:5250]).any()
    assert np.isfinite(sine[5400:]).mean() > 0.98


def test_without_new_positions_the_map_is_followed_for_some_seconds(road):
    columns, way = ticks()
    for name in ("latitude", "longitude"):
        columns[name][5000:7500] = np.nan
    sine, _ = matched(road, columns)
    assert np.isfinite(sine[5000:5400]).all()
    assert not np.isfinite(sine[5700:7500]).any()
    error = sine[5000:5400] - np.sin(np.arctan(grade_at(way[5000:5400])))
    assert np.abs(error).max() < 0.003


def test_off_the_map_nothing_is_known(road):
    columns, _ = ticks()
    columns["latitude"] += 1.0
    assert not np.isfinite(matched(road, columns)[0]).any()


def test_the_road_ahead_is_that_of_the_map(road):
    columns, way = ticks(seconds=50)
    matcher = RoadMatcher(road)
    samples = SimpleNamespace(stopped=np.zeros(len(way), bool), raw_speed_mps=columns["speed"])
    assert matcher.ahead() == ([], [])
    matcher.match(Ticks(columns, continues=False), samples)
    at_m, grade = (np.array(column) for column in matcher.ahead(1500.0))
    assert at_m[0] < 30.0 and 1400.0 < at_m[-1] < 1600.0
    assert np.sqrt(np.mean((grade - grade_at(way[-1] + at_m)) ** 2)) < 0.0015


@pytest.mark.parametrize("every_s", [0.1, 0.2, 0.5, 5.0])
def test_positions_of_any_rate_find_the_road(road, every_s):
    columns, way = ticks(seconds=100)
    held = np.arange(len(way)) // round(every_s * 50) * round(every_s * 50)
    columns["latitude"], columns["longitude"] = place_at(way[held])
    sine, _ = matched(road, columns)
    assert np.isfinite(sine[500:]).mean() > 0.9
