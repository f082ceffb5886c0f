"""Which receiver a bus gets, and who may send on it."""

from __future__ import annotations

import pytest

from canest.bus import drivers
from canest.bus.link import may_transmit, open_link
from canest.bus.pythoncan import PythonCanReceiver
from canest.bus.socketcan import SocketCanReceiver
from canest.config.bus import Broadcast, Bus
from canest.core.errors import BusError


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


def test_an_interface_python_can_does_not_know_is_one_plain_error():
    with pytest.raises(BusError, match="no_such"):
        open_link(Bus(interface="no_such", channel="x"), [], transmit=False)


@pytest.mark.parametrize(
    ("interface", "channel", "expected"),
    [
        ("socketcand", "can0", "'host' and 'port'.*bus.options"),  # without them it cannot open, ever
        ("pcan", "PCAN_USBBUS1", "its driver"),
        ("gs_usb", "0", "its driver"),
    ],
)
def test_what_can_never_open_is_refused_and_not_waited_for(interface, channel, expected):
    with pytest.raises(BusError, match=expected):
        open_link(Bus(interface=interface, channel=channel), [], transmit=False)


def test_an_adapter_that_is_not_there_is_waited_for(tmp_path):
    receiver, _ = open_link(Bus(interface="slcan", channel=str(tmp_path / "ttyACM0")), [], transmit=False)
    assert receiver.state == "absent" and "could not open port" in receiver.reason
    receiver.close()


def test_a_silent_adapter_is_told_so_where_its_driver_can(monkeypatch):
    opened = []

    def open_bus(config):
        opened.append(dict(config.options))
        raise OSError(2, "no such device")

    monkeypatch.setattr(drivers, "open_bus", open_bus)
    for interface, options in (("slcan", {}), ("slcan", {"listen_only": False}), ("gs_usb", {})):
        bus = Bus(interface=interface, channel="x", options=options)
        receiver, _ = open_link(bus, [], transmit=False, silent=True)
        receiver.close()
    assert opened == [{"listen_only": True}, {"listen_only": False}, {}]
