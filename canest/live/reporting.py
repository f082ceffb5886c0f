"""What the daemon reports of itself: status socket, systemd's status line, log of changes, metrics."""

from __future__ import annotations

from canest.config.schema import Config
from canest.live.outputs import Outputs
from canest.system.files import Background
from canest.system.journal import Journal
from canest.system.systemd_notify import Notifier
from canest.telemetry.daemon_view import DaemonView
from canest.telemetry.endpoints import Endpoints
from canest.telemetry.live_rows import LiveRows
from canest.telemetry.snapshot import flat, snapshot
from canest.telemetry.state_changes import StateChangeLog
from canest.telemetry.status_text import status_line

METRICS_S = 10.0  #: period of the metrics


class Reporter:
    """Reports once a second (`report`), and logs all counters on request.

    endpoints: where other programs ask; None until `open`. live_rows: what `stream` sends to live views.
    """

    def __init__(self, journal: Journal, notifier: Notifier, background: Background) -> None:
        self._journal, self._notifier, self._background = journal, notifier, background
        self.endpoints: Endpoints | None = None
        self.live_rows = LiveRows()
        self._changes = StateChangeLog(journal)
        self._metrics_at_s = 0.0

    def open(self, config: Config) -> None:
        """Open the status socket and the metrics port. Errors: UsageError, see `Endpoints`."""
        self.endpoints = Endpoints(config, self._journal, self._background)

    def report(self, view: DaemonView, outputs: Outputs, now_s: float) -> None:
        """Answer status requests, log changes, and write the metrics when they are due."""
        if self.endpoints is not None:
            self.endpoints.answer(lambda: snapshot(view))
            self.live_rows.wanted = self.endpoints.watched
        self._changes.log(view)
        self._notifier.status(status_line(view))
        if now_s >= self._metrics_at_s:
            self._metrics_at_s = now_s + METRICS_S
            if outputs.wants_metrics:
                content = snapshot(view)
                outputs.write_metrics(content)
                if self.endpoints is not None:
                    self.endpoints.latest.update(content)

    def stream(self, quiet_s: float | None, *, is_current: bool) -> None:
        """Send live views what the last estimation gave.

        quiet_s: since the last frame, None: none yet. is_current: whether the newest estimate is of now.
        """
        if self.live_rows.wanted and self.endpoints is not None and self.endpoints.live is not None:
            quiet_s = None if quiet_s is None else round(quiet_s, 2)
            newest = self.live_rows.newest if is_current else None
            self.endpoints.live.send_rows(self.live_rows.take(), newest, quiet_s)

    def log_counters(self, view: DaemonView) -> None:
        """Log the whole snapshot as one line of key=value."""
        self._journal.notice("counters", **flat(snapshot(view)))

    def close(self) -> None:
        """Close the local sockets."""
        if self.endpoints is not None:
            self.endpoints.close()
