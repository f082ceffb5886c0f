"""The refusal of jumps, sample by sample."""

from __future__ import annotations

from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.vehicle import range_rate_check as module
from canest.vehicle.range_rate_check import JUMP, MOTION_JUMP, Limit, RangeRateCheck


def column(pairs):
    return np.array([t for t, _ in pairs], np.int64), np.array([v for _, v in pairs], float)


def passed(screen, pairs):
    return list(zip(*(c.tolist() for c in screen.apply({"x": column(pairs)})["x"]), strict=True))


def screen():
    return RangeRateCheck({"x": Limit(slack=1.0, rate=10.0)}, {"x"})


def test_one_outlier_is_rejected_and_reported():
    kept = screen().apply({"x": column([(0, 5.0), (10_000, 90.0), (20_000, 5.2)])})
    assert kept["x"][1].tolist() == [5.0, 5.2]
    for name in (JUMP, MOTION_JUMP):
        assert kept[name][0].tolist() == [10_000]


def test_a_value_that_has_really_changed_is_taken_after_a_while():
    pairs = [(0, 0.0)] + [(100_000 * k, 20.0) for k in range(1, 30)]
    assert passed(screen(), pairs)[:2] == [(0, 0.0), (1_900_000, 20.0)]


def test_a_forged_first_sample_does_not_keep_the_truth_out():
    assert len(passed(screen(), [(0, 100.0)] + [(100_000 * k, 0.0) for k in range(200)])) > 100


@pytest.mark.parametrize("n", [20, 200])  # walked, and in columns
def test_an_impossible_first_sample_keeps_nothing_out(n):
    pairs = [(0, 1e300), *((100_000 * k, 5.0) for k in range(1, n))]
    screened = RangeRateCheck({"x": Limit(slack=1.0, rate=10.0, most=150.0)})
    assert passed(screened, pairs) == pairs[1:]
    assert screened.refused["x"] == 1


@pytest.mark.parametrize("n", [20, 200])
def test_a_controller_that_wakes_with_zero_keeps_nothing_out(n):
    pairs = [(0, 0.0), *((100_000 * k, 2100.0) for k in range(1, n))]
    screened = RangeRateCheck({"x": Limit(slack=5.0, rate=5.0, least=50.0)})
    assert passed(screened, pairs) == pairs[1:]


def test_not_available_passes_and_is_no_reference():
    values = [v for _, v in passed(screen(), [(0, 1.0), (1, np.nan), (2, 50.0), (3, 1.0)])]
    assert values[0] == 1.0
    assert np.isnan(values[1])
    assert values[2:] == [1.0]


def test_a_clock_set_back_forgets_the_reference():
    s = screen()
    s.apply({"x": column([(10**12, 1.0)])})
    s.restart()
    assert passed(s, [(0, 50.0)]) == [(0, 50.0)]


def test_other_roles_are_left_alone():
    kept = screen().apply({"y": column([(0, 0.0), (1, 1e9)])})
    assert list(kept) == ["y"]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 300_000), st.sampled_from([0.0, 0.5, 2.0, 3.5, 40.0, np.nan, np.inf]))),
    st.lists(st.integers(0, 40)),
    st.sampled_from([0, 3, 50]),
    st.sampled_from([1, 2, 50]),
)
def test_any_cut_refuses_the_same_samples(steps, cuts, few, after_jump):
    t_us, pairs = 0, []
    for step, value in steps:
        t_us += step
        pairs.append((t_us, value))

    def flat(parts):
        both = [p.get("x", column([])) for p in parts]
        jumps = [p.get(JUMP, column([])) for p in parts]
        return [np.concatenate([c[i] for c in cs]).tobytes() for cs in (both, jumps) for i in (0, 1)]

    edges = sorted({0, len(pairs), *(c for c in cuts if c < len(pairs))})
    one, cut = screen(), screen()
    with patch.object(module, "_FEW", len(pairs)):  # walked
        whole = flat([one.apply({"x": column(pairs)})])
    with patch.multiple(module, _FEW=few, _AFTER_JUMP=after_jump):  # walked, or in columns
        parts = flat([cut.apply({"x": column(pairs[a:b])}) for a, b in pairwise(edges)] or [{}])
    assert parts == whole
    assert one.refused == cut.refused
    assert sum(one.refused.values()) == len(pairs) - len(whole[0]) // 8


@pytest.mark.parametrize("name", ["class8", "kenworth", "bmw-i3", "testcar"])
def test_every_shipped_config_has_its_speeds_limited(name):
    from canest.config import load_config
    from canest.vehicle.range_rate_check import limits_of
    from canest.vehicle.role_sources import motion_roles

    config = load_config(name)
    limited = limits_of(config.signals, config.vehicle.mps_per_shaft_rpm)
    assert any("speed" in role for role in limited)
    assert motion_roles(config.signals, config.vehicle) & set(config.signals)
