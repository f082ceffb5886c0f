"""Log lines for a person on call: one event a line, key=value, rate-limited, in journald's stderr form.

Under systemd every line starts with its priority, ``<4>``, which journald takes off again; elsewhere the
line starts with the time of day and a word. What nobody reads is held back: no line is ever waited for.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from collections.abc import Callable, Mapping
from typing import TextIO

ERROR, WARNING, NOTICE = 3, 4, 5  #: syslog priorities
_WORDS = {ERROR: "error", WARNING: "warning", NOTICE: "notice"}

BURST = 5  #: lines of one event at once
REFILL_S = 30.0  #: then one more per this time
_EVENTS_KEPT = 256
_CHUNK = 1024  #: characters, so at most 4096 bytes, which a pipe that takes anything takes at once


class Journal:
    """Writes events; an event that repeats is held back, and the next line has its count."""

    def __init__(
        self,
        stream: TextIO | None = None,
        environment: Mapping[str, str] = os.environ,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._journald = "JOURNAL_STREAM" in environment
        self._clock_s = clock_s
        #: event -> (tokens, when counted, lines held back since)
        self._buckets: dict[str, tuple[float, float, int]] = {}
        self._truncated = False  #: the last line lacks its end

    def error(self, event: str, **fields: object) -> bool:
        """Something does not work and somebody has to see to it. Returns whether it was written."""
        return self._log(ERROR, event, fields)

    def warning(self, event: str, **fields: object) -> bool:
        """Something went wrong and was dealt with. Returns whether it was written."""
        return self._log(WARNING, event, fields)

    def notice(self, event: str, **fields: object) -> bool:
        """A change worth knowing. Returns whether it was written."""
        return self._log(NOTICE, event, fields)

    def has_room(self, event: str) -> bool:
        """Return whether the next line of an event would be written."""
        return self._tokens(event) >= 1 and self._is_writable()

    def _log(self, priority: int, event: str, fields: dict[str, object]) -> bool:
        held_back = self._admit(event)
        if held_back is None:
            return False
        if held_back:
            fields = fields | {"held_back": held_back}
        text = " ".join([event, *(f"{key}={_value(value)}" for key, value in fields.items())])
        if self._journald:
            line = f"<{priority}>{text}\n"
        else:
            line = f"{time.strftime('%H:%M:%S')} {_WORDS[priority]}: {text}\n"
        with contextlib.suppress(OSError, ValueError):  # a closed or full stderr must not end the estimation
            self._write("\n" + line if self._truncated else line)
        return True

    def _write(self, line: str) -> None:
        self._truncated = False
        for at in range(0, len(line), _CHUNK):
            if at and not self._is_writable():
                self._truncated = True
                return
            self._stream.write(line[at : at + _CHUNK])
            self._stream.flush()

    def _is_writable(self) -> bool:
        """Return False where a line would have to wait for a reader (a pipe that is full)."""
        try:
            return bool(select.select([], [self._stream], [], 0)[1])
        except (OSError, ValueError):  # closed, or no file of the system: then writing does not wait either
            return True

    def _tokens(self, event: str) -> float:
        """Return how many lines of an event may be written now."""
        tokens, counted_s, _ = self._buckets.get(event, (float(BURST), self._clock_s(), 0))
        return min(float(BURST), tokens + (self._clock_s() - counted_s) / REFILL_S)

    def _admit(self, event: str) -> int | None:
        """Return how many lines of this event were held back before this one, None to hold it back too."""
        now_s, tokens = self._clock_s(), self._tokens(event)
        held_back = self._buckets[event][2] if event in self._buckets else 0
        if len(self._buckets) >= _EVENTS_KEPT and event not in self._buckets:
            self._buckets.clear()
        if not self.has_room(event):
            self._buckets[event] = tokens, now_s, held_back + 1
            return None
        self._buckets[event] = tokens - 1, now_s, 0
        return held_back


def _value(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    text = "".join(c if c.isprintable() else " " for c in text)
    return f'"{text}"' if " " in text or not text else text
