"""The live stream: a watcher receives what was estimated, and costs the daemon nothing."""

from __future__ import annotations

import csv
import itertools
import json
import socket

import pytest

from canest.live.reporting import Reporter
from canest.system.files import Background
from canest.system.journal import Journal
from canest.system.systemd_notify import Notifier
from canest.telemetry.live_protocol import COLUMNS, stream_path
from canest.telemetry.live_stream import MOST_WATCHERS, LiveStream
from canest.telemetry.snapshot import snapshot
from canest.telemetry.status_socket import socket_path
from tests.live.rig import Rig, config


class Watcher:
    """A program that is connected to a stream; `messages` reads what has come."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(path))
        self.socket.setblocking(False)
        self._rest = b""

    def messages(self):
        data = self._rest
        while True:
            try:
                part = self.socket.recv(1 << 20)
            except BlockingIOError:
                break
            if not part:
                break
            data += part
        *lines, self._rest = data.split(b"\n")
        return [json.loads(line) for line in lines]

    @property
    def is_let_go(self):
        try:
            while part := self.socket.recv(1 << 20):
                assert part
        except BlockingIOError:
            return False
        return True

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


class Statuses:
    """A stream and its pages of status."""

    def __init__(self, tmp_path):
        self.stream = LiveStream(tmp_path / "live-can0.sock")

    def second(self):
        self.stream.poll(lambda: {"pid": 7})
        for _ in range(5):
            self.stream.send_rows([[0.0] * len(COLUMNS)] * 2, [0.0] * len(COLUMNS), 0.01)


@pytest.fixture
def statuses(tmp_path):
    statuses = Statuses(tmp_path)
    yield statuses
    statuses.stream.close()


def test_a_watcher_gets_ten_rows_a_second_that_equal_the_logged_estimates(tmp_path, drive, monkeypatch):
    log = tmp_path / "est.csv"
    settings = config(tmp_path, f"service.log_estimates={log}")
    with Rig(monkeypatch, settings, drive) as rig:
        rig.daemon.reporter.open(settings)
        rig.run(40)
        with Watcher(stream_path(socket_path(settings))) as watcher:
            rig.run(20)
            messages = watcher.messages()
            shown = snapshot(rig.daemon.view(rig.now_us))
    with log.open() as file:
        logged = {round(float(r["t_s"]), 2): r for r in csv.DictReader(file)}
    first = messages[0]
    assert first["columns"] == list(COLUMNS) and first["gates"]["6"] == "shift"
    rows = [dict(zip(COLUMNS, row, strict=True)) for m in messages for row in m.get("rows", ())]
    assert len(rows) == pytest.approx(190, abs=15)
    steps = [round(b["t_s"] - a["t_s"], 2) for a, b in itertools.pairwise(rows)]
    assert set(steps) == {0.1}
    for row in rows:
        written = logged[row["t_s"]]
        assert row["mass_kg"] == pytest.approx(float(written["mass_kg"]), abs=0.1)
        assert row["grade_std"] == pytest.approx(float(written["grade_std"]), abs=2e-6)
        assert first["gates"][str(row["gate"])] == written["gate"]
        assert first["statuses"][row["status"]] == written["status"]
    driven = [r for r in rows if r["gate"] == 0]
    assert driven and all(r["gear"] >= 1 and r["speed_mps"] > 1 for r in driven)
    assert max(abs(r["torque_Nm"]) for r in driven) > 300
    assert all((r["residual_N"] is None) == (r["gate"] != 0) for r in rows)
    newest = [m for m in messages if "newest" in m][-1]["newest"]
    assert newest[1] == pytest.approx(shown["estimate"]["mass_kg"], abs=0.1)
    assert sum("status" in m for m in messages) == pytest.approx(19, abs=2)


def test_rows_are_collected_only_while_somebody_watches(tmp_path, drive, monkeypatch):
    settings = config(tmp_path)
    with Rig(monkeypatch, settings, drive) as rig:
        rig.daemon.reporter.open(settings)
        live_rows = rig.daemon.reporter.live_rows
        rig.run(5)
        assert live_rows.newest is None
        with Watcher(stream_path(socket_path(settings))):
            rig.run(3)
            assert live_rows.newest is not None
        rig.run(3)
        assert not live_rows.wanted


def test_a_quiet_bus_shows_in_the_stream_at_once(tmp_path, drive, monkeypatch):
    settings = config(tmp_path)
    with Rig(monkeypatch, settings, drive) as rig, opened(rig, settings) as watcher:
        rig.run(10)
        rig.script.fall_silent()
        watcher.messages()
        rig.run(1.5)
        quiet = [m["quiet_s"] for m in watcher.messages() if "quiet_s" in m]
    assert quiet == sorted(quiet) and quiet[-1] > 1.2


def test_an_estimate_that_is_not_of_now_is_not_sent_again(tmp_path, drive, monkeypatch):
    settings = config(tmp_path)
    with Rig(monkeypatch, settings, drive) as rig, opened(rig, settings) as watcher:
        rig.run(10)
        assert [m for m in watcher.messages() if "newest" in m][-1]["newest"] is not None
        rig.script.fall_silent()
        rig.run(5)
        assert [m for m in watcher.messages() if "newest" in m][-1]["newest"] is None


def opened(rig, settings):
    rig.daemon.reporter.open(settings)
    return Watcher(stream_path(socket_path(settings)))


def test_a_watcher_that_reads_nothing_is_let_go_and_the_others_miss_nothing(statuses):
    with Watcher(statuses.stream.path) as idle, Watcher(statuses.stream.path) as reader:
        received = 0
        for _ in range(1000):
            statuses.second()
            received += len(reader.messages())
        assert received == 1000 * 6 + 1
        assert idle.is_let_go


def test_watchers_beyond_the_limit_are_refused_in_a_sentence(statuses):
    watchers = [Watcher(statuses.stream.path) for _ in range(MOST_WATCHERS)]
    statuses.second()
    with Watcher(statuses.stream.path) as late:
        statuses.second()
        assert late.messages() == [{"refused": "8 programs watch this daemon already"}]
        assert late.is_let_go
    for watcher in watchers:
        watcher.socket.close()
    statuses.second()
    statuses.second()
    with Watcher(statuses.stream.path) as next_one:
        statuses.second()
        assert "columns" in next_one.messages()[0]


def test_a_stream_that_cannot_be_opened_leaves_the_daemon_running(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("canest.telemetry.endpoints.LiveStream", refuse)
    log, background = tmp_path / "log", Background()
    with log.open("w") as file:
        reporter = Reporter(Journal(file), Notifier({}), background)
        reporter.open(config(tmp_path))
        reporter.stream(None, is_current=False)
        assert reporter.endpoints is not None and not reporter.endpoints.watched
        reporter.close()
    background.close(1.0)
    assert "no-live-socket" in log.read_text()
    assert not list(tmp_path.glob("live-*"))


def test_a_crowd_at_the_door_holds_nobody_up(statuses, monkeypatch):
    accepted = []

    class Door:
        def accept(self):
            accepted.append(1)
            assert len(accepted) <= MOST_WATCHERS
            raise_after = socket.socketpair()
            raise_after[1].close()
            return raise_after[0], None

        def close(self):
            pass

    statuses.stream._socket.close()
    statuses.stream._socket = Door()
    statuses.stream.poll(lambda: {"pid": 7})
    assert len(accepted) == MOST_WATCHERS
