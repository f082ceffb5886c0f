"""A SocketCAN interface that comes and goes."""

from __future__ import annotations

import errno
import socket
import time

import pytest

from canest.bus.kernel_drain import SLOTS, KernelDrain, enable_timestamps
from canest.bus.socketcan import SocketCanReceiver, SocketCanTransmitter
from canest.core.errors import BusError
from canest.core.frames import ERROR
from canest.core.samples import STEP_US
from tests.bus.wire import ID, packed, settle


class FaultySocket(socket.socket):
    """A socket that sends into nothing, or fails with an error number."""

    error = 0

    def send(self, frame):
        if self.error:
            raise OSError(self.error, "no")


class FaultyDrain:
    """A drain that works until it is given an error number."""

    error = 0

    def __init__(self, drain):
        self.collect, self.intact = drain.collect, drain

    def drain(self):
        if self.error:
            raise OSError(self.error, "failed")
        return self.intact.drain()


class Interface(SocketCanReceiver):
    """A SocketCAN interface played by UDP: it has an index, is up or down, and can vanish."""

    index, up, slots = 1, True, SLOTS

    def open_socket(self):
        if self.index is None:
            raise OSError(errno.ENODEV, "No such device")
        self.inlet = FaultySocket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.inlet.bind(("127.0.0.1", 0))
        enable_timestamps(self.inlet)
        return self.inlet

    def open_drain(self, sock):
        self.faulty = FaultyDrain(KernelDrain(sock, slots=self.slots))
        return self.faulty

    def interface_index(self):
        return self.index

    def interface_is_up(self):
        return self.up

    def bus_sends(self, *frames):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet:
            for frame in frames:
                outlet.sendto(frame, self.inlet.getsockname())


@pytest.fixture
def interface():
    receiver = Interface("can0", [(ID, 0xFFFF_FFFF)])
    yield receiver
    receiver.close()


def test_an_interface_that_is_absent_is_waited_for():
    Interface.index = None
    try:
        receiver = Interface("can0", [])
        assert receiver.state == "absent" and receiver.opened == 0
        assert receiver.reason == "No such device"
        assert receiver.drain().reached_us is not None
        receiver.index = 5
        time.sleep(0.03)
        receiver.drain()
        assert receiver.state == "up" and receiver.opened == 1 and not receiver.reason
        receiver.close()
    finally:
        Interface.index = 1


