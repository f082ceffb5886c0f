"""What the source has sent, kept for pages that open, and handed to the pages that are open.

A page that reads too slowly misses rows and statuses: what it gets is of now, and no queue grows.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import json
import time
from typing import Any

from canest.serve.changes import Changes
from canest.serve.history import RANGED, History, WallClock
from canest.system.clock import elapsed_s
from canest.telemetry.live_protocol import Row

MOST_PAGES = 16  #: open at once
BACKLOG_BYTES = 1 << 18  #: of rows and statuses that may wait for one page
LATE_S = 0.25  #: for so long at most; what comes later is newer
STUCK_S = 20.0  #: a page that has not read what waits for so long is closed
SILENT_S = 1.2  #: a source without a message for so long does not answer


class Page:
    """An open page: where its events go."""

    def __init__(self, transport: asyncio.WriteTransport) -> None:
        self._transport = transport
        self._waiting_since_s = elapsed_s()

    def send(self, event: bytes, now_s: float, *, needed: bool) -> None:
        """Send an event at ``now_s`` of `elapsed_s`; one that is not needed only if little waits already."""
        waiting = self._transport.get_write_buffer_size()
        if not waiting:
            self._waiting_since_s = now_s
        late_s = now_s - self._waiting_since_s
        if late_s > STUCK_S:
            self._transport.abort()
        elif needed or (late_s < LATE_S and waiting + len(event) <= BACKLOG_BYTES):
            self._transport.write(event)


class Hub:
    """State of one source, and the pages that follow it.

    source: what is watched, for a person. problem: why there is no source now ('' when there is one).
    """

    def __init__(self, source: str) -> None:
        self.source = source
        self.problem = f"waiting for {source}"
        self.pages: set[Page] = set()
        self.history: History | None = None
        self._names: dict[str, Any] = {}
        self._status: dict[str, Any] | None = None
        self._status_at_s = 0.0
        self._newest: Row | None = None
        self._newest_at_s = 0.0
        self._quiet_s: float | None = None
        self._clock = WallClock()
        self._message_s = 0.0
        self.changes = Changes(lambda change: self._send("change", change))

    def take(self, message: dict[str, Any]) -> None:
        """Take one message of `canest.telemetry.live_protocol`. Errors: ValueError, KeyError, TypeError."""
        self._message_s = time.monotonic()
        if self.problem:
            self.problem = ""
            self.changes.of_source("")
            self._send_source()
        if "rows" in message:
            self._take_rows(message)
        elif "status" in message:
            self._status, self._status_at_s = message["status"], elapsed_s()
            self.changes.of_snapshot(message["status"])
            self._send("status", self._status)
        elif "columns" in message:
            self._take_names({name: message[name] for name in ("columns", "gates", "statuses")})

    def join(self, page: Page) -> None:
        """Let a page in. It gets an event at once, by whose time it knows how late later ones are."""
        self.pages.add(page)
        self._send_source()

    def lose(self, problem: str) -> None:
        """Note that the source is gone, and why; repeated, it shows open pages that this server runs."""
        self.problem = problem
        self._quiet_s = None
        self.changes.of_source(problem)
        self._send_source()

    def check(self) -> None:
        """Note a source that is connected and silent; call it twice a second."""
        if self.problem:
            self._send_source()
            return
        silent_s = time.monotonic() - self._message_s
        if silent_s > SILENT_S:
            self.lose(f"{self.source} has sent nothing for {silent_s:.0f} s")

    def opening(self) -> bytes:
        """Return what a page needs when it opens, as JSON compressed by gzip."""
        history = self.history
        content = {
            "columns": [],
            **self._names,
            **self._source(),
            "sent_s": round(elapsed_s(), 3),
            "recent": [] if history is None else list(history.recent),
            "day_columns": ["t_s", "open", *(f"{name}_{end}" for name in RANGED for end in ("low", "high"))],
            "day": [] if history is None else history.day(),
            "newest": self._newest,
            "newest_at_s": round(self._newest_at_s, 3),
            "quiet_s": self._quiet_s,
            "status": self._status,
            "status_at_s": round(self._status_at_s, 3),
            "changes": list(self.changes.last),
        }
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        return gzip.compress(text.encode(), compresslevel=1)

    def _take_names(self, names: dict[str, Any]) -> None:
        """Begin anew where a row of before would be misread; open pages then ask for the history again."""
        if names != self._names:
            self.history, self._names, self._newest = History(names["columns"]), names, None
            self._send("reset", {})

    def _take_rows(self, message: dict[str, Any]) -> None:
        newest: Row | None = message["newest"]
        rows: list[Row] = message["rows"]
        self._quiet_s = message["quiet_s"]
        if newest is not None and self.history is not None:
            now_s, newest_s = time.time() - (self._quiet_s or 0.0), float(newest[0] or 0.0)
            for row in rows:
                row[0] = self._clock.utc_s(float(row[0] or 0.0), newest_s, now_s)
                self.history.add(row)
            newest = [self._clock.utc_s(newest_s, newest_s, now_s), *newest[1:]]
            self._newest, self._newest_at_s = newest, elapsed_s() - (self._quiet_s or 0.0)
        self.changes.of_rows(self._status_name(newest), self._quiet_s)
        self._send("rows", {"rows": rows, "newest": newest, "quiet_s": self._quiet_s})

    def _status_name(self, newest: Row | None) -> str | None:
        if newest is None or self.history is None:
            return None
        code = newest[self.history.columns.index("status")]
        return None if code is None else str(self._names["statuses"][int(code)])

    def _source(self) -> dict[str, Any]:
        return {"source": self.source, "problem": self.problem, "now_s": round(time.time(), 2)}

    def _send_source(self) -> None:
        self._send("source", self._source())

    def _send(self, event: str, content: Any) -> None:
        if not self.pages:
            return
        text, now_s = json.dumps(content, separators=(",", ":"), allow_nan=False), elapsed_s()
        data = f"id: {now_s:.3f}\nevent: {event}\ndata: {text}\n\n".encode()
        for page in self.pages.copy():
            with contextlib.suppress(OSError):
                page.send(data, now_s, needed=event not in ("rows", "status"))
