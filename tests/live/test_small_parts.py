"""Notifications, log lines, metrics, the schedule, the sparkline: each against its written definition."""

from __future__ import annotations

import contextlib
import fcntl
import io
import math
import os
import re
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canest.core.errors import UsageError
from canest.live.schedule import STEP_NS, Schedule
from canest.system.journal import BURST, REFILL_S, Journal
from canest.system.systemd_notify import Notifier
from canest.telemetry.broadcast_view import BLOCKS, LiveView, sparkline
from canest.telemetry.status_socket import StatusServer, read_status
from tests.live.rig import Rig, config


@pytest.fixture
def supervisor(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "notify"))
        sock.settimeout(1)
        yield sock, {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "10000000"}


def messages(sock):
    sock.setblocking(False)
    found = []
    while True:
        try:
            found.append(sock.recv(4096).decode())
        except BlockingIOError:
            return found


def test_systemd_is_notified_of_every_step_of_a_life(supervisor):
    sock, environment = supervisor
    notifier = Notifier(environment)
    notifier.ready()
    notifier.status("valid: 20 t")
    notifier.status("valid: 20 t")
    notifier.reloading()
    notifier.stopping()
    notifier.close()
    received = messages(sock)
    assert received[:2] == ["READY=1", "STATUS=valid: 20 t"]
    assert re.fullmatch(r"RELOADING=1\nMONOTONIC_USEC=\d+", received[2])
    assert received[3:] == ["STOPPING=1"]


def test_the_watchdog_is_pinged_at_half_its_deadline_and_only_when_called(supervisor):
    sock, environment = supervisor
    notifier = Notifier(environment)
    assert notifier.watchdog_s == 10.0
    for tick in range(int(30 / 0.02)):
        notifier.ping_watchdog(100.0 + tick * 0.02)
    notifier.close()
    assert messages(sock) == ["WATCHDOG=1"] * 6


def test_a_watchdog_meant_for_another_process_is_not_ours():
    assert Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid() + 1)}).watchdog_s is None
    assert Notifier({"WATCHDOG_USEC": "nonsense"}).watchdog_s is None


def test_without_systemd_or_with_a_dead_one_nothing_happens(tmp_path):
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone")}):
        notifier = Notifier(environment)
        notifier.ready()
        notifier.close()


def test_an_abstract_notify_socket_is_understood():
    name = f"canest-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind("\0" + name)
        notifier = Notifier({"NOTIFY_SOCKET": "@" + name})
        notifier.ready()
        notifier.close()
        assert sock.recv(100) == b"READY=1"


def journal(environment=None):
    stream, clock = io.StringIO(), [0.0]
    return Journal(stream, environment or {"JOURNAL_STREAM": "8:1"}, lambda: clock[0]), stream, clock


def test_lines_carry_journald_priorities_and_quoted_values():
    log, stream, _ = journal()
    log.warning("bus", now="down for good", count=3, share=0.123456789)
    log.error("disk")
    assert stream.getvalue() == '<4>bus now="down for good" count=3 share=0.123457\n<3>disk\n'


def test_a_line_stays_one_line_whatever_is_in_it():
    log, stream, _ = journal()
    log.notice("event", text="two\nlines\x1b[31m")
    assert stream.getvalue().count("\n") == 1 and "\x1b" not in stream.getvalue()


def test_a_storm_of_one_event_is_held_back_and_counted_while_others_pass():
    log, stream, clock = journal()
    for _ in range(1000):
        log.warning("storm")
    log.notice("other")
    lines = stream.getvalue().splitlines()
    assert lines.count("<4>storm") == BURST and lines[-1] == "<5>other"
    clock[0] += REFILL_S
    log.warning("storm")
    assert stream.getvalue().splitlines()[-1] == f"<4>storm held_back={1000 - BURST}"


def test_a_closed_stderr_does_not_end_the_daemon():
    log, stream, _ = journal()
    stream.close()
    log.error("nobody reads this")


def test_a_stderr_that_nobody_reads_is_not_waited_for():
    read, write = os.pipe()
    fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, 8192)
    with open(read, "rb") as reader, open(write, "w") as stream:  # noqa: PTH123 - descriptors, no paths
        log = Journal(stream, {"JOURNAL_STREAM": "1"}, lambda: 0.0)
        stop = threading.Timer(2.0, reader.close)  # who waits learns that there is nobody
        stop.start()
        for number in range(20):
            log.notice(f"event-{number}", text="x" * 2500)
        log.notice("event-0")
        stop.cancel()
        held_back = 20 - sum(b"event" in line for line in os.read(read, 100_000).splitlines())
        assert held_back > 10
        log.notice("event-19")
        log.notice("other")
        assert os.read(read, 100_000) == b"\n<5>event-19 held_back=1\n<5>other\n"


def test_outside_systemd_lines_are_for_people():
    log, stream, _ = journal({"TERM": "xterm"})
    log.notice("started", config="truck")
    assert re.fullmatch(r"\d\d:\d\d:\d\d notice: started config=truck\n", stream.getvalue())


class FakeTime:
    def __init__(self):
        self.now_ns = 10**12
        self.overslept_ns = 0

    def clock(self):
        return self.now_ns

    def sleep(self, s):
        self.now_ns += round(s * 1e9) + self.overslept_ns


