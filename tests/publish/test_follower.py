"""What a publisher makes of a live stream: an estimate of now, or none."""

from __future__ import annotations

import pytest

from canest.core.samples import Status
from canest.publish import follower as module
from canest.publish.follower import Follower
from canest.telemetry.live_protocol import COLUMNS

ROW = [1_700_000_000.0, 21_000.0, 200.0, 0.01, 0.001, int(Status.VALID), 0, 20.0, 500.0, 9, 10.0]


class Kept(Follower):
    """Keeps what it was given."""

    def __init__(self):
        super().__init__("a source")
        self.estimates = []
        self.take({"columns": COLUMNS})

    def on_estimate(self, estimate):
        self.estimates.append(estimate)


@pytest.fixture
def clock(monkeypatch):
    """Give the time in s as the only item of a list."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_without_an_estimate_of_now_there_is_none_though_other_frames_arrive(clock):
    follower = Kept()
    for clock[0], newest in ((100.0, ROW), (101.0, None), (101.9, None), (102.1, None), (103.0, ROW)):
        follower.take({"rows": [], "newest": newest, "quiet_s": 0.02})
    statuses = [e.status[1] for e in follower.estimates]
    assert statuses == ["valid", "not available", "valid"]
    assert set(follower.estimates[1].numbers.values()) == {None}


def test_a_quiet_bus_and_one_that_never_spoke_have_no_estimate(clock):
    for quiet_s in (None, 2.5):
        follower = Kept()
        follower.take({"rows": [], "newest": None, "quiet_s": quiet_s})
        assert [e.status[1] for e in follower.estimates] == ["not available"]
