"""Notifies systemd of the daemon's state (sd_notify(3)): datagrams to $NOTIFY_SOCKET, none without it."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Mapping


class Notifier:
    """The service's side of ``Type=notify-reload``.

    watchdog_s: systemd's deadline (None without a watchdog); ping at half of it.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self.watchdog_s = _watchdog_s(environment)
        self._socket: socket.socket | None = None
        self._status = ""
        self._ping_at_s = 0.0

    def ready(self) -> None:
        """Start-up, or a reload, is complete."""
        self._send("READY=1")

    def reloading(self) -> None:
        """A reload begins; `ready` ends it."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """The daemon is about to end."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """One line for ``systemctl status``; sent only when it changed."""
        if text != self._status:
            self._status = text
            self._send("STATUS=" + text.replace("\n", " "))

    def ping_watchdog(self, now_s: float) -> None:
        """The estimation loop has made progress (``now_s``: monotonic); pings at half the deadline."""
        if self.watchdog_s is not None and now_s >= self._ping_at_s:
            self._ping_at_s = now_s + self.watchdog_s / 2
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Let the socket go."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        # a supervisor that does not listen is no reason to stop estimating
        with contextlib.suppress(OSError):
            if self._socket is None:
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
                self._socket.setblocking(False)
            self._socket.sendto(message.encode(), address)


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    try:
        deadline_s = int(environment.get("WATCHDOG_USEC", "")) * 1e-6
        pid = int(environment.get("WATCHDOG_PID", os.getpid()))
    except ValueError:
        return None
    return deadline_s if deadline_s > 0 and pid == os.getpid() else None
