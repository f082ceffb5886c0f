"""What takes a live stream: the page's hub, and the publishers."""

from __future__ import annotations

from typing import Any, Protocol


class Watcher(Protocol):
    """Takes the messages of `canest.telemetry.live_protocol`, from a daemon or made of a broadcast."""

    def take(self, message: dict[str, Any]) -> None:
        """Take one message. Errors: ValueError, KeyError, TypeError for one that is none."""

    def lose(self, problem: str) -> None:
        """Note that the source is gone, and why; called again as long as it is."""
