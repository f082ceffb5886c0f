"""CAN over multicast, on the loopback."""

from __future__ import annotations

import socket
import time

import pytest

from canest.bus.link import open_link
from canest.config.bus import Bus
from tests.bus.wire import ID, settle

msgpack = pytest.importorskip("msgpack")
GROUP, PORT = "239.74.163.11", 43227

JUNK = [
    b"",
    b"\x00" * 40,
    b"\xc1",
    b"not a frame at all",
    msgpack.packb([1, 2, 3]),
    msgpack.packb({"unknown": 1}),
    msgpack.packb({"arbitration_id": -1, "dlc": 0, "data": b""}),
    msgpack.packb({"arbitration_id": float("nan"), "dlc": 0, "data": b""}),
    msgpack.packb({"arbitration_id": 1, "dlc": 64, "data": b"", "is_fd": True}),
    b"\xdf" + b"\xff" * 60,
    b"x" * 9000,
]


def opened(group=GROUP, port=PORT):
    bus = Bus(interface="udp_multicast", channel=group, options={"port": port})
    receiver, transmitter = open_link(bus, [(0, 0)], transmit=True)
    if receiver.state != "up":
        pytest.skip(f"no multicast on this machine: {receiver.reason}")
    return receiver, transmitter


def test_datagrams_that_are_no_frames_are_counted_and_the_frames_between_them_arrive():
    receiver, _ = opened()
    other, sender = opened()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for k, junk in enumerate(JUNK):
            stranger.sendto(junk, (GROUP, PORT))
            assert sender.send(ID + k, b"12345678")
    frames, _ = settle(receiver.drain, len(JUNK))
    assert [f[1] for f in frames] == [ID + k for k in range(len(JUNK))]
    assert receiver.counters == {"damaged_input": len(JUNK)}
    assert (receiver.state, receiver.opened) == ("up", 1)
    receiver.close()
    other.close()


def test_a_socket_full_of_junk_does_not_close_the_interface():
    receiver, _ = opened()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(5000):
            stranger.sendto(b"junk", (GROUP, PORT))
    time.sleep(0.05)
    settle(receiver.drain, 1, timeout_s=0.3)
    assert receiver.counters["damaged_input"] > 50
    assert (receiver.state, receiver.opened) == ("up", 1)
    receiver.close()


@pytest.mark.parametrize(
    ("ours", "theirs"), [(GROUP, "239.74.163.12"), ("ff15:7079:7468:6f6e::11", "ff15:7079:7468:6f6e::12")]
)
def test_frames_of_another_group_on_this_machine_stay_there(ours, theirs):
    receiver, _ = opened(ours, PORT + 1)
    other, sender = opened(theirs, PORT + 1)
    third, ours_too = opened(ours, PORT + 1)
    if not sender.send(ID, b"theirs") or not ours_too.send(ID, b"ours"):
        pytest.skip("no route for this family of groups")
    frames, _ = settle(receiver.drain, 2, timeout_s=0.5)
    assert [int(f[3]).to_bytes(8, "little").rstrip(b"\0") for f in frames] == [b"ours"]
    for half in (receiver, other, third):
        half.close()
