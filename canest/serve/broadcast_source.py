"""Listens to the broadcast on a bus, for a page on a machine that has no daemon."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

from canest.bus.link import open_link, require_interface
from canest.config.schema import Config
from canest.core.gates import LABELS
from canest.decode import j1939
from canest.node.estimate_frame import STATUS_NAMES, Estimate
from canest.serve.watcher import Watcher
from canest.telemetry.broadcast_view import LiveView
from canest.telemetry.live_protocol import COLUMNS, DECIMALS, Row
from canest.telemetry.status_text import NOT_AVAILABLE

POLL_S = 0.1
_STATUS_POLLS = 10  #: polls between two statuses


class BroadcastSource:
    """Receives from the bus of a config, and never sends. Errors: ConfigError, BusError, UsageError.

    name: what is watched, for a person.
    """

    def __init__(self, config: Config) -> None:
        require_interface(config.bus, config.at)
        self._config = config
        self.name = f"the broadcast on {config.bus.interface}:{config.bus.channel}"
        self._receiver, _ = open_link(config.bus, [j1939.kernel_filter(config.broadcast.pgn)], transmit=False)
        self._view = LiveView(config.broadcast.pgn, self.name)
        self._received_s: float | None = None

    async def follow(self, watcher: Watcher) -> None:
        """Hand what is received to the watcher, for ever."""
        watcher.take({"columns": COLUMNS, "gates": LABELS, "statuses": STATUS_NAMES})
        polls = 0
        while True:
            for message in self.messages(with_status=polls % _STATUS_POLLS == 0):
                watcher.take(message)
            polls += 1
            await asyncio.sleep(POLL_S)

    def messages(self, *, with_status: bool) -> list[dict[str, Any]]:
        """Receive what has arrived; return messages as those of `canest.telemetry.live_stream`."""
        now_s = time.monotonic()
        frames = self._receiver.drain().frames
        new = False
        for can_id, length, word in zip(
            frames.can_id.tolist(), frames.length.tolist(), frames.data.tolist(), strict=True
        ):
            new = self._view.take(can_id, word.to_bytes(8, "little")[:length], now_s) or new
        if new:
            self._received_s = now_s
        row = _row(self._view.estimate)
        quiet_s = None if self._received_s is None else round(now_s - self._received_s, 2)
        rows = [row.copy()] if new else []
        found: list[dict[str, Any]] = [{"rows": rows, "newest": row if new else None, "quiet_s": quiet_s}]
        return [*found, {"status": self._status(quiet_s)}] if with_status else found

    def _status(self, quiet_s: float | None) -> dict[str, Any]:
        estimate, bus = self._view.estimate, self._config.bus
        names = ("mass_kg", "mass_std_kg", "grade", "grade_std")
        return {
            "vehicle": self._config.vehicle.name,
            "bus": {
                "interface": bus.interface, "channel": bus.channel, "state": self._receiver.state,
                "reason": self._receiver.reason, "quiet_s": quiet_s, **self._receiver.counters,
            },
            "estimate": {
                **{name: _number(getattr(estimate, name), name) for name in names},
                "status": STATUS_NAMES[estimate.status],
                "gate": LABELS.get(estimate.gate, NOT_AVAILABLE),
            },
            "broadcast": {**self._view.counters},
        }  # fmt: skip


def _row(estimate: Estimate) -> Row:
    known = {
        "t_s": time.time(), "mass_kg": estimate.mass_kg, "mass_std_kg": estimate.mass_std_kg,
        "grade": estimate.grade, "grade_std": estimate.grade_std, "status": estimate.status,
        "gate": estimate.gate if estimate.gate in LABELS else math.nan,
    }  # fmt: skip
    return [_number(known.get(name, math.nan), name) for name in COLUMNS]


def _number(value: float, column: str) -> float | None:
    return round(value, DECIMALS[column] or None) if math.isfinite(value) else None
