from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.diagnosis.data.drive import Run
from canest.diagnosis.data.residual_windows import CHUNK_S, WINDOW_TICKS, windows_of

RUNS = st.lists(st.tuples(st.integers(1, 170), st.booleans(), st.booleans()), min_size=1, max_size=12)


def columns(runs):
    """Stretches of open and closed ticks; a True in third place leaves a gap of a minute before it."""
    open_ = np.concatenate([np.full(n, o) for n, o, _ in runs])
    gaps = np.concatenate([np.r_[60.0 if gap else 0.0, np.zeros(n - 1)] for n, _, gap in runs])
    return open_, 100.0 + 0.02 * np.arange(len(open_)) + np.cumsum(gaps)


@settings(max_examples=60, deadline=None)
@given(RUNS)
def test_windows_are_whole_seconds_of_open_ticks_that_follow_each_other(runs):
    open_, t_s = columns(runs)
    windows = windows_of(open_, t_s, np.ones(len(open_), np.bool_))
    for k in range(windows.count):
        ticks = np.flatnonzero(windows.index == k)
        assert len(ticks) == WINDOW_TICKS
        assert (np.diff(ticks) == 1).all() and (np.diff(t_s[ticks]) < 0.03).all() and open_[ticks].all()
        assert np.isclose(windows.mean(t_s)[k], t_s[ticks].mean())
        assert windows.chunk[k] == (t_s[ticks].mean() - t_s[0]) // CHUNK_S
    assert windows.count == sum(n // WINDOW_TICKS for n in lengths(open_, t_s))


def lengths(open_, t_s):
    """Return how long each run of open ticks without a gap is."""
    found, last = [], None
    for now, o in zip(t_s.tolist(), open_.tolist(), strict=True):
        if o and last is not None and now - last < 0.03:
            found[-1] += 1
        elif o:
            found.append(1)
        last = now if o else None
    return found


def test_unusable_ticks_break_a_window():
    open_ = np.ones(120, np.bool_)
    usable = open_.copy()
    usable[60] = False
    windows = windows_of(open_, 0.02 * np.arange(120), usable)
    assert windows.count == 2
    assert np.flatnonzero(windows.index >= 0).tolist() == [*range(50), *range(61, 111)]


def test_a_window_ends_where_the_clock_was_set_back():
    open_ = np.ones(160, np.bool_)
    t_us = 20_000 * np.arange(160)
    t_us[80:] -= 3_600_000_000
    seconds = Run(SimpleNamespace(t_us=t_us), *4 * [None]).t_s
    windows = windows_of(open_, seconds, open_)
    assert np.flatnonzero(windows.index >= 0).tolist() == [*range(50), *range(80, 130)]
    assert windows.t_s.tolist() == pytest.approx([0.49, 2.07]) and windows.chunk.tolist() == [0, 0]


def test_no_open_tick_gives_no_window():
    windows = windows_of(np.zeros(300, np.bool_), 0.02 * np.arange(300), np.ones(300, np.bool_))
    assert windows.count == 0 and len(windows.mean(np.ones(300))) == 0
