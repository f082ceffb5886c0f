"""SocketCAN: our own raw socket, with kernel filters and kernel stamps, that survives its interface.

An interface that goes down keeps its socket: the kernel delivers again once it is up. One that is deleted
takes the socket's binding with it for ever, so its index is checked and the socket opened anew.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections import Counter

from canest.bus.kernel_drain import SLOTS, Drained, KernelDrain, enable_timestamps
from canest.bus.protocols import Filters
from canest.core.errors import BusError
from canest.core.frames import ERROR, FrameBlock
from canest.core.samples import STEP_US

_NOTHING = FrameBlock.empty()
CHECK_S = 0.5  #: period of checks of a working interface
RETRY_S = 0.02  #: and of a missing one (a check costs 5 microseconds)
GUARD_US = 2_000  #: a frame is in the socket this long after its stamp at the latest
RECEIVE_BUFFER_BYTES = 4 << 20  #: asked for; without CAP_NET_ADMIN at most net.core.rmem_max is granted
_BYTES_PER_FRAME = 1024  #: what a waiting frame takes of it, rounded up (an sk_buff and its data: 640 to 900)
MOST_FRAMES_PER_S = 4000  #: a full J1939 bus of 500 kbit/s: 8 bytes under 29 bits are 131 bits and stuffing

# linux/can/raw.h, linux/can/error.h
_CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER, _CAN_RAW_RECV_OWN_MSGS = 1, 2, 4
_SO_RCVBUFFORCE = 33
_ERR_TX_TIMEOUT, _ERR_CRTL, _ERR_BUSOFF, _ERR_RESTARTED = 0x1, 0x4, 0x40, 0x100
_ERR_WANTED = _ERR_TX_TIMEOUT | _ERR_CRTL | _ERR_BUSOFF | _ERR_RESTARTED
#: second data byte of a controller error frame
_CRTL_OVERFLOW, _CRTL_WARNING, _CRTL_PASSIVE, _CRTL_ACTIVE = 0x03, 0x0C, 0x30, 0x40  # either direction

_FRAME = struct.Struct("=IB3x8s")
_FULL = frozenset({errno.ENOBUFS, errno.EAGAIN})
_MAX_FILTERS = 512  # CAN_RAW_FILTER_MAX


def enlarge_receive_buffer(sock: socket.socket) -> None:
    """Set a socket's receive buffer to `RECEIVE_BUFFER_BYTES`, or to what is allowed."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


