"""The whole way from frames to estimates gives the same bits however the stream is cut."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canest.config import load_config
from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.demo import DRIVE
from canest.logs.format_detection import open_log
from canest.pipeline.pipeline import Pipeline

KENWORTH = Path(__file__).parents[1] / "data" / "kenworth" / "normal.log.xz"


def frames_of(log: Path, first: int, count: int) -> FrameBlock:
    whole = FrameBlock.concatenate([b for b in open_log(log) if isinstance(b, FrameBlock)])
    return whole[first : first + count]


STREAMS = {
    "kenworth": (load_config("kenworth"), frames_of(KENWORTH, 0, 8000)),
    "class8": (load_config("class8"), frames_of(DRIVE, 6000, 9000)),
    "kenworth-rlsmf": (load_config("kenworth", ["estimator.name=rlsmf"]), frames_of(KENWORTH, 3000, 6000)),
    # a clock that jumps back, a silence, and frames out of order
    "broken-clock": (load_config("kenworth"), frames_of(KENWORTH, 0, 6000)),
}
_t = STREAMS["broken-clock"][1].t_us
_t[2000:] -= 20_000_000
_t[4000:] += 9_000_000
_t[4500:4502] = _t[4500:4502][::-1].copy()


def estimates(name: str, cuts: list[int]) -> Estimates:
    config, frames = STREAMS[name]
    pipeline = Pipeline(config)
    edges = [0, *sorted(cuts), len(frames)]
    parts = [pipeline.push(frames[a:b]) for a, b in pairwise(edges)]
    return Estimates.concatenate([*parts, pipeline.finish()])


WHOLE = {name: estimates(name, []) for name in STREAMS}


def assert_same_bits(found: Estimates, name: str) -> None:
    expected = WHOLE[name]
    assert len(expected) > 100
    for column in Estimates.__slots__:
        a, b = getattr(found, column), getattr(expected, column)
        assert a.tobytes() == b.tobytes(), f"{column} differs first at {np.flatnonzero(a != b)[:3]}"


@pytest.mark.parametrize("name", sorted(STREAMS))
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_random_boundaries(name, data):
    n = len(STREAMS[name][1])
    cuts = data.draw(st.lists(st.integers(0, n), max_size=40))
    assert_same_bits(estimates(name, cuts), name)


@pytest.mark.parametrize("name", sorted(STREAMS))
def test_blocks_as_they_arrive_live(name):
    t_us = STREAMS[name][1].t_us
    cuts = np.flatnonzero(np.diff(t_us // 20_000)) + 1
    assert_same_bits(estimates(name, cuts.tolist()), name)


def test_one_frame_at_a_time():
    config, frames = STREAMS["kenworth"]
    pipeline = Pipeline(config)
    parts = [pipeline.push(frames[:4000])]
    parts += [pipeline.push(frames[i : i + 1]) for i in range(4000, 5500)]
    parts += [pipeline.push(frames[5500:]), pipeline.finish()]
    assert_same_bits(Estimates.concatenate(parts), "kenworth")


def test_advancing_time_between_blocks_changes_nothing():
    config, frames = STREAMS["class8"]
    pipeline = Pipeline(config)
    parts = []
    edges = [0, *(np.flatnonzero(np.diff(frames.t_us // 20_000)) + 1).tolist(), len(frames)]
    for a, b in pairwise(edges):
        parts.append(pipeline.push(frames[a:b]))
        if b < len(frames):
            parts.append(pipeline.advance_to(int(frames.t_us[b])))
    assert_same_bits(Estimates.concatenate([*parts, pipeline.finish()]), "class8")
