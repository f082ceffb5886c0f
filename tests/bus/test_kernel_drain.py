"""The kernel drain, on a UDP socket."""

from __future__ import annotations

import errno
import gc
import select
import socket
import time
import weakref

import pytest

from canest.bus.kernel_drain import KernelDrain, enable_timestamps
from tests.bus.wire import ID, packed, settle


@pytest.fixture
def loopback():
    """A socket that datagrams of CAN frames arrive at, and one that sends them."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inlet,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet,
    ):
        inlet.bind(("127.0.0.1", 0))
        enable_timestamps(inlet)
        outlet.connect(inlet.getsockname())
        yield inlet, outlet


def test_drained_frames_are_what_was_sent_with_kernel_stamps(loopback):
    inlet, outlet = loopback
    before_us = time.time_ns() // 1000
    for k in range(10):
        outlet.send(packed(ID + k, bytes(range(k % 9))))
    frames, last = settle(KernelDrain(inlet).drain, 10)
    after_us = time.time_ns() // 1000
    assert [f[1:] for f in frames] == [
        (ID + k, k % 9, int.from_bytes(bytes(range(k % 9)), "little")) for k in range(10)
    ]
    stamps = [f[0] for f in frames]
    assert stamps == sorted(stamps) and before_us - 1000 <= stamps[0] and stamps[-1] <= after_us + 1000
    assert last.reached_us is not None


def test_bytes_behind_the_sent_length_are_zero_whatever_the_sender_left_there(loopback):
    inlet, outlet = loopback
    outlet.send(packed(ID, b"\xaa" * 8, length=3))
    [(_, _, length, data)], _ = settle(KernelDrain(inlet).drain, 1)
    assert (length, data) == (3, 0xAAAAAA)


def test_datagrams_that_are_no_whole_frame_are_left_out(loopback):
    inlet, outlet = loopback
    outlet.send(b"\x01\x02")
    outlet.send(packed(ID))
    frames, _ = settle(KernelDrain(inlet).drain, 1)
    assert [f[1] for f in frames] == [ID]


def test_nothing_to_read_returns_at_once_with_the_time(loopback):
    drain = KernelDrain(loopback[0])
    begin = time.monotonic()
    drained = drain.drain()
    assert time.monotonic() - begin < 0.1
    assert len(drained.frames) == 0 and drained.reached_us is not None


def test_an_overflowing_buffer_is_counted_by_the_kernel(loopback):
    inlet, outlet = loopback
    inlet.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
    for _ in range(500):
        outlet.send(packed())
    time.sleep(0.05)
    drain = KernelDrain(inlet)
    first = drain.drain()
    outlet.send(packed())
    _, last = settle(drain.drain, 1)
    assert len(first.frames) + last.drops == 500


def test_collecting_empties_the_socket_and_draining_hands_everything_out_in_order(loopback):
    inlet, outlet = loopback
    drain = KernelDrain(inlet)
    for k in range(30):
        outlet.send(packed(ID + k))
        if k % 10 == 9:
            time.sleep(0.01)
            assert drain.collect() is True
    with pytest.raises(BlockingIOError):
        inlet.recv(16, socket.MSG_DONTWAIT)
    assert drain.drain().frames.can_id.tolist() == [ID + k for k in range(30)]
    assert len(drain.drain().frames) == 0


def test_a_flood_ends_the_drain_and_no_promise_about_time_is_made(loopback):
    inlet, outlet = loopback
    drain = KernelDrain(inlet, slots=32)
    for _ in range(42):
        outlet.send(packed())
    time.sleep(0.05)
    assert drain.collect() is False
    drained = drain.drain()
    assert len(drained.frames) == 32 and drained.reached_us is None
    last = drain.drain()
    assert len(last.frames) == 10 and last.reached_us is not None


def fail(sock):
    """Let the next call on a UDP socket fail: what it sends is refused."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind(("127.0.0.1", 0))
        address = closed.getsockname()
    sock.connect(address)
    sock.send(b"")
    poll = select.poll()
    poll.register(sock, 0)
    assert poll.poll(2000), "nothing was refused"


def test_frames_that_came_before_a_socket_error_are_handed_out_before_it(loopback):
    inlet, outlet = loopback
    drain = KernelDrain(inlet)
    outlet.send(packed())
    time.sleep(0.02)
    drain.collect()
    fail(inlet)
    assert len(drain.drain().frames) == 1
    with pytest.raises(OSError, match="refused"):
        drain.drain()
    assert len(drain.drain().frames) == 0


@pytest.fixture
def no_collector():
    """As in the daemon, whose loop allocates too little for the collector to run often."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("no_collector")
def test_the_buffers_of_a_drain_whose_socket_failed_are_freed_at_once(loopback):
    drain = KernelDrain(loopback[0])
    alive = weakref.ref(drain)
    fail(loopback[0])
    try:
        drain.drain()
    except OSError as error:
        assert error.errno == errno.ECONNREFUSED
    del drain
    assert alive() is None


@pytest.mark.usefixtures("no_collector")
def test_a_drain_leaves_nothing_for_the_collector(loopback):
    KernelDrain(loopback[0])  # what is made once
    gc.collect()
    for _ in range(10):
        KernelDrain(loopback[0])
    assert gc.collect() == 0
