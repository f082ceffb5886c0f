"""The live stream: a second local socket, on which the daemon sends rows and its status to watchers.

What it sends is described in `canest.telemetry.live_protocol`.

Sending never waits. A watcher that has not read what a minute brings is closed, and connects again.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from canest import __version__
from canest.core.gates import LABELS
from canest.node.estimate_frame import STATUS_NAMES
from canest.telemetry.live_protocol import COLUMNS, Row

MOST_WATCHERS = 8  #: the page and each publisher are one
_BACKLOG_BYTES = 1 << 18  #: a minute of rows and statuses


class LiveStream:
    """Sends to whoever connects, at most `MOST_WATCHERS`. `poll` costs one system call when nobody does.

    Errors: OSError when the socket cannot be opened. The caller makes sure that no other daemon has the name.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        path.unlink(missing_ok=True)  # left behind by a daemon that was killed
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.bind(str(path))
        path.chmod(0o666)  # as the status: everybody who reaches the directory may read
        self._created_ns = path.stat().st_mtime_ns
        self._socket.listen(MOST_WATCHERS)
        self._watchers: list[socket.socket] = []

    @property
    def watched(self) -> bool:
        """Return whether anybody watches."""
        return bool(self._watchers)

    def poll(self, status: Callable[[], dict[str, Any]]) -> None:
        """Let new watchers in, and send every watcher the status; call it once a second."""
        with contextlib.suppress(OSError):
            for _ in range(MOST_WATCHERS):  # the loop waits for nobody, however many come
                self._welcome(self._socket.accept()[0])
        if self._watchers:
            self._send({"status": status()})

    def send_rows(self, rows: list[Row], newest: Row | None, quiet_s: float | None) -> None:
        """Send what the last estimation gave, also when it gave nothing: a quiet bus shows by it."""
        self._send({"rows": rows, "newest": newest, "quiet_s": quiet_s})

    def close(self, *, keep_name: bool = False) -> None:
        """Let all watchers go and take the socket's name away, unless it is another one's by now."""
        for watcher in self._watchers:
            watcher.close()
        self._watchers.clear()
        self._socket.close()
        with contextlib.suppress(OSError):
            if not keep_name and self.path.stat().st_mtime_ns == self._created_ns:
                self.path.unlink()

    def _welcome(self, watcher: socket.socket) -> None:
        watcher.setblocking(False)
        watcher.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BACKLOG_BYTES)
        if len(self._watchers) >= MOST_WATCHERS:
            with watcher, contextlib.suppress(OSError):
                watcher.send(_line({"refused": f"{MOST_WATCHERS} programs watch this daemon already"}))
            return
        self._watchers.append(watcher)
        first = {"canest": __version__, "columns": COLUMNS, "gates": LABELS, "statuses": STATUS_NAMES}
        self._send(first, [watcher])

    def _send(self, message: dict[str, Any], to: list[socket.socket] | None = None) -> None:
        line = _line(message)
        for watcher in self._watchers.copy() if to is None else to:
            try:
                whole = watcher.send(line) == len(line)
            except OSError:  # it has left, or does not read
                whole = False
            if not whole:  # the rest of a line would have to be kept for it
                watcher.close()
                self._watchers.remove(watcher)


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"
