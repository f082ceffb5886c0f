"""The endpoints for other programs: local sockets for `canest status` and live views, HTTP for Prometheus.

The estimation needs neither: one that cannot be opened at the start is logged, and the daemon runs without.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from canest.bus.sandbox import socket_error_text
from canest.config.schema import Config
from canest.core.errors import ConfigError, UsageError
from canest.system.files import Background, write_atomically
from canest.system.journal import Journal
from canest.telemetry.live_protocol import stream_path
from canest.telemetry.live_stream import LiveStream
from canest.telemetry.metrics import MetricsServer
from canest.telemetry.status_socket import StatusServer, published_path, refuse_second_daemon, socket_path


class Endpoints:
    """The endpoints that a config names; `move` opens and closes what a changed one asks for.

    latest: the snapshot that HTTP serves; the daemon keeps it up to date.
    Errors: UsageError when a metrics port is asked for without the package that serves it.
    """

    def __init__(self, config: Config, journal: Journal, background: Background) -> None:
        self._journal, self._background = journal, background
        self.latest: dict[str, Any] = {}
        self.metrics: MetricsServer | None = None
        self.status: StatusServer | None = None
        self.live: LiveStream | None = None
        port = config.service.metrics_port
        if port is not None:
            try:
                self.metrics = MetricsServer(port, self.latest)
            except OSError as error:
                journal.warning("no-metrics-port", port=port, error=socket_error_text(error, "AF_INET"))
        self._open_status(socket_path(config))

    def move(self, config: Config) -> None:
        """Move to the socket and port of a changed config.

        Errors: ConfigError when the port cannot be had, UsageError as above; nothing has changed then.
        """
        path = socket_path(config)
        socket_moves = self.status is None or self.status.path != path or not path.exists()
        if socket_moves:
            refuse_second_daemon(path)
        port = config.service.metrics_port
        old = self.metrics
        if port != (None if old is None else old.port):
            try:
                self.metrics = None if port is None else MetricsServer(port, self.latest)
            except OSError as error:
                what = f"cannot be opened ({socket_error_text(error, 'AF_INET')})"
                raise ConfigError(what, where=config.at("service.metrics_port"), found=port) from error
            if old is not None:  # its thread takes half a second to end, and the loop must not wait
                self._background.submit("metrics_port", old.close)
        if socket_moves:
            self._open_status(path)

    @property
    def watched(self) -> bool:
        """Return whether a live view is connected."""
        return self.live is not None and self.live.watched

    def answer(self, content: Callable[[], dict[str, Any]]) -> None:
        """Answer those who wait on the local sockets; call it once a second."""
        if self.status is not None:
            if self.status.is_lost:
                self._journal.warning("status-socket-lost", path=self.status.path)
                with contextlib.suppress(UsageError):  # another daemon took it just now
                    self._open_status(self.status.path)
            self.status.poll(content)
        if self.live is not None:
            self.live.poll(content)

    def close(self) -> None:
        """Stop answering on the local sockets; the HTTP server ends with the process."""
        for server in (self.status, self.live):
            if server is not None:
                server.close()

    def _open_status(self, path: Path) -> None:
        try:
            new = StatusServer(path, partial(self._publish, published_path(path)))
        except OSError as error:
            self._journal.warning("no-status-socket", path=path, error=error.strerror or error)
            return
        if self.status is not None:
            self.status.close(keep_name=self.status.path == path)
        self.status = new
        self._open_live(stream_path(path))

    def _open_live(self, path: Path) -> None:
        if self.live is not None:
            self.live.close()
            self.live = None
        try:
            self.live = LiveStream(path)
        except OSError as error:
            self._journal.warning("no-live-socket", path=path, error=error.strerror or error)

    def _publish(self, path: Path, answer: bytes) -> None:
        write = partial(write_atomically, path, answer, durable=False)
        self._background.submit("status", write, newest_only=True)
