"""The receivers: the kernel drain on a UDP socket, a SocketCAN interface that comes and goes, python-can."""

from __future__ import annotations

import errno
import gc
import socket
import struct
import time

import can
import pytest

from canest.config.bus import Broadcast, Bus
from canest.decode import j1939
from canest.errors import BusError
from canest.frames import ERROR, EXTENDED
from canest.live.kernel_drain import SLOTS, KernelDrain, ask_for_stamps
from canest.live.link import may_transmit, open_link
from canest.live.pythoncan import PythonCanReceiver
from canest.live.socketcan import SocketCanReceiver, SocketCanTransmitter
from canest.vehicle.samples import STEP_US

ID = 0x18FEF100 | EXTENDED


def packed(can_id=ID, payload=bytes(8), length=None):
    return struct.pack("=IB3x8s", can_id, len(payload) if length is None else length, payload)


def settle(drain, expected, timeout_s=2.0):
    """Drain until ``expected`` frames have come (loopback delivery takes its time)."""
    frames, last, end = [], None, time.monotonic() + timeout_s
    while len(frames) < expected and time.monotonic() < end:
        last = drain()
        frames += zip(
            *(getattr(last.frames, c).tolist() for c in ("t_us", "can_id", "length", "data")), strict=True
        )
        time.sleep(0.002)
    return frames, last