def test_the_beat_does_not_drift_when_every_sleep_is_late():
    fake = FakeTime()
    schedule = Schedule(fake.clock, fake.sleep)
    begin, fake.overslept_ns = fake.now_ns, 300_000
    for _ in range(1000):
        schedule.wait()
        fake.now_ns += 5_000_000
    assert abs(fake.now_ns - begin - 1000 * STEP_NS) < STEP_NS
    assert schedule.missed == 0
    assert schedule.share_within(0.5) == 1.0 and schedule.share_within(0.1) == 0.0


def test_a_long_stop_is_skipped_not_caught_up():
    fake = FakeTime()
    schedule = Schedule(fake.clock, fake.sleep)
    schedule.wait()
    fake.now_ns += 60 * 10**9
    schedule.wait()
    assert schedule.missed == 60 * 50 - 1
    before = fake.now_ns
    schedule.wait()
    assert 0 < fake.now_ns - before <= STEP_NS
    assert schedule.ticks == 3


@given(due_us=st.integers(-50_000, 500_000), longest_us=st.integers(0, 400_000))
def test_the_beat_waited_for_is_the_first_at_which_something_is_due(due_us, longest_us):
    fake = FakeTime()
    schedule = Schedule(fake.clock, fake.sleep)
    begin_us = fake.now_ns // 1000
    woke_us = schedule.wait(schedule.ticks_until(begin_us + due_us, longest_us)) // 1000 - begin_us
    beats = range(20_000, 600_000, 20_000)
    expected = next(b for b in beats if b >= due_us)
    assert woke_us == max(20_000, min(expected, longest_us // 20_000 * 20_000))
    assert schedule.missed == 0 and schedule.ticks == 1


@given(st.lists(st.floats(-1e9, 1e9) | st.just(math.nan), max_size=40))
def test_a_sparkline_has_one_character_per_value_and_never_fails(values):
    line = sparkline(values)
    assert len(line) == len(values)
    assert all((c == " ") == math.isnan(v) for c, v in zip(line, values, strict=True))


def test_a_sparkline_spans_its_range():
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7]) == BLOCKS
    assert sparkline([5, 5]) == BLOCKS[4] * 2


def test_the_view_shows_estimates_and_counts_what_is_lost_or_damaged():
    from rich.console import Console

    from canest.decode import j1939
    from canest.node.estimate_frame import Estimate, encode

    can_id, view = j1939.pack(0xFF5A, 0x9E), LiveView(0xFF5A, "test")
    good = Estimate(21_346.0, 150.0, 0.031, 0.002, 2, 0)
    for counter in (14, 15, 0, 3):
        assert view.take(can_id, encode(good, counter, can_id), 1.0)
    assert not view.take(can_id, bytes(8), 1.0)
    assert not view.take(j1939.pack(0xFF10, 0x9E), bytes(8), 1.0)
    assert view.counters == {"frames": 4, "lost": 2, "damaged": 1}

    def shown(now_s):
        console = Console(file=io.StringIO(), width=110)
        console.print(view.render(now_s))
        return console.file.getvalue()

    assert "21,346 kg" in shown(1.0) and "+3.10 %" in shown(1.0) and "valid" in shown(1.0)
    assert "no broadcast for 9 s" in shown(10.0)


def test_the_view_says_what_is_wrong_with_the_bus():
    """A daemon is not to blame for silence where the bus cannot be opened."""
    view = LiveView(0xFF5A, "test")
    assert "is a canest broadcasting" in view.line(0.0)
    view.bus_fault = "absent: [Errno 19] no such device"
    assert "the bus is absent: [Errno 19] no such device" in view.line(0.0)


def test_a_bracket_in_a_name_is_no_markup(tmp_path, monkeypatch, capsys):
    from rich.console import Console

    from canest.telemetry.snapshot import snapshot
    from canest.telemetry.status_view import show

    console = Console(file=io.StringIO(), width=110)
    console.print(LiveView(0xFF5A, "canest on virtual:[/]").render(0.0))
    assert "canest on virtual:[/]" in console.file.getvalue()
    with Rig(monkeypatch, config(tmp_path, "vehicle.name='truck [/7]'")) as rig:
        show(snapshot(rig.daemon.view(rig.now_us)))
    assert "truck [/7] on vcan0" in capsys.readouterr().out


def test_a_second_daemon_does_not_take_the_first_ones_name(tmp_path):
    path = tmp_path / "status-can0.sock"
    first = StatusServer(path)
    with pytest.raises(UsageError, match="running already"):
        StatusServer(path)
    first.poll(dict)  # what knocked and went away
    assert path.exists()
    first.close()
    assert not path.exists()


def test_a_daemon_is_there_however_many_ask_at_once(tmp_path):
    path = tmp_path / "status-can0.sock"
    first = StatusServer(path)
    with contextlib.ExitStack() as waiting:
        with contextlib.suppress(BlockingIOError):  # until there is no room for one more
            while True:
                client = waiting.enter_context(socket.socket(socket.AF_UNIX))
                client.settimeout(0.1)
                client.connect(str(path))
        with pytest.raises(UsageError, match="running already"):
            StatusServer(path)
        with ThreadPoolExecutor() as pool:
            answer = pool.submit(read_status, path)
            while not answer.done():
                first.poll(lambda: {"pid": 7})
                time.sleep(0.1)
            assert answer.result() == {"pid": 7}
    first.close()


def test_a_name_left_by_a_killed_daemon_is_taken_over_and_only_ones_own_is_removed(tmp_path):
    path = tmp_path / "status-can0.sock"
    killed = StatusServer(path)
    killed.close(keep_name=True)  # as the kernel does
    second = StatusServer(path)
    killed.close()
    assert path.exists()
    second.close()
    assert not path.exists()
