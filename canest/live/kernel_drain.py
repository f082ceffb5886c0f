"""Empties a Linux socket of CAN frames with their kernel receive stamps, a batch per system call.

``recvmmsg`` writes up to a batch of frames and their stamps straight into numpy buffers, so that a tick
costs the same few numpy calls whether 5 or 200 frames arrived (one `socket.recvmsg` per frame costs about
2 microseconds each, before anything is parsed).
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from canest.frames import FrameBlock

# asm-generic/socket.h; the _NEW form has 64-bit times on every architecture (Linux 5.1)
SO_RXQ_OVFL = 40
SO_TIMESTAMPNS_OLD = 35
SO_TIMESTAMPNS_NEW = 64

#: struct can_frame (linux/can.h)
FRAME = np.dtype([("can_id", "=u4"), ("length", "u1"), ("pad", "V3"), ("data", "<u8")])
BATCH = 256  #: frames per system call; two ticks of a full 1 Mbit/s bus
MAX_BATCHES = 16  #: per drain, so that a flood cannot keep a tick from ending

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
    far (running 32-bit count of the kernel), None when no frame told.
    """

    frames: FrameBlock
    reached_us: int | None
    drops: int | None = None


def ask_for_stamps(sock: socket.socket) -> None:
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

    def __init__(self, sock: socket.socket, batch: int = BATCH) -> None:
        self._fd, self._batch = sock.fileno(), batch
        self._frames = np.zeros(batch, FRAME)
        self._control = np.zeros(batch, _CONTROL)
        iovecs = np.zeros(batch, _IOVEC)
        iovecs["base"] = self._frames.ctypes.data + np.arange(batch) * FRAME.itemsize
        iovecs["length"] = FRAME.itemsize
        headers = np.zeros(batch, _HEADER)
        messages = headers["message"]
        messages["iov"] = iovecs.ctypes.data + np.arange(batch) * _IOVEC.itemsize
        messages["iovlen"] = 1
        messages["control"] = self._control.ctypes.data + np.arange(batch) * _CONTROL.itemsize
        messages["controllen"] = _CONTROL.itemsize
        self._iovecs, self._headers = iovecs, headers
        self._controllen, self._received = messages["controllen"], headers["received"]
        self._headers_at = ctypes.c_void_p(headers.ctypes.data)
        self._recvmmsg = _recvmmsg()
        self._error: OSError | None = None

    def drain(self) -> Drained:
        """Return everything that waits in the socket, without blocking. Errors: OSError of the socket."""
        if self._error is not None:  # frames came before it, and were handed out first
            error, self._error = self._error, None
            raise error
        before_us = time.time_ns() // 1000
        parts: list[FrameBlock] = []
        drops: int | None = None
        for _ in range(MAX_BATCHES):
            count = self._recvmmsg(self._fd, self._headers_at, self._batch, socket.MSG_DONTWAIT, None)
            if count < 0:
                number = ctypes.get_errno()
                if number not in (errno.EAGAIN, errno.EINTR):
                    self._error = OSError(number, os.strerror(number))
                break
            if count:
                parts.append(self._take(count, before_us))
                if self._controllen[count - 1] > _STAMP_SPACE:
                    drops = int(self._control["drops"][count - 1])
                self._controllen[:count] = _CONTROL.itemsize
            if count < self._batch:
                break
        else:
            before_us = -1  # more is waiting: no promise about time
        if self._error is not None and not parts:
            return self.drain()
        frames = parts[0] if len(parts) == 1 else FrameBlock.concatenate(parts)
        return Drained(frames, before_us if before_us >= 0 else None, drops)

    def _take(self, count: int, now_us: int) -> FrameBlock:
        frames, control = self._frames[:count], self._control[:count]
        t_us = control["s"] * 1_000_000 + control["ns"] // 1000
        if self._controllen[:count].min() < _STAMP_SPACE:  # a socket family without stamps
            t_us = np.full(count, now_us, np.int64)
        can_id, length, data = frames["can_id"].copy(), frames["length"].copy(), frames["data"].copy()
        if self._received[:count].min() < FRAME.itemsize:  # not a whole frame: nothing believable in it
            whole = self._received[:count] == FRAME.itemsize
            t_us, can_id, length, data = t_us[whole], can_id[whole], length[whole], data[whole]
        data &= SENT_BYTES[length]
        return FrameBlock(t_us, can_id, length, data)


def _recvmmsg() -> Any:
    function = ctypes.CDLL(None, use_errno=True).recvmmsg
    function.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function
