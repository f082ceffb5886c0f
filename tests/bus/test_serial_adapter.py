"""A serial adapter (slcan), played by a pseudo terminal."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import struct
import termios
import time
import tty

import pytest

from canest.bus.link import open_link
from canest.config.bus import Bus
from tests.bus.wire import ID, settle
from tests.live.rig import wait_for

pytest.importorskip("serial")

FRAME = b"T18FEF10081122334455667788\r"
PATIENCE_S = 20.0


class Adapter:
    """The adapter's end of the cable; ``channel`` leads to whichever terminal it has now."""

    def __init__(self, folder):
        self.channel = folder / "ttyADAPTER"
        self._ends = []

    def plug(self):
        self.end, ours = pty.openpty()
        for end in (self.end, ours):
            tty.setraw(end)
        self._ends = [self.end, ours]
        self.channel.symlink_to(os.ttyname(ours))

    def unplug(self):
        for end in self._ends:
            os.close(end)
        self._ends = []
        self.channel.unlink(missing_ok=True)

    def sends(self, *lines):
        os.write(self.end, b"".join(lines))

    def received(self, last):
        """Return what has come, once it ends with ``last``: a terminal hands lines over in its own time."""
        os.set_blocking(self.end, False)
        read, end_s = b"", time.monotonic() + PATIENCE_S
        while not read.endswith(last) and time.monotonic() < end_s:
            with contextlib.suppress(BlockingIOError):
                read += os.read(self.end, 65536)
            time.sleep(0.005)
        return read

    def delivers(self, size):
        """Return whether so many bytes wait for the reader, as soon as they do."""
        waiting = struct.Struct("i")
        return wait_for(
            lambda: (
                waiting.unpack(fcntl.ioctl(self._ends[1], termios.FIONREAD, bytes(waiting.size)))[0] >= size
            )
        )


@pytest.fixture
def adapter(tmp_path):
    adapter = Adapter(tmp_path)
    adapter.plug()
    yield adapter
    adapter.unplug()


@contextlib.contextmanager
def opened(adapter, **options):
    bus = Bus(interface="slcan", channel=str(adapter.channel), options={"sleep_after_open": 0.0} | options)
    receiver, transmitter = open_link(bus, [(0, 0)], transmit=True)
    try:
        drain_until(receiver, "up")
        yield receiver, transmitter
    finally:
        receiver.close()


def drain_until(receiver, state):
    """Drain until the interface is in a state; return the longest time that took at once (s)."""
    longest_s, end_s = 0.0, time.monotonic() + PATIENCE_S
    while receiver.state != state:
        begin_s = time.monotonic()
        assert begin_s < end_s, f"{receiver.state} ({receiver.reason}), not {state}"
        receiver.drain()
        longest_s = max(longest_s, time.monotonic() - begin_s)
        time.sleep(0.005)
    return longest_s


@pytest.mark.parametrize(
    "line",
    [
        b"T18FEF1008112233445566zz88\r",
        b"T18FEFx0081122334455667788\r",
        b"T\xff\xfe\xf10081122334455667788\r",
        b"T18FEF1008112233\r",
        b"T18FEF10081122334\r",
        b"T18F\r",
        b"T\r",
        b"TF8FEF10081122334455667788\r",
        b"t-128aabbccddeeff0011\r",
    ],
    ids=["data", "identifier", "no-ascii", "short", "half-byte", "cut", "empty", "30-bits", "negative"],
)
def test_a_damaged_line_is_counted_and_the_next_one_read(adapter, line):
    with opened(adapter) as (receiver, _):
        adapter.sends(FRAME, line, FRAME)
        frames, _ = settle(receiver.drain, 2)
        assert [(f[1], f[2], f[3]) for f in frames] == [(ID, 8, 0x8877665544332211)] * 2
        assert receiver.counters == {"damaged_input": 1}
        assert (receiver.state, receiver.opened) == ("up", 1)


