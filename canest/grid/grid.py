"""Sample and hold onto ticks: a value at tick t comes from samples stamped at or before t, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from canest.frames import BoolColumn, FloatColumn, IntColumn
from canest.vehicle.samples import STEP_US

_NEVER_US = -(1 << 62)
_FOREVER_US = 1 << 61


@dataclass(frozen=True, slots=True)
class Channel:
    """How one role is held: ``delay_us`` it reports late, ``stale_us`` it may age."""

    role: str
    delay_us: int = 0
    stale_us: int = _FOREVER_US


@dataclass(frozen=True, slots=True)
class Feed:
    """One monotone stretch of decoded samples.

    samples: role -> (t_us, value). jump, before_us: how it follows what came before (`canest.grid.clock`).
    first_us, last_us: stamps of its first and last wanted frame.
    """

    samples: Mapping[str, tuple[IntColumn, FloatColumn]]
    jump: str
    before_us: int | None
    first_us: int
    last_us: int


@dataclass(frozen=True, slots=True)
class GridBlock:
    """Consecutive ticks.

    t_us: int64 (n,), multiples of 20 ms. values: role -> float64 (n,), the held sample, NaN when it said
    "not available", is stale, or was never seen. stale: role -> bool (n,), too old, or never seen.
    continues: False when this block does not follow the previous one tick by tick.
    """

    t_us: IntColumn
    values: dict[str, FloatColumn]
    stale: dict[str, BoolColumn]
    continues: bool

    def __len__(self) -> int:
        return len(self.t_us)


class Grid:
    """Holds the last sample of every channel and hands out finished ticks.

    Channels that report late are waited for: with the largest delay D, tick t shows every channel as it
    was at t - D, so torque and speed describe the same moment.
    """

    def __init__(self, channels: list[Channel], hold_us: int) -> None:
        self._channels, self._hold_us = channels, hold_us
        longest = max((c.delay_us for c in channels), default=0)
        self._shift_us = {c.role: longest - c.delay_us for c in channels}
        #: role -> samples not yet passed by a tick, led by the one in force
        self._t: dict[str, IntColumn] = {c.role: np.array([_NEVER_US], np.int64) for c in channels}
        self._v: dict[str, FloatColumn] = {c.role: np.array([np.nan]) for c in channels}
        self._next_us: int | None = None
        self._continues = False

    def restart(self, first_us: int, *, clock_set_back: bool) -> None:
        """Go on at ``first_us`` after a gap, or in a new epoch (then old stamps mean nothing any more)."""
        self._next_us = -(-first_us // STEP_US) * STEP_US
        self._continues = False
        if clock_set_back:
            for role, v in self._v.items():
                self._t[role] = np.array([_NEVER_US], np.int64)
                self._v[role] = v[-1:]

    def take(self, feed: Feed) -> list[GridBlock]:
        """Take one stretch of samples; return the runs of ticks it completes.

        A tick is complete when something later than it has been seen. After a silence the old stretch
        is held on for ``hold_us``, then time goes on where the new one starts.
        """
        blocks = []
        if feed.jump:
            if feed.before_us is not None:
                held = self._hold_us if feed.jump == "gap" else 0
                blocks.append(self.ticks_until(feed.before_us + held, inclusive=not held))
            self.restart(feed.first_us, clock_set_back=feed.jump == "back")
        self.push(feed.samples)
        blocks.append(self.ticks_until(feed.last_us, inclusive=False))
        return [b for b in blocks if b is not None]

    def push(self, samples: Mapping[str, tuple[IntColumn, FloatColumn]]) -> None:
        """Take samples (stamps not before those already passed)."""
        for role, (t_us, value) in samples.items():
            if len(t_us):
                self._t[role] = np.concatenate((self._t[role], t_us))
                self._v[role] = np.concatenate((self._v[role], value))

    def ticks_until(self, end_us: int, *, inclusive: bool) -> GridBlock | None:
        """Return all ticks before ``end_us`` (or up to and including it), None when there is none."""
        if self._next_us is None:
            return None
        count = (end_us - self._next_us) // STEP_US + 1
        if not inclusive and self._next_us + (count - 1) * STEP_US == end_us:
            count -= 1
        if count <= 0:
            return None
        t_us = np.arange(self._next_us, self._next_us + count * STEP_US, STEP_US, dtype=np.int64)
        values: dict[str, FloatColumn] = {}
        stale: dict[str, BoolColumn] = {}
        for channel in self._channels:
            role = channel.role
            stamps = self._t[role]
            seen_us = t_us - self._shift_us[role] if self._shift_us[role] else t_us
            if len(stamps) == 1 and stamps[0] <= seen_us[0]:
                at = np.zeros(count, np.int64)
            else:
                at = stamps.searchsorted(seen_us, side="right") - 1
            value = self._v[role][at]
            old = seen_us - stamps[at] > channel.stale_us
            values[role] = np.where(old, np.nan, value) if old.any() else value
            stale[role] = old
            passed = int(at[-1])
            if passed:
                self._t[role] = stamps[passed:]
                self._v[role] = self._v[role][passed:]
        block = GridBlock(t_us, values, stale, self._continues)
        self._next_us += count * STEP_US
        self._continues = True
        return block
