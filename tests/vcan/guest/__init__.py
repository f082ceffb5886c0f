"""A throw-away guest machine with a real SocketCAN bus, for hosts whose kernel has none.

QEMU in software emulation (no KVM needed) boots Debian's stock kernel on the host's own files, read-only
below a tmpfs overlay: what is installed here is installed there, and what is written there stays there.
``vcan0`` is up when the command starts.

    python -m guest -- candump -n 1 vcan0          (with tests/vcan on PYTHONPATH; or: make guest CMD="…")
"""

from __future__ import annotations

from guest.machine import Guest, GuestError, GuestResult, missing_tools, run

__all__ = ["Guest", "GuestError", "GuestResult", "missing_tools", "run"]