class SocketCanReceiver:
    """Receives from a SocketCAN interface; see `canest.bus.protocols.Receiver`.

    filters: (id, mask) pairs of what is wanted; the kernel drops everything else unseen.
    A subclass that stands in for an interface overrides `open_socket`, `open_drain`, `interface_index` and
    `interface_is_up`.
    """

    def __init__(self, channel: str, filters: Filters) -> None:
        if len(filters) > _MAX_FILTERS:
            raise BusError("too many filters", found=len(filters), expected=f"at most {_MAX_FILTERS}")
        self.channel, self._filters = channel, list(filters)
        self.state, self.reason = "absent", ""
        self.opened = 0
        self.counters: Counter[str] = Counter()
        self._socket: socket.socket | None = None
        self._drain: KernelDrain | None = None
        self._capacity_frames = 0  #: frames that may wait
        self._backlog = False  #: the last drain left some in the socket
        self._index: int | None = None
        self._check_at_s = 0.0
        self._drops_seen = 0
        self._open()

    @property
    def max_poll_interval_us(self) -> int:
        """Return half the time a full bus takes to fill our buffers; one tick if one is gone or full."""
        if self._backlog or self.state in ("absent", "down"):
            return STEP_US
        return self._capacity_frames * 1_000_000 // (2 * MOST_FRAMES_PER_S)

    @property
    def raw_socket(self) -> socket.socket | None:
        """Return the open socket, which the transmitter sends through; None while there is none."""
        return self._socket

    def request_check(self) -> None:
        """Check the interface with the next `collect` or `drain`."""
        self._check_at_s = 0.0

    def collect(self) -> bool:
        """Empty the socket; see `canest.bus.protocols.Receiver`."""
        now_s = time.monotonic()
        if now_s >= self._check_at_s:
            self._check_interface(now_s)
        return self._drain is None or self._drain.collect()

    def drain(self) -> Drained:
        """Return what has arrived; see `canest.bus.protocols.Receiver`."""
        now_s = time.monotonic()
        if now_s >= self._check_at_s:
            self._check_interface(now_s)
        if self._drain is None:
            return Drained(_NOTHING, time.time_ns() // 1000 - GUARD_US)
        try:
            drained = self._drain.drain()
        except OSError as error:
            self._failed(error)
            return Drained(_NOTHING, time.time_ns() // 1000 - GUARD_US)
        self._backlog = drained.reached_us is None
        frames = drained.frames
        if len(frames):
            if self.state == "down":
                self.state = "up"
            self._note_errors(frames)
        if drained.drops is not None:
            self.counters["dropped_by_kernel"] += (drained.drops - self._drops_seen) & 0xFFFF_FFFF
            self._drops_seen = drained.drops
        reached = None if drained.reached_us is None else drained.reached_us - GUARD_US
        return Drained(frames, reached)

    def close(self) -> None:
        """Let the interface go."""
        if self._socket is not None:
            self._socket.close()
        self._socket = self._drain = self._index = None
        self._backlog = False
        self._drops_seen = 0
        self.state = "absent"

    def _check_interface(self, now_s: float) -> None:
        """Check that the interface of that name is up, and the one the socket is bound to."""
        index = self.interface_index()
        if index != self._index or (index is not None and self._drain is None):
            if self._index is not None:
                self.counters["interface_lost"] += 1
            self.close()
            if index is not None:
                self._open()
        elif index is not None and not self.interface_is_up():
            self.state = "down"
        elif self.state == "down":
            self.state = "up"
        self._check_at_s = now_s + (RETRY_S if self.state in ("absent", "down") else CHECK_S)

    def _open(self) -> None:
        try:
            sock = self.open_socket()
        except OSError as error:
            if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
                raise BusError(
                    "this kernel has no SocketCAN",
                    where=f"bus {self.channel}",
                    expected="a Linux kernel with CONFIG_CAN (modprobe can-raw), or another bus.interface",
                ) from error
            self.counters["open_failed"] += 1
            self.reason = error.strerror or str(error)
            return
        self._socket, self._drain = sock, self.open_drain(sock)
        granted = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._capacity_frames = min(granted // _BYTES_PER_FRAME, SLOTS)
        self._index = self.interface_index()
        self.opened += 1
        self.reason = ""
        self.state = "up" if self.interface_is_up() else "down"

    def open_socket(self) -> socket.socket:
        """Return a socket bound to the interface. Errors: OSError."""
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
        try:
            pairs = b"".join(struct.pack("=II", i & 0xFFFF_FFFF, m & 0xFFFF_FFFF) for i, m in self._filters)
            sock.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_FILTER, pairs)
            sock.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, struct.pack("=I", _ERR_WANTED))
            sock.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_RECV_OWN_MSGS, 0)
            enable_timestamps(sock)
            enlarge_receive_buffer(sock)
            sock.bind((self.channel,))
        except OSError:
            sock.close()
            raise
        return sock

    def open_drain(self, sock: socket.socket) -> KernelDrain:
        """Return what empties a socket."""
        return KernelDrain(sock)

    def interface_index(self) -> int | None:
        """Return the index of the interface of our name, None while there is none."""
        try:
            return socket.if_nametoindex(self.channel)
        except OSError:
            return None

    def interface_is_up(self) -> bool:
        """Ask the interface's flags (IFF_UP); a sysfs that cannot be read counts as up."""
        try:
            with open(f"/sys/class/net/{self.channel}/flags") as file:  # noqa: PTH123 - every 20 ms when down
                return bool(int(file.read(), 16) & 1)
        except (OSError, ValueError):
            return True

    def _failed(self, error: OSError) -> None:
        name = errno.errorcode.get(error.errno or 0, "unknown").lower()
        self.counters[f"receive_{name}"] += 1
        if error.errno == errno.ENETDOWN:
            self.state = "down"
        else:  # ENODEV and whatever else: this socket is not to be trusted any more
            if self._index is not None:
                self.counters["interface_lost"] += 1
            self.close()
            self.reason = error.strerror or str(error)
        self._check_at_s = 0.0

    def _note_errors(self, frames: FrameBlock) -> None:
        """Follow the controller's state from its error frames."""
        marked = (frames.can_id & ERROR) != 0
        if self.state == "bus-off" and not marked.all():
            self.state = "up"  # a controller that is bus-off receives nothing
        if not marked.any():
            return
        for kind, word in zip(frames.can_id[marked].tolist(), frames.data[marked].tolist(), strict=True):
            detail = word >> 8 & 0xFF if kind & _ERR_CRTL else 0
            if kind & _ERR_BUSOFF:
                self.counters["bus_off"] += 1
                self.state = "bus-off"
            elif kind & _ERR_RESTARTED or detail & _CRTL_ACTIVE:
                self.counters["bus_restarted"] += 1
                self.state = "up"
            elif detail & _CRTL_PASSIVE:
                self.counters["error_passive"] += 1
                self.state = "error-passive"
            elif detail & _CRTL_OVERFLOW:
                self.counters["controller_overflow"] += 1
            else:
                self.counters["other_error_frames"] += 1
                if detail & _CRTL_WARNING and self.state == "error-passive":
                    self.state = "up"  # fewer errors than before


class SocketCanTransmitter:
    """Sends through the receiver's socket, so that the kernel does not hand our own frames back to us."""

    waiting = 0  #: the kernel has what it takes

    def __init__(self, receiver: SocketCanReceiver) -> None:
        self._receiver = receiver
        self.counters: Counter[str] = Counter()

    def send(self, can_id: int, payload: bytes) -> bool:
        """Send one frame if the interface takes it at once; see `canest.bus.protocols.Transmitter`."""
        sock = self._receiver.raw_socket
        if sock is None:
            self.counters["dropped_interface_absent"] += 1
            return False
        try:
            sock.send(_FRAME.pack(can_id, len(payload), payload))
        except OSError as error:
            full = error.errno in _FULL
            self.counters["dropped_buffer_full" if full else "dropped_interface_down"] += 1
            if not full:  # a socket returns an error once: the transmitter got it, so the receiver checks
                self._receiver.request_check()
            return False
        self.counters["sent"] += 1
        return True

    def failed(self) -> list[int]:
        """Return none; see `waiting`."""
        return []

    def drop_waiting(self) -> None:
        """Nothing waits."""
