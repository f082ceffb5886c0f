"""The receiver over python-can."""

from __future__ import annotations

import errno
import gc
import itertools
import math
import time

import can
import pytest

from canest.bus import drivers, pythoncan, pythoncan_transmitter
from canest.bus.link import open_link
from canest.config.bus import Bus
from canest.decode import j1939
from tests.bus.wire import ID, settle
from tests.live.rig import wait_for


@pytest.fixture
def buses(monkeypatch):
    """The buses of python-can that receivers open, the newest last."""
    opened, open_bus = [], drivers.open_bus

    def keep(config):
        opened.append(open_bus(config))
        return opened[-1]

    monkeypatch.setattr(drivers, "open_bus", keep)
    return opened


@pytest.fixture
def virtual(buses, monkeypatch):
    monkeypatch.setattr(pythoncan, "_FIRST_OPEN_S", 10.0)  # a busy machine may be late
    monkeypatch.setattr(pythoncan_transmitter, "_SEND_S", 10.0)
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


def test_stamps_of_a_log_that_is_played_make_no_promise_about_time():
    receiver, _ = open_link(Bus(interface="virtual", channel="u"), [(0, 0)], transmit=False)
    with can.Bus(interface="virtual", channel="u", preserve_timestamps=True) as other:
        other.send(frame(ID, timestamp=1_700_000_000.25))
        drained = receiver.drain()
    receiver.close()
    assert drained.frames.t_us.tolist() == [1_700_000_000_250_000]
    assert drained.reached_us is None


class Adapter:
    """A device with a clock of its own: a frame every 10 ms but for a silence, in scripted time.

    clock: microseconds of the machine -> of the device.
    """

    def __init__(self, monkeypatch, clock, silent_us=range(0)):
        self.now_us, self._sent_us, self._clock, self._silent_us = 10**9, 10**9, clock, silent_us
        for name in ("time_ns", "monotonic_ns"):
            monkeypatch.setattr(time, name, lambda: self.now_us * 1000)

    def recv(self, _):
        while self._sent_us + 11_000 <= self.now_us:  # handed over 1 ms after it was on the bus
            self._sent_us += 10_000
            if self._sent_us not in self._silent_us:
                return frame(ID, timestamp=self._clock(self._sent_us) * 1e-6)
        return None

    def drains(self, receiver, seconds):
        """Yield (time of the device, what was drained) five times a second, collecting on every tick."""
        for tick in range(1, seconds * 50 + 1):
            self.now_us += 20_000
            if tick % 10:
                receiver.collect()
            else:
                yield self._clock(self.now_us), receiver.drain()


@pytest.mark.parametrize(
    "clock",
    [
        lambda us: us,
        lambda us: us - 300_000,
        lambda us: us + 300_000,
        lambda us: us // 5000 * 4999,  # 200 ppm slow
        lambda us: us - (us > 1_030_000_000) * 300_000,  # set
    ],
)
def test_time_is_that_of_the_stamps_on_an_adapter_with_a_clock_of_its_own(monkeypatch, virtual, buses, clock):
    receiver, _, _ = virtual
    adapter = Adapter(monkeypatch, clock, silent_us=range(1_050_000_000, 1_052_000_000))
    buses[-1].recv = adapter.recv
    reached_us, late, frames = -(1 << 62), [], 0
    for now_us, drained in adapter.drains(receiver, 60):
        late += [t for t in drained.frames.t_us.tolist() if t < reached_us]
        reached_us, frames = drained.reached_us, frames + len(drained.frames)
        assert now_us - 41_000 <= reached_us < now_us
    assert frames == 5799
    assert len(late) <= (31 if clock(1_060_000_000) == 1_059_700_000 else 0)  # of the moment it was set


def test_a_frame_with_an_impossible_stamp_is_dropped_and_counted(virtual, buses):
    receiver, _, _ = virtual
    stamps = [1e20, math.nan, 1_700_000_000.25]
    buses[-1].recv = lambda _: frame(ID, timestamp=stamps.pop(0)) if stamps else None
    assert receiver.drain().frames.t_us.tolist() == [1_700_000_000_250_000]
    assert receiver.counters == {"unusable_stamp": 2} and receiver.state == "up"


def test_a_flood_of_frames_that_nobody_wants_does_not_keep_us(virtual, buses):
    receiver, _, _ = virtual
    flood = itertools.repeat(frame(0x18FF0000), 20_000)
    buses[-1].recv = lambda _: next(flood, None)
    assert [receiver.collect() for _ in range(5)] == [False, False, False, False, True]


def test_python_can_sends_and_its_failures_are_counted(virtual, buses):
    receiver, transmitter, other = virtual
    assert transmitter.send(ID, b"\x07")
    assert other.recv(1).data == b"\x07"
    buses[-1].send = lambda *a, **k: (_ for _ in ()).throw(can.CanOperationError("full"))
    assert not transmitter.send(ID, b"\x07")
    receiver.close()
    assert not transmitter.send(ID, b"\x07")
    assert transmitter.counters == {"sent": 1, "dropped_send_failed": 1, "dropped_interface_absent": 1}


def test_an_unplugged_adapter_is_opened_again(virtual, buses):
    receiver, _, other = virtual

    def unplugged(*_):
        raise can.CanOperationError("device removed")

    buses[-1].recv = unplugged
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
def test_a_bus_that_cannot_be_opened_gives_its_reason_and_is_tried_again(monkeypatch, caplog, error, reason):
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
    assert wait_for(lambda: receiver.drain() and receiver.state == "up")
    assert receiver.state == "up" and not receiver.reason
    receiver.close()


@pytest.mark.parametrize("returns_after_s", [0.0, 0.3])
def test_on_multicast_our_own_frames_do_not_come_back_as_a_strangers(monkeypatch, returns_after_s):
    """Nor where the frame is back before the driver's `send` returns."""
    pytest.importorskip("msgpack")
    from can.interfaces.udp_multicast import UdpMulticastBus

    send = UdpMulticastBus.send

    def send_slowly(self, *args, **kwargs):
        send(self, *args, **kwargs)
        time.sleep(returns_after_s)

    monkeypatch.setattr(UdpMulticastBus, "send", send_slowly)
    bus = Bus(interface="udp_multicast", channel="239.74.163.9", options={"port": 43219})
    try:
        receiver, transmitter = open_link(bus, [(0, 0)], transmit=True)
        stranger, other = open_link(bus, [(0, 0)], transmit=True)
    except OSError:
        pytest.skip("no multicast on this machine")
    transmitter.send(ID, b"ours")
    other.send(ID, b"theirs")
    received, _ = settle(receiver.drain, 1)
    assert [int(f[3]).to_bytes(6, "little") for f in received] == [b"theirs"]
    receiver.close()
    stranger.close()