def test_an_interface_is_left_alone_for_half_of_what_its_buffers_hold(interface):
    granted = interface.inlet.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    frames = min(granted // 1024, SLOTS)
    assert interface.max_poll_interval_us == pytest.approx(frames / 4000 / 2 * 1e6, abs=1)
    interface.index = None
    time.sleep(0.55)
    interface.drain()
    assert interface.state == "absent" and interface.max_poll_interval_us == STEP_US


def test_an_interface_is_not_left_alone_while_frames_wait_in_it(monkeypatch):
    monkeypatch.setattr(Interface, "slots", 32)
    interface = Interface("can0", [(ID, 0xFFFF_FFFF)])
    max_poll_interval_us = interface.max_poll_interval_us
    interface.bus_sends(*[packed()] * 42)
    time.sleep(0.05)
    assert len(interface.drain().frames) == 32
    assert interface.max_poll_interval_us == STEP_US
    assert len(interface.drain().frames) == 10
    assert interface.max_poll_interval_us == max_poll_interval_us
    interface.close()


def test_an_interface_deleted_and_created_again_is_opened_within_a_tick_or_two(interface):
    interface.bus_sends(packed())
    assert len(settle(interface.drain, 1)[0]) == 1
    interface.index = None
    interface.faulty.error = errno.ENODEV
    assert len(interface.drain().frames) == 0
    assert interface.state == "absent"
    interface.index = 2
    time.sleep(0.025)
    interface.drain()
    assert interface.state == "up" and interface.opened == 2
    assert interface.counters["interface_lost"] == 1 and interface.counters["receive_enodev"] == 1
    interface.bus_sends(packed())
    assert len(settle(interface.drain, 1)[0]) == 1


def test_an_interface_replaced_behind_our_back_is_noticed_by_its_index(interface):
    interface.index = 7  # no error on the socket: a socket that receives nothing would go unnoticed for ever
    end = time.monotonic() + 2
    while interface.opened < 2 and time.monotonic() < end:
        interface.drain()
        time.sleep(0.02)
    assert interface.opened == 2 and interface.state == "up"


def test_an_interface_that_goes_down_keeps_its_socket_and_comes_back(interface):
    interface.up = False
    interface.faulty.error = errno.ENETDOWN
    interface.drain()
    assert interface.state == "down" and interface.opened == 1
    interface.faulty.error = 0
    interface.up = True
    time.sleep(0.025)
    interface.drain()
    assert interface.state == "up" and interface.opened == 1


def test_an_error_that_only_the_sender_got_is_reported(interface):
    """A socket hands an error to whoever calls first; a link that is down must not pass for up."""
    interface.drain()
    interface.up = False
    interface.inlet.error = errno.ENETDOWN
    SocketCanTransmitter(interface).send(ID, bytes(8))
    interface.drain()
    assert interface.state == "down"
    interface.up = True
    time.sleep(0.025)
    interface.drain()
    assert interface.state == "up" and interface.opened == 1


@pytest.mark.parametrize("state", ["up", "bus-off", "error-passive"])
def test_a_link_set_down_without_any_error_is_noticed(interface, state):
    interface.state, interface.up = state, False
    interface.request_check()
    interface.drain()
    assert interface.state == "down"


def test_an_unknown_socket_error_leads_to_a_new_socket(interface):
    interface.faulty.error = errno.EBADF
    interface.drain()
    interface.drain()
    assert interface.state == "up" and interface.opened == 2


def test_error_frames_give_the_controllers_state(interface):
    def error(kind, detail=0):
        return packed(ERROR | kind, bytes([0, detail] + [0] * 6))

    states = []
    for frame in (
        error(0x4, 0x10),
        error(0x40),
        error(0x100),
        error(0x4, 0x20),
        error(0x4, 0x40),
        error(0x1),
    ):
        interface.bus_sends(frame)
        settle(interface.drain, 1)
        states.append(interface.state)
    assert states == ["error-passive", "bus-off", "up", "error-passive", "up", "up"]
    assert interface.counters["bus_off"] == 1 and interface.counters["error_passive"] == 2
    assert interface.counters["bus_restarted"] == 2 and interface.counters["other_error_frames"] == 1
    for detail, state in ((0x20, "error-passive"), (0x08, "up")):  # fewer errors, before it is error-active
        interface.bus_sends(error(0x4, detail))
        settle(interface.drain, 1)
        assert interface.state == state


def test_traffic_after_bus_off_means_it_is_over(interface):
    interface.bus_sends(packed(ERROR | 0x40))
    settle(interface.drain, 1)
    interface.bus_sends(packed())
    settle(interface.drain, 1)
    assert interface.state == "up"


def test_a_kernel_without_socketcan_is_one_plain_error(monkeypatch):
    class NoCan(Interface):
        def open_socket(self):
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    with pytest.raises(BusError, match="no SocketCAN"):
        NoCan("can0", [])


def test_sending_never_raises_and_counts_every_drop(interface):
    transmitter = SocketCanTransmitter(interface)
    for number, taken in ((0, True), (errno.ENOBUFS, False), (errno.EAGAIN, False), (errno.ENETDOWN, False)):
        interface.inlet.error = number
        assert transmitter.send(ID, bytes(8)) is taken
    interface.close()
    assert transmitter.send(ID, bytes(8)) is False
    assert transmitter.counters == {
        "sent": 1, "dropped_buffer_full": 2, "dropped_interface_down": 1, "dropped_interface_absent": 1,
    }  # fmt: skip
