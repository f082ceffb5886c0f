"""A throw-away guest machine with a real SocketCAN bus, for hosts whose kernel has none.

QEMU in software emulation (no KVM needed) boots Debian's stock kernel on the host's own file system: read-only
over 9p, below a tmpfs overlay, so whatever is installed here is installed there and nothing written there
lands here. ``vcan0`` is up when the command starts.

    python -m guest -- candump -n 1 vcan0          (with tests/vcan on PYTHONPATH; or: make guest CMD="…")
"""

from __future__ import annotations

from guest.machine import Guest, GuestError, GuestResult, missing_tools, run

__all__ = ["Guest", "GuestError", "GuestResult", "missing_tools", "run"]
