"""Senders that send much more than usual: a second node may be sending under their address.

J1939 has no authentication, so frames under the right address are used whoever sends them. Two things show
nevertheless: several addresses that send one signal (`canest.decode.counters`), and an address whose frame
rate rises suddenly. Both are reported and change no estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

from canest.decode.counters import Counters

WINDOW_S = 5.0  #: rates are means over this time
FASTER = 1.6  #: a second sender at the same period makes it 2
_LEARN_WINDOWS = 6  #: half a minute, before a rate is known
_SLOWEST_GAIN = 1 / 120  #: a rate that has changed for good is the usual one after some 10 minutes
_FEWEST_FRAMES = 20  #: per window; the rate of fewer varies too much

Key = tuple[int, int | None]  #: group (or identifier) and source address


@dataclass(slots=True)
class _SenderRate:
    """A sender's frames at the last update, its usual rate, and the windows that rate comes from."""

    frames: int = 0
    usual_hz: float = 0.0
    windows: int = 0


class SenderRateMonitor:
    """Compares the present rate of every sender that the config uses with its usual rate.

    faster: senders above `FASTER` times their usual rate now -> (usual rate, present rate), Hz.
    faster_s: for how long each sender has been faster so far, seconds.
    """

    def __init__(self) -> None:
        self.faster: dict[Key, tuple[float, float]] = {}
        self.faster_s: dict[Key, float] = {}
        self._rates: dict[Key, _SenderRate] = {}
        self._since_s: float | None = None

    def update(self, counters: Counters, now_s: float) -> None:
        """Read the frame counters; call it once a second (``now_s``: monotonic)."""
        if self._since_s is None:
            self._since_s = now_s
        elapsed_s = now_s - self._since_s
        if elapsed_s < WINDOW_S:
            return
        self._since_s = now_s
        for key, sender in counters.senders.items():
            if sender.used:
                self._update_sender(key, sender.frames, elapsed_s)

    def _update_sender(self, key: Key, frames: int, elapsed_s: float) -> None:
        rate = self._rates.setdefault(key, _SenderRate())
        new, rate.frames = frames - rate.frames, frames
        if new < _FEWEST_FRAMES:  # silent, slow, or counted anew
            self.faster.pop(key, None)
            return
        rate_hz = new / elapsed_s
        rate.windows += 1
        gain = _SLOWEST_GAIN
        if rate.windows > _LEARN_WINDOWS and rate_hz > FASTER * rate.usual_hz:
            self.faster[key] = rate.usual_hz, rate_hz
            self.faster_s[key] = self.faster_s.get(key, 0.0) + elapsed_s
        else:
            self.faster.pop(key, None)
            gain = max(1 / rate.windows, gain)
        rate.usual_hz += (rate_hz - rate.usual_hz) * gain
