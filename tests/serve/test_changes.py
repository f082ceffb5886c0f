"""What changed while nobody looked: each change once, with its time, and a bounded number of them."""

from __future__ import annotations

import time

from canest.serve.changes import MOST, Changes
from canest.serve.hub import Hub
from canest.telemetry.live_protocol import COLUMNS

NAMES = {"columns": COLUMNS, "gates": {"0": ""}, "statuses": ["unestimated", "converging", "valid", "n/a"]}


def texts(changes):
    return [change.text for change in changes.last]


def row(status):
    return [time.time(), *(0.0 for _ in COLUMNS[1:5]), status, *(0.0 for _ in COLUMNS[6:])]


def test_a_status_is_noted_when_it_changes_and_only_then():
    hub = Hub("the daemon")
    hub.take(NAMES)
    for status in (0, 0, 1, 2, 2, 2):
        hub.take({"rows": [], "newest": row(status), "quiet_s": 0.1})
    assert texts(hub.changes) == ["status unestimated", "status converging", "status valid"]
    assert abs(hub.changes.last[-1].t_s - time.time()) < 5


def test_a_source_that_goes_and_comes_back_is_noted_once_each_whatever_it_sends_meanwhile():
    hub = Hub("the daemon")
    hub.take(NAMES)
    for seconds in (1, 2, 3):
        hub.lose(f"the daemon has sent nothing for {seconds} s")
    hub.take(NAMES)
    assert texts(hub.changes) == ["no data: the daemon has sent nothing for 1 s", "the source answers"]


def test_bus_config_and_failures_of_a_snapshot():
    changes = Changes(lambda _: None)
    changes.of_snapshot({"bus": {"state": "up"}, "reload_refused_because": "", "failures": 0})
    assert not changes.last, "as it should be: no change"
    changes.of_snapshot({"bus": {"state": "down", "channel": "can0", "reason": "no such device"}})
    changes.of_snapshot({"bus": {"state": "up", "channel": "can0"}, "reload_refused_because": "line 3"})
    changes.of_snapshot({"bus": {"state": "up", "channel": "can0"}, "failures": 2})
    assert texts(changes) == [
        "bus can0 down: no such device", "bus can0 up", "config refused: line 3", "config in force",
        "2 errors inside the estimation were survived",
    ]  # fmt: skip


def test_a_quiet_bus_is_noted_and_its_end():
    changes = Changes(lambda _: None)
    for quiet_s in (0.1, 1.0, 2.5, 60.0, 0.0, None):
        changes.of_rows(None, quiet_s)
    assert texts(changes) == ["no frame on the bus", "frames on the bus"]


def test_a_status_that_flaps_for_a_day_keeps_the_last_hundred():
    noted = []
    changes = Changes(noted.append)
    for k in range(10_000):
        changes.of_rows(("valid", "converging")[k % 2], 0.0)
    assert len(noted) == 10_000 and len(changes.last) == MOST == 100
