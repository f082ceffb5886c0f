"""Signs that a sender is not who it says it is. They are reported, never acted upon.

J1939 has no authentication: whoever sends under the right address is believed. Two things still show:
several addresses that send one signal (`canest.decode.counters`), and an address that suddenly sends much
more than it used to, as it does when a second node sends under it too.
"""

from __future__ import annotations

from dataclasses import dataclass

from canest.decode.counters import Counters

WINDOW_S = 5.0  #: rates are means over this time
FASTER = 1.6  #: a second sender at the same period makes it 2
_LEARN_WINDOWS = 6  #: half a minute, before a rate is known
_SLOWEST_GAIN = 1 / 120  #: a rate that has changed for good is the usual one after some 10 minutes
_FEWEST_FRAMES = 20  #: per window; below it a rate says little

Key = tuple[int, int | None]  #: group (or identifier) and source address


@dataclass(slots=True)
class _SenderRate:
    """How many frames a sender had at the last look, and what it sends usually."""

    frames: int = 0
    usual_hz: float = 0.0
    windows: int = 0


class SenderRateMonitor:
    """Watches the rates of the senders that the config uses.

    faster: senders beyond their usual rate just now, with that rate and the present one (Hz).
    seconds: for how long each sender has been faster so far.
    """

    def __init__(self) -> None:
        self.faster: dict[Key, tuple[float, float]] = {}
        self.seconds: dict[Key, float] = {}
        self._rates: dict[Key, _SenderRate] = {}
        self._since_s: float | None = None

    def look(self, counters: Counters, now_s: float) -> None:
        """Take note of the counters; to be called once a second (``now_s``: monotonic)."""
        if self._since_s is None:
            self._since_s = now_s
        elapsed_s = now_s - self._since_s
        if elapsed_s < WINDOW_S:
            return
        self._since_s = now_s
        for key, sender in counters.senders.items():
            if sender.used:
                self._judge(key, sender.frames, elapsed_s)

    def _judge(self, key: Key, frames: int, elapsed_s: float) -> None:
        sender = self._rates.setdefault(key, _SenderRate())
        fresh, sender.frames = frames - sender.frames, frames
        if fresh < _FEWEST_FRAMES:  # silent, slow, or counted anew
            self.faster.pop(key, None)
            return
        rate_hz = fresh / elapsed_s
        sender.windows += 1
        gain = _SLOWEST_GAIN
        if sender.windows > _LEARN_WINDOWS and rate_hz > FASTER * sender.usual_hz:
            self.faster[key] = sender.usual_hz, rate_hz
            self.seconds[key] = self.seconds.get(key, 0.0) + elapsed_s
        else:
            self.faster.pop(key, None)
            gain = max(1 / sender.windows, gain)
        sender.usual_hz += (rate_hz - sender.usual_hz) * gain
