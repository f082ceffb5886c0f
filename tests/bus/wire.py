"""Frames on the wire, and a drain that waits for them."""

from __future__ import annotations

import struct
import time

from canest.core.frames import EXTENDED

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
