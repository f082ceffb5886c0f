"""The closed-form Butterworth against scipy.signal."""

from __future__ import annotations

import runpy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from canest.core.errors import ConfigError
from canest.vehicle.butterworth import Filter, butterworth, delay_s

RATE_HZ = 50.0
PAPERS = Path(__file__).parents[2] / "benchmarks" / "papers"
order_and_cutoff = runpy.run_path(str(PAPERS / "closed_forms.py"))["order_and_cutoff"]


def sos(order: int, cutoff_hz: float) -> np.ndarray:
    return np.array([[s.b0, s.b1, s.b2, 1.0, s.a1, s.a2] for s in butterworth(order, cutoff_hz)])


@pytest.mark.parametrize("order", range(1, 7))
@pytest.mark.parametrize("cutoff_hz", [0.2, 1.0, 2.0, 5.0, 12.5, 20.0, 24.5])
def test_equals_scipy(order: int, cutoff_hz: float) -> None:
    x = np.cumsum(np.random.default_rng(order).standard_normal(500)) + 20.0
    theirs = signal.butter(order, cutoff_hz, fs=RATE_HZ, output="sos")
    start = signal.sosfilt_zi(theirs) * x[0]
    expected, _ = signal.sosfilt(theirs, x, zi=start)
    reset = np.zeros(len(x), bool)
    reset[0] = True
    ours = Filter(order, cutoff_hz).apply(x, reset)
    assert np.abs(ours - expected).max() < 1e-12 * np.abs(x).max() * (10 if cutoff_hz < 1 else 1)
    frequency = np.array([0.0, cutoff_hz, (cutoff_hz + 25) / 2])
    gain = np.abs(signal.sosfreqz(sos(order, cutoff_hz), frequency, fs=RATE_HZ)[1])
    assert gain[0] == pytest.approx(1, abs=1e-9)
    assert gain[1] == pytest.approx(0.5**0.5, rel=1e-9)
    assert gain[2] < gain[1]


def test_starts_settled_wherever_it_is_reset() -> None:
    x = np.repeat([3.0, 100.0, -7.0], 50)
    reset = np.zeros(150, bool)
    reset[[0, 50, 100]] = True
    assert np.allclose(Filter(4, 2.0).apply(x, reset), x, rtol=1e-12)


@settings(max_examples=50, deadline=None)
@given(
    order=st.integers(1, 6),
    cutoff_hz=st.floats(0.1, 24.9),
    cuts=st.lists(st.integers(0, 120), max_size=6),
    resets=st.sets(st.integers(0, 119), max_size=4),
    seed=st.integers(0, 99),
)
def test_any_cut(order: int, cutoff_hz: float, cuts: list[int], resets: set[int], seed: int) -> None:
    x = np.random.default_rng(seed).standard_normal(120)
    reset = np.isin(np.arange(120), sorted(resets))
    whole = Filter(order, cutoff_hz).apply(x, reset)
    pieces = Filter(order, cutoff_hz)
    edges = [0, *sorted(cuts), 120]
    joined = np.concatenate([pieces.apply(x[a:b], reset[a:b]) for a, b in pairwise(edges)])
    assert joined.tobytes() == whole.tobytes()


@pytest.mark.parametrize("cutoff_hz", [0.0, -1.0, 25.0, 30.0, float("nan")])
def test_a_cutoff_that_no_filter_has_is_refused(cutoff_hz: float) -> None:
    with pytest.raises(ConfigError, match=r"no digital Butterworth exists .* below 25 Hz"):
        butterworth(2, cutoff_hz)


@pytest.mark.parametrize(("pass_hz", "stop_hz"), [(1.0, 10.0), (2.0, 5.0), (0.5, 20.0), (5.0, 6.0)])
@pytest.mark.parametrize("stop_dB", [20.0, 40.0, 60.0])
def test_lowest_order_for_a_pass_and_a_stop_frequency(pass_hz: float, stop_hz: float, stop_dB: float) -> None:
    order, cutoff_hz = order_and_cutoff(pass_hz, stop_hz, pass_dB=1.0, stop_dB=stop_dB)
    assert order == signal.buttord(pass_hz, stop_hz, 1.0, stop_dB, fs=RATE_HZ)[0]
    gain = np.abs(signal.sosfreqz(sos(order, cutoff_hz), [pass_hz, stop_hz], fs=RATE_HZ)[1])
    assert 20 * np.log10(gain[0]) == pytest.approx(-1.0, abs=1e-9)
    assert 20 * np.log10(gain[1]) <= -stop_dB + 1e-9


def test_the_2013_papers_filter() -> None:
    order, cutoff_hz = order_and_cutoff(1.0, 10.0, stop_dB=60.0)
    assert order == 3
    assert cutoff_hz == pytest.approx(1.0, rel=2e-3)


@pytest.mark.parametrize(("order", "cutoff_hz"), [(1, 1.0), (2, 2.0), (3, 0.7), (5, 10.0)])
def test_the_delay_of_a_slow_signal_is_the_group_delay(order: int, cutoff_hz: float) -> None:
    b, a = signal.butter(order, cutoff_hz, fs=50.0)
    _, ticks = signal.group_delay((b, a), w=[0.0])
    assert delay_s(butterworth(order, cutoff_hz)) == pytest.approx(ticks[0] / 50.0, rel=1e-6)
