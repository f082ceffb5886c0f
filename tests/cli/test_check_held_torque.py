"""A torque that somebody repeats, or whose range ends where the engine's does not."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import load_config
from canest.doctor.held_torque import HeldTorqueCheck

T_US = 1_700_000_000_000_000 + np.arange(0, 300_000_000, 20_000)


def hints(torque_pct, t_us=T_US, *, changes=(), block=997):
    check = HeldTorqueCheck(load_config("class8", list(changes)))
    for begin in range(0, len(t_us), block):
        part = slice(begin, begin + block)
        check.push({"engine_torque_pct": (t_us[part], torque_pct[part])})
    return check.hints()


def driven(seed=1):
    """Whole percents, as an engine reports them, that a driver moves; the highest is not a limit."""
    rng = np.random.default_rng(seed)
    course = 45.0 + 30.0 * np.sin(T_US * 1e-6 / 3.0) + 15.0 * np.sin(T_US * 1e-6 / 0.7)
    return np.round(course + rng.normal(0.0, 0.5, len(T_US)))


def held(values, seconds, phase=7):
    every = round(seconds * 50)
    return values[np.maximum((np.arange(len(values)) - phase) // every * every + phase, 0)]


@pytest.mark.parametrize("seconds", [0.5, 1.0, 1.6])
def test_a_torque_that_is_repeated_is_named_with_its_period(seconds):
    (hint,) = hints(held(driven(), seconds))
    assert f"never changes within {seconds:.2g} s" in hint
    assert f"period_s: {seconds:.2g} " in hint


def test_a_torque_that_is_renewed_too_seldom_has_no_period():
    (hint,) = hints(held(driven(), 4.0))
    assert "Expected every" in hint


@pytest.mark.parametrize("seconds", [0.02, 0.1, 0.2])
def test_a_torque_that_is_renewed_is_right(seconds):
    assert not hints(held(driven(), seconds))


def test_a_torque_that_comes_as_seldom_as_it_changes_is_not_repeated():
    assert not hints(driven()[::50], T_US[::50])


def test_a_stated_period_is_named_no_more():
    values = held(driven(), 1.0)
    assert hints(values)
    assert not hints(values, changes=["signals.engine_torque_pct.period_s=1.0"])


def test_a_constant_torque_is_none_that_is_repeated():
    assert not hints(np.full(len(T_US), 40.0) + (T_US[9000] < T_US))


def test_a_torque_whose_range_ends_is_named():
    (hint,) = hints(np.minimum(driven(), 50.0))
    assert "exactly 50, its largest value" in hint


def test_an_engine_at_full_load_is_no_range_that_ends():
    assert not hints(np.minimum(2.0 * driven(), 100.0))
    assert not hints(driven())


def test_however_blocks_are_cut_the_hints_are_the_same():
    values = held(np.minimum(driven(), 50.0), 1.0)
    assert hints(values) == hints(values, block=10) == hints(values, block=10**6)
