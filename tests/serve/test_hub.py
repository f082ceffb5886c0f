"""What the hub hands to open pages: to a slow one what is of now, to all of them that names have changed."""

from __future__ import annotations

import json
import time

import pytest

from canest.serve.hub import LATE_S, STUCK_S, Hub, Page
from canest.system.clock import elapsed_s
from canest.telemetry.live_protocol import COLUMNS

NAMES = {"columns": list(COLUMNS), "gates": {"0": ""}, "statuses": ["unestimated", "converging", "valid"]}


class Transport:
    """What a page reads from. reads: whether it does."""

    def __init__(self):
        self.reads, self.waiting, self.aborted = True, 0, False
        self.events = []

    def get_write_buffer_size(self):
        return self.waiting

    def write(self, data):
        self.events.append(data)
        self.waiting += 0 if self.reads else len(data)

    def abort(self):
        self.aborted = True

    def kinds(self):
        return [event.split(b"event: ")[1].split(b"\n")[0].decode() for event in self.events]


@pytest.fixture
def transport():
    return Transport()


@pytest.fixture
def hub(transport):
    hub = Hub("the daemon")
    hub.take(NAMES)
    hub.join(Page(transport))
    transport.events.clear()
    return hub


def rows():
    row = [time.time(), *(0.0 for _ in COLUMNS[1:])]
    return {"rows": [row], "newest": row, "quiet_s": 0.0}


def test_a_page_that_does_not_read_misses_rows_and_is_told_what_it_needs(transport):
    page, now_s = Page(transport), elapsed_s()
    transport.reads = False
    page.send(b"event: rows\n1", now_s, needed=False)
    page.send(b"event: rows\n2", now_s + LATE_S / 2, needed=False)
    page.send(b"event: rows\n3", now_s + 2 * LATE_S, needed=False)
    page.send(b"event: source\n", now_s + 2 * LATE_S, needed=True)
    assert transport.events == [b"event: rows\n1", b"event: rows\n2", b"event: source\n"]
    transport.waiting = 0
    page.send(b"event: rows\n4", now_s + 3 * LATE_S, needed=False)
    assert transport.events[-1] == b"event: rows\n4"
    assert not transport.aborted


def test_a_page_that_does_not_read_at_all_is_closed(transport):
    page, now_s = Page(transport), elapsed_s()
    transport.reads = False
    page.send(b"event: rows\n", now_s, needed=False)
    page.send(b"event: rows\n", now_s + STUCK_S - 1, needed=False)
    assert not transport.aborted
    page.send(b"event: rows\n", now_s + STUCK_S + 1, needed=False)
    assert transport.aborted


def test_events_have_the_time_they_were_sent_at_of_a_clock_that_nobody_sets(hub, transport):
    before_s = elapsed_s()
    hub.take(rows())
    sent_s = float(transport.events[-1].split(b"id: ")[1].split(b"\n")[0])
    assert before_s - 0.001 <= sent_s <= elapsed_s() + 0.001


@pytest.mark.parametrize(
    "changed",
    [
        {"columns": ["t_s", "speed_mps", *(name for name in COLUMNS[1:] if name != "speed_mps")]},
        {"gates": {"0": "", "1": "another"}},
        {"statuses": ["none", "valid"]},
    ],
)
def test_open_pages_are_told_when_a_daemon_has_other_names_and_old_rows_go(hub, transport, changed):
    hub.take(rows())
    hub.take(NAMES)
    assert "reset" not in transport.kinds()
    assert len(hub.history.recent) == 1
    hub.take(NAMES | changed)
    assert transport.kinds()[-1] == "reset"
    assert not hub.history.recent


def test_an_event_is_json_behind_its_kind(hub, transport):
    hub.lose("it is gone")
    assert transport.kinds() == ["change", "source"]
    content = json.loads(transport.events[-1].split(b"data: ")[1])
    assert content["problem"] == "it is gone"
