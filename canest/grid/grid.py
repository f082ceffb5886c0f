"""Sample and hold onto ticks: a value at tick t comes from samples stamped at or before t, nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from canest.columns import constant
from canest.frames import BoolColumn, FloatColumn, IntColumn
from canest.vehicle.samples import STEP_US

_NEVER_US = -(1 << 62)
_FOREVER_US = 1 << 61
_NOTHING = (_NEVER_US, math.nan)


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
        #: role -> the sample in force: its stamp and value
        self._held: dict[str, tuple[int, float]] = {c.role: _NOTHING for c in channels}
        #: role -> samples not yet passed by a tick
        self._ahead: dict[str, tuple[IntColumn, FloatColumn]] = {}
        self._next_us: int | None = None
        self._continues = False

    def restart(self, first_us: int, *, clock_set_back: bool) -> None:
        """Go on at ``first_us`` after a gap, or in a new epoch (then old stamps mean nothing any more)."""
        self._next_us = -(-first_us // STEP_US) * STEP_US
        self._continues = False
        if clock_set_back:
            self._held = dict.fromkeys(self._held, _NOTHING)
            self._ahead.clear()

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
                before = self._ahead.get(role)
                if before is not None:
                    t_us = np.concatenate((before[0], t_us))
                    value = np.concatenate((before[1], value))
                self._ahead[role] = t_us, value

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
            values[channel.role], stale[channel.role] = self._column(channel, t_us)
        block = GridBlock(t_us, values, stale, self._continues)
        self._next_us += count * STEP_US
        self._continues = True
        return block

    def _column(self, channel: Channel, t_us: IntColumn) -> tuple[FloatColumn, BoolColumn]:
        """Return what one channel shows at ticks (n,) and where that is too old; pass its samples."""
        role, shift_us, n = channel.role, self._shift_us[channel.role], len(t_us)
        held_us, held = self._held[role]
        ahead = self._ahead.get(role)
        newest_us = int(t_us[-1]) - shift_us
        if ahead is None or ahead[0][0] > newest_us:
            freshest_us = int(t_us[0]) - shift_us - held_us
            if newest_us - held_us <= channel.stale_us:
                return constant(held, n), constant(False, n)
            if freshest_us > channel.stale_us:
                return constant(math.nan, n), constant(True, n)
            ahead = np.empty(0, np.int64), np.empty(0)
        seen_us = t_us - shift_us if shift_us else t_us
        at = ahead[0].searchsorted(seen_us, side="right")
        stamps = np.concatenate(([held_us], ahead[0]))
        samples = np.concatenate(([held], ahead[1]))
        value = samples[at]
        old = seen_us - stamps[at] > channel.stale_us
        if np.count_nonzero(old):
            value = np.where(old, np.nan, value)
        passed = int(at[-1])
        if passed:
            self._held[role] = int(stamps[passed]), float(samples[passed])
            if passed < len(ahead[0]):
                self._ahead[role] = ahead[0][passed:], ahead[1][passed:]
            else:
                del self._ahead[role]
        return value, old
