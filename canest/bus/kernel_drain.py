"""Empties a Linux socket of CAN frames with their kernel receive stamps, many per system call.

``recvmmsg`` writes frames and stamps straight into numpy buffers. Every tick `collect`s, one system call that
keeps the socket's own small buffer empty; `drain` then turns all that was collected into one block with the
same few numpy calls whether 5 or 500 frames arrived (one `socket.recvmsg` per frame costs 2 microseconds).
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
import time
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from canest.core.frames import FrameBlock

# asm-generic/socket.h; the _NEW form has 64-bit times on every architecture (Linux 5.1)
SO_RXQ_OVFL = 40
SO_TIMESTAMPNS_OLD = 35
SO_TIMESTAMPNS_NEW = 64

#: struct can_frame (linux/can.h)
FRAME = np.dtype([("can_id", "=u4"), ("length", "u1"), ("pad", "V3"), ("data", "<u8")])
SLOTS = 2048  #: frames our buffer holds: a tenth of a second of anything a 1 Mbit/s bus can carry
_NOTHING = FrameBlock.empty()

_POINTER = np.dtype(np.uintp)
#: struct msghdr and struct mmsghdr (sys/socket.h)
_MESSAGE = np.dtype(
    [
        ("name", _POINTER),
        ("namelen", "=u4"),
        ("iov", _POINTER),
        ("iovlen", _POINTER),
        ("control", _POINTER),
        ("controllen", _POINTER),
        ("flags", "=i4"),
    ],
    align=True,
)
_HEADER = np.dtype([("message", _MESSAGE), ("received", "=u4")], align=True)
_IOVEC = np.dtype([("base", _POINTER), ("length", _POINTER)])
_CMSG = [("len", _POINTER), ("level", "=i4"), ("type", "=i4")]
#: the two control messages in the order in which the kernel writes them: stamp, then (if any) drops
_CONTROL = np.dtype(
    [
        ("stamp", _CMSG),
        ("s", "=i8"),
        ("ns", "=i8"),
        ("overflow", _CMSG),
        ("drops", "=u4"),
        ("pad", "V4"),
    ]
)
_STAMP_SPACE = _CONTROL.fields["overflow"][1]  # type: ignore[index]

#: payload length -> mask of the bytes that were sent (a sender's buffer may hold anything behind them)
SENT_BYTES = np.array([(1 << 8 * n) - 1 for n in range(9)] + [(1 << 64) - 1] * 247, np.uint64)


@dataclass(frozen=True, slots=True)
class Drained:
    """What one drain brought.

    frames: in order of arrival. reached_us: event time that has certainly been reached (every frame
    stamped before it is in), None when that is not known. drops: frames lost to a full socket buffer so
    far (running 32-bit count of the kernel), None when no frame carried it.
    """

    frames: FrameBlock
    reached_us: int | None
    drops: int | None = None


def enable_timestamps(sock: socket.socket) -> None:
    """Switch nanosecond receive stamps and the count of overflow drops on."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS_NEW, 1)
    except OSError:
        if struct.calcsize("P") != 8:
            raise
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS_OLD, 1)  # same layout on 64-bit machines
    sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)


class KernelDrain:
    """Reads one datagram socket whose datagrams are ``struct can_frame``."""

    def __init__(self, sock: socket.socket, slots: int = SLOTS) -> None:
        self._fd, self._slots = sock.fileno(), slots
        self._frames = np.zeros(slots, FRAME)
        self._control = np.zeros(slots, _CONTROL)
        iovecs = np.zeros(slots, _IOVEC)
        iovecs["base"] = self._frames.ctypes.data + np.arange(slots) * FRAME.itemsize
        iovecs["length"] = FRAME.itemsize
        headers = np.zeros(slots, _HEADER)
        messages = headers["message"]
        messages["iov"] = iovecs.ctypes.data + np.arange(slots) * _IOVEC.itemsize
        messages["iovlen"] = 1
        messages["control"] = self._control.ctypes.data + np.arange(slots) * _CONTROL.itemsize
        messages["controllen"] = _CONTROL.itemsize
        self._iovecs, self._headers = iovecs, headers
        self._controllen, self._received = messages["controllen"], headers["received"]
        # views of every field, made once: a field of a structured array costs more than its few numbers
        self._s, self._ns, self._drops = (self._control[name] for name in ("s", "ns", "drops"))
        self._id, self._length, self._data = (self._frames[name] for name in ("can_id", "length", "data"))
        self._headers_at: int = headers.ctypes.data
        self._recvmmsg = _recvmmsg()
        self._used = 0
        self._error: OSError | None = None

    def collect(self) -> bool:
        """Move what waits in the socket into our buffer, without looking at it; False when that is full."""
        free = self._slots - self._used
        if not free:
            return False
        if self._error is None:
            at = self._headers_at + self._used * _HEADER.itemsize
            count = self._recvmmsg(self._fd, at, free, socket.MSG_DONTWAIT, None)
            if count >= 0:
                self._used += count
                return bool(count < free)
            number = ctypes.get_errno()
            if number not in (errno.EAGAIN, errno.EINTR):
                self._error = OSError(number, os.strerror(number))
        return True

    def drain(self) -> Drained:
        """Return everything that has arrived, without blocking. Errors: OSError of the socket."""
        before_us = time.time_ns() // 1000
        emptied = self.collect()
        count, self._used = self._used, 0
        if self._error is not None and not count:  # frames came before it, and were handed out first
            # never from a local variable: the error refers to this frame, and in a cycle of the two our
            # buffers live until the collector runs, which in a loop that allocates little is hardly ever
            try:
                raise self._error
            finally:
                self._error = None
        if not count:
            return Drained(_NOTHING, before_us)
        drops = int(self._drops[count - 1]) if self._controllen[count - 1] > _STAMP_SPACE else None
        frames = self._take(count, before_us)
        self._controllen[:count] = _CONTROL.itemsize
        return Drained(frames, before_us if emptied else None, drops)

    def _take(self, count: int, now_us: int) -> FrameBlock:
        t_us = self._s[:count] * 1_000_000 + self._ns[:count] // 1000
        if self._controllen[:count].min() < _STAMP_SPACE:  # a socket family without stamps
            t_us = np.full(count, now_us, np.int64)
        can_id, length, data = (field[:count].copy() for field in (self._id, self._length, self._data))
        if self._received[:count].min() < FRAME.itemsize:  # not a whole frame: its content is undefined
            whole = self._received[:count] == FRAME.itemsize
            t_us, can_id, length, data = t_us[whole], can_id[whole], length[whole], data[whole]
        data &= SENT_BYTES[length]
        return FrameBlock(t_us, can_id, length, data)


@cache
def _recvmmsg() -> Any:
    """Return the C function, one for all: every `ctypes.CDLL` makes a class that only the collector frees."""
    function = ctypes.CDLL(None, use_errno=True).recvmmsg
    function.argtypes = [ctypes.c_int, ctypes.c_size_t, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function