@pytest.fixture
def loopback():
    """A socket that datagrams of CAN frames arrive at, and one that sends them."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inlet,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet,
    ):
        inlet.bind(("127.0.0.1", 0))
        ask_for_stamps(inlet)
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


def test_nothing_to_read_returns_at_once_and_still_tells_the_time(loopback):
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


def test_frames_that_came_before_a_socket_error_are_handed_out_before_it(loopback):
    inlet, outlet = loopback
    drain = KernelDrain(inlet)
    outlet.send(packed())
    time.sleep(0.02)
    drain.collect()
    drain._error = OSError(errno.ENETDOWN, "Network is down")
    assert len(drain.drain().frames) == 1
    with pytest.raises(OSError, match="down"):
        drain.drain()
    assert len(drain.drain().frames) == 0


class Interface(SocketCanReceiver):
    """A SocketCAN interface played by UDP: it has an index, is up or down, and can vanish."""

    index, up = 1, True

    def _open_socket(self):
        if self.index is None:
            raise OSError(errno.ENODEV, "No such device")
        self.inlet = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.inlet.bind(("127.0.0.1", 0))
        ask_for_stamps(self.inlet)
        return self.inlet

    def _index_of_interface(self):
        return self.index

    def _is_up(self):
        return self.up

    def bus_sends(self, *frames):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet:
            for frame in frames:
                outlet.sendto(frame, self.inlet.getsockname())

    def fails_with(self, number):
        class Failing:
            def collect(self):
                return True

            def drain(self):
                raise OSError(number, "failed")

        self._drain = Failing()


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
    assert interface.rest_us == pytest.approx(frames / 4000 / 2 * 1e6, abs=1)
    interface.index = None
    time.sleep(0.55)
    interface.drain()
    assert interface.state == "absent" and interface.rest_us == STEP_US


def test_an_interface_is_not_left_alone_while_frames_wait_in_it(interface):
    rest_us = interface.rest_us
    interface._drain = KernelDrain(interface.inlet, slots=32)
    interface.bus_sends(*[packed()] * 42)
    time.sleep(0.05)
    assert len(interface.drain().frames) == 32
    assert interface.rest_us == STEP_US
    assert len(interface.drain().frames) == 10
    assert interface.rest_us == rest_us


def test_an_interface_deleted_and_created_again_is_opened_within_a_tick_or_two(interface):
    interface.bus_sends(packed())
    assert len(settle(interface.drain, 1)[0]) == 1
    interface.index = None
    interface.fails_with(errno.ENODEV)
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
    interface.index = 7  # no error on the socket: a deaf socket would go unnoticed for ever
    end = time.monotonic() + 2
    while interface.opened < 2 and time.monotonic() < end:
        interface.drain()
        time.sleep(0.02)
    assert interface.opened == 2 and interface.state == "up"


def test_an_interface_that_goes_down_keeps_its_socket_and_comes_back(interface):
    drain = interface._drain
    interface.up = False
    interface.fails_with(errno.ENETDOWN)
    interface.drain()
    assert interface.state == "down" and interface.opened == 1
    interface._drain = drain
    interface.up = True
    time.sleep(0.025)
    interface.drain()
    assert interface.state == "up" and interface.opened == 1


def test_an_error_that_only_the_sender_was_told_is_no_secret(interface):
    """A socket hands an error to whoever calls first; a link that is down must not pass for up."""

    class Socket:
        def send(self, frame):
            raise OSError(errno.ENETDOWN, "no")

    real = interface._socket
    interface.drain()
    interface.up = False
    interface._socket = Socket()
    SocketCanTransmitter(interface).send(ID, bytes(8))
    interface._socket = real
    interface.drain()
    assert interface.state == "down"
    interface.up = True
    time.sleep(0.025)
    interface.drain()
    assert interface.state == "up" and interface.opened == 1


@pytest.mark.parametrize("state", ["up", "bus-off", "error-passive"])
def test_a_link_set_down_without_any_error_is_noticed(interface, state):
    interface.state, interface.up = state, False
    interface._look_at_s = 0.0
    interface.drain()
    assert interface.state == "down"


def test_an_unknown_socket_error_leads_to_a_new_socket(interface):
    interface.fails_with(errno.EBADF)
    interface.drain()
    interface.drain()
    assert interface.state == "up" and interface.opened == 2


def test_error_frames_tell_the_controllers_state(interface):
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


def test_traffic_after_bus_off_means_it_is_over(interface):
    interface.bus_sends(packed(ERROR | 0x40))
    settle(interface.drain, 1)
    interface.bus_sends(packed())
    settle(interface.drain, 1)
    assert interface.state == "up"


def test_a_kernel_without_socketcan_is_one_plain_error(monkeypatch):
    class NoCan(Interface):
        def _open_socket(self):
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    with pytest.raises(BusError, match="no SocketCAN"):
        NoCan("can0", [])


def test_sending_never_raises_and_counts_every_drop(interface):
    class Socket:
        number = 0

        def send(self, frame):
            if self.number:
                raise OSError(self.number, "no")

    transmitter = SocketCanTransmitter(interface)
    real, interface._socket = interface._socket, Socket()
    for number, taken in ((0, True), (errno.ENOBUFS, False), (errno.EAGAIN, False), (errno.ENETDOWN, False)):
        Socket.number = number
        assert transmitter.send(ID, bytes(8)) is taken
    interface._socket = None
    assert transmitter.send(ID, bytes(8)) is False
    interface._socket = real
    assert transmitter.counters == {
        "sent": 1, "dropped_buffer_full": 2, "dropped_interface_down": 1, "dropped_interface_absent": 1,
    }  # fmt: skip


def test_a_receiver_has_no_way_to_send():
    for kind in (SocketCanReceiver, PythonCanReceiver):
        assert not any("send" in name or "transmit" in name for name in dir(kind))


def test_listen_only_opens_no_transmitter():
    receiver, transmitter = open_link(Bus(interface="virtual", channel="quiet"), [], transmit=False)
    receiver.close()
    assert transmitter is None


@pytest.mark.parametrize(
    ("interface", "channel", "section", "may"),
    [
        ("socketcan", "can0", {}, False),
        ("socketcan", "slcan0", {}, False),
        ("pcan", "PCAN_USBBUS1", {}, False),
        ("socketcan", "vcan0", {}, True),
        ("virtual", "x", {}, True),
        ("udp_multicast", "239.0.0.1", {}, True),
        ("socketcan", "can0", {"enabled": True}, True),
        ("socketcan", "vcan0", {"enabled": False}, False),
        ("socketcan", "can0", {"enabled": True, "listen_only": True}, False),
        ("virtual", "x", {"listen_only": True}, False),
    ],
)
def test_a_physical_bus_is_never_sent_on_unless_asked(interface, channel, section, may):
    assert may_transmit(Bus(interface=interface, channel=channel), Broadcast(**section)) is may


@pytest.fixture
def virtual():
    filters = [j1939.kernel_filter(65265)]
    receiver, transmitter = open_link(Bus(interface="virtual", channel="t"), filters, transmit=True)
    with can.Bus(interface="virtual", channel="t") as other:
        yield receiver, transmitter, other
    receiver.close()


def frame(can_id, data=b"\x01\x02", **kwargs):
    return can.Message(arbitration_id=can_id & 0x1FFFFFFF, is_extended_id=True, data=data, **kwargs)


def test_python_can_frames_arrive_filtered_and_whole(virtual):
    receiver, _, other = virtual
    for _ in range(100):  # what is not wanted must not hide what is
        other.send(frame(0x18FF0000))
        other.send(frame(ID))
    drained = receiver.drain()
    assert drained.frames.can_id.tolist() == [ID] * 100
    assert drained.frames.data.tolist() == [0x0201] * 100
    assert drained.reached_us is not None


def test_stamps_of_another_clock_make_no_promise_about_time():
    receiver, _ = open_link(
        Bus(interface="virtual", channel="u", options={"preserve_timestamps": True}), [(0, 0)], transmit=False
    )
    with can.Bus(interface="virtual", channel="u", preserve_timestamps=True) as other:
        other.send(frame(ID, timestamp=1_700_000_000.25))
        drained = receiver.drain()
    receiver.close()
    assert drained.frames.t_us.tolist() == [1_700_000_000_250_000]
    assert drained.reached_us is None


def test_python_can_sends_and_its_failures_are_counted(virtual):
    receiver, transmitter, other = virtual
    assert transmitter.send(ID, b"\x07")
    assert other.recv(1).data == b"\x07"
    receiver._bus.send = lambda *a, **k: (_ for _ in ()).throw(can.CanOperationError("full"))
    assert not transmitter.send(ID, b"\x07")
    receiver.close()
    assert not transmitter.send(ID, b"\x07")
    assert transmitter.counters == {"sent": 1, "dropped_send_failed": 1, "dropped_interface_absent": 1}


def test_an_unplugged_adapter_is_opened_again(virtual):
    receiver, _, other = virtual

    def unplugged(*_):
        raise can.CanOperationError("device removed")

    receiver._bus.recv = unplugged
    assert len(receiver.drain().frames) == 0
    assert receiver.state == "absent" and receiver.reason == "device removed"
    end = time.monotonic() + 2
    while receiver.state != "up" and time.monotonic() < end:
        receiver.drain()
        time.sleep(0.02)
    other.send(frame(ID))
    assert len(receiver.drain().frames) == 1
    assert receiver.opened == 2 and receiver.counters["interface_lost"] == 1


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(errno.ENODEV, "No such device"), "No such device"),
        (can.CanInitializationError("no adapter\n at COM3"), "no adapter at COM3"),
        (NameError("name 'canOpen' is not defined"), "NameError: name 'canOpen' is not defined"),
        (OSError(), "OSError"),
    ],
)
def test_a_bus_that_cannot_be_opened_says_why_and_is_tried_again(monkeypatch, caplog, error, reason):
    class Absent(can.BusABC):
        def __init__(self, **_):
            raise error

        def send(self, msg, timeout=None):
            raise NotImplementedError

    with monkeypatch.context() as patch:
        patch.setattr(can, "Bus", Absent)
        receiver, _ = open_link(Bus(interface="virtual", channel="late"), [], transmit=False)
        error.__traceback__ = None  # it holds the bus that never was
        gc.collect()
    assert receiver.state == "absent" and receiver.reason == reason
    assert "not properly shut down" not in caplog.text
    receiver._retry_at_s = 0.0
    receiver.drain()
    assert receiver.state == "up" and not receiver.reason
    receiver.close()


def test_an_interface_python_can_does_not_know_is_one_plain_error():
    with pytest.raises(BusError, match="no_such"):
        open_link(Bus(interface="no_such", channel="x"), [], transmit=False)


def test_on_multicast_our_own_frames_do_not_come_back_as_a_strangers():
    pytest.importorskip("msgpack")
    bus = Bus(interface="udp_multicast", channel="239.74.163.9", options={"port": 43219})
    try:
        receiver, transmitter = open_link(bus, [(0, 0)], transmit=True)
        stranger, other = open_link(bus, [(0, 0)], transmit=True)
    except OSError:
        pytest.skip("no multicast on this machine")
    transmitter.send(ID, b"ours")
    other.send(ID, b"theirs")
    heard, _ = settle(receiver.drain, 1)
    assert [int(f[3]).to_bytes(6, "little") for f in heard] == [b"theirs"]
    receiver.close()
    stranger.close()
