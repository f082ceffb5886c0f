"""What the server keeps: ten minutes of rows, a day of ranges, however long it runs."""

from __future__ import annotations

import pytest

from canest.serve.history import BUCKET_S, DAY_S, RANGED, RECENT_S, History, WallClock
from canest.telemetry.live_protocol import COLUMNS

START_S = 1_795_000_020.0  #: a full minute


def row(t_s, **values):
    return [t_s, *(values.get(name, 0.0) for name in COLUMNS[1:])]


def of_day(history, name):
    at = 2 + 2 * RANGED.index(name)
    return [tuple(bucket[at : at + 2]) for bucket in history.day()]


@pytest.fixture
def history():
    return History(COLUMNS)


def test_rows_older_than_ten_minutes_go(history):
    for k in range(7000):
        history.add(row(START_S + k / 10))
    times = [r[0] for r in history.recent]
    assert times[-1] == START_S + 699.9
    assert times[-1] - times[0] == pytest.approx(RECENT_S, abs=0.11)


def test_a_minute_keeps_its_extremes_and_its_open_share(history):
    for k in range(1200):
        at_peak = k in (300, 301)
        history.add(row(START_S + k / 10, mass_kg=20_000.0 + 500 * at_peak, gate=6 if k < 150 else 0))
    assert of_day(history, "mass_kg") == [(20_000.0, 20_500.0), (20_000.0, 20_000.0)]
    assert [bucket[:2] for bucket in history.day()] == [[START_S, 0.75], [START_S + BUCKET_S, 1.0]]


def test_eight_hours_a_day_and_a_week_keep_no_more_than_a_day(history):
    for k in range(7 * 24 * 60 * 6):
        history.add(row(START_S + 10.0 * k))
    day = history.day()
    assert len(day) <= DAY_S / BUCKET_S + 1
    assert day[-1][0] - day[0][0] <= DAY_S
    assert len(history.recent) <= 61


def test_a_source_that_sends_without_end_in_no_time_cannot_fill_the_memory(history):
    for k in range(30_000):
        history.add(row(START_S + k * 1e-4))
    assert len(history.recent) == 12_000


def test_a_clock_that_is_set_back_overwrites_what_it_repeats(history):
    for k in range(100):
        history.add(row(START_S + k))
    history.add(row(START_S + 50, mass_kg=7.0))
    times = [r[0] for r in history.recent]
    assert times == sorted(set(times)) and times[-1] == START_S + 50
    assert len({bucket[0] for bucket in history.day()}) == len(history.day())


def test_values_that_are_missing_leave_the_ranges_alone(history):
    history.add(row(START_S, mass_kg=None))
    assert of_day(history, "mass_kg") == [(None, None)]
    history.add(row(START_S + 1, mass_kg=9.0))
    history.add(row(START_S + 2, mass_kg=None))
    assert of_day(history, "mass_kg") == [(9.0, 9.0)]


def test_a_bus_in_step_with_utc_keeps_its_stamps_and_another_is_shifted_as_a_whole():
    clock = WallClock()
    assert [clock.utc_s(100.0, 100.2, 100.4), clock.utc_s(100.1, 100.2, 100.3)] == [100.0, 100.1]
    other = WallClock()
    first = other.utc_s(5.0, 5.2, 1000.2)
    assert first == 1000.0
    assert other.utc_s(5.1, 5.4, 1000.5) == 1000.1  # what jitters is the arrival, not the bus
    assert other.utc_s(9.0, 9.0, 2000.0) == 2000.0  # a clock that was set