def test_a_buffer_full_of_damaged_lines_is_survived(adapter):
    with opened(adapter) as (receiver, _):
        adapter.sends(b"T\r" * 1000, FRAME)
        assert len(settle(receiver.drain, 1, PATIENCE_S)[0]) == 1
        assert receiver.counters == {"damaged_input": 1000} and receiver.opened == 1


def test_noise_that_never_ends_its_line_takes_no_memory(adapter):
    with opened(adapter) as (receiver, _):
        for _ in range(10):
            adapter.sends(b"0" * 600)
            receiver.drain()
        adapter.sends(b"\r", FRAME)
        assert len(settle(receiver.drain, 1)[0]) == 1
        assert receiver.counters["damaged_input"] >= 10 and receiver.opened == 1


def test_answers_of_an_adapter_do_not_hold_up_the_frames_behind_them(adapter):
    with opened(adapter) as (receiver, _):
        adapter.sends(b"z\r" * 100, FRAME)
        assert adapter.delivers(200 + len(FRAME))
        receiver.collect()
        assert len(receiver.drain().frames) == 1
        assert not receiver.counters


def test_an_adapter_that_was_unplugged_is_opened_again_when_it_is_back(adapter):
    with opened(adapter) as (receiver, _):
        adapter.unplug()
        assert drain_until(receiver, "absent") < 1.0
        assert receiver.counters["interface_lost"] == 1 and receiver.reason
        adapter.plug()
        assert drain_until(receiver, "up") < 1.0
        adapter.sends(FRAME)
        assert len(settle(receiver.drain, 1)[0]) == 1 and receiver.opened == 2


def test_an_adapter_that_takes_seconds_to_open_keeps_nobody_waiting(adapter):
    bus = Bus(interface="slcan", channel=str(adapter.channel), options={"sleep_after_open": 1.5})
    begin_s = time.monotonic()
    receiver, transmitter = open_link(bus, [(0, 0)], transmit=True)
    took_s = time.monotonic() - begin_s
    assert (receiver.state, receiver.reason) == ("absent", "being opened") and took_s < 1.0
    assert not transmitter.send(ID, b"x")
    assert drain_until(receiver, "up") < 1.0
    adapter.sends(FRAME)
    assert len(settle(receiver.drain, 1)[0]) == 1 and not receiver.reason
    receiver.close()


def test_an_adapter_closed_while_it_is_being_opened_is_let_go(adapter):
    bus = Bus(interface="slcan", channel=str(adapter.channel), options={"sleep_after_open": 0.8})
    receiver, _ = open_link(bus, [(0, 0)], transmit=False)
    begin_s = time.monotonic()
    receiver.close()
    assert time.monotonic() - begin_s < 0.7
    assert adapter.received(b"C\r") == b"O\rC\r"


def test_frames_go_out_as_lines(adapter):
    with opened(adapter) as (_, transmitter):
        assert transmitter.send(ID, bytes(range(8)))
        assert wait_for(lambda: transmitter.counters == {"sent": 1})
        line = b"T18FEF10080001020304050607\r"
        assert adapter.received(line).endswith(line)


def test_an_adapter_that_takes_no_more_frames_keeps_neither_the_loop_nor_the_end_waiting(adapter):
    with opened(adapter) as (receiver, transmitter):
        longest_s = 0.0
        for _ in range(5000):  # a terminal holds up to 64 kB
            begin_s = time.monotonic()
            transmitter.send(ID, bytes(8))
            longest_s = max(longest_s, time.monotonic() - begin_s)
        adapter.sends(FRAME)
        assert len(settle(receiver.drain, 1)[0]) == 1
        assert transmitter.counters["dropped_buffer_full"] > 0
        assert wait_for(lambda: transmitter.counters["dropped_send_failed"] > 0, 30.0)  # of a busy machine
        assert receiver.state == "up"
        begin_s = time.monotonic()
    assert time.monotonic() - begin_s < 1.0
    assert longest_s < 1.0
