"""Sample and hold onto ticks: a value at tick t comes from samples stamped at or before t, nothing else.

Long blocks go in columns; the few ticks of a live one go one by one, where numpy's cost per call would
rule. Both give the same bits.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from canest.core.columns import constant
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import STEP_US
from canest.grid.between import Between

_NEVER_US = -(1 << 62)
FOREVER_US = 1 << 61  #: older than any sample can be
_NOTHING = (_NEVER_US, math.nan)
_FEW = 50  #: ticks up to which the path one by one is faster; samples of a role that are kept as lists for it

_TimedColumn = tuple[IntColumn, FloatColumn]
_Lists = tuple[list[int], list[float]]


class Channel(NamedTuple):
    """How one role is held: ``delay_us`` it reports late, ``stale_us`` it may age.

    between: what it is between two reports (`canest.grid.between`); None holds the last one. Then
    ``wait_us`` is how long a report waits for the next one at most, and ``stale_us`` how far two that are
    joined may lie apart.
    """

    role: str
    delay_us: int = 0
    stale_us: int = FOREVER_US
    between: Between | None = None
    wait_us: int = 0


def behind_us(channels: Iterable[Channel]) -> int:
    """Return how long before a tick it is what the tick shows, for the latest of the channels, us."""
    return max((c.delay_us + c.wait_us for c in channels), default=0)


class Feed(NamedTuple):
    """One monotone stretch of decoded samples.

    samples: role -> (t_us, value); no value is minus zero. jump, before_us: how it follows what came before
    (`canest.grid.clock`). first_us, last_us: stamps of its first and last wanted frame.
    """

    samples: Mapping[str, tuple[IntColumn, FloatColumn]]
    jump: str
    before_us: int | None
    first_us: int
    last_us: int


@dataclass(frozen=True, slots=True, eq=False)
class GridBlock:
    """Consecutive ticks.

    t_us: int64 (n,), multiples of 20 ms. values: role -> float64 (n,), the held sample, NaN when it was
    "not available", is stale, or was never seen. stale: role -> bool (n,), too old, or never seen.
    continues: False when this block does not follow the previous one tick by tick.
    """

    t_us: IntColumn
    values: dict[str, FloatColumn]
    stale: dict[str, BoolColumn]
    continues: bool

    def __len__(self) -> int:
        return len(self.t_us)

    def split(self, at: int) -> tuple[GridBlock, GridBlock]:
        """Return the ticks before a position, and those from there on."""
        return self._part(slice(at), self.continues), self._part(slice(at, None), self.continues or at > 0)

    def _part(self, cut: slice, continues: bool) -> GridBlock:
        values = {role: column[cut] for role, column in self.values.items()}
        stale = {role: column[cut] for role, column in self.stale.items()}
        return GridBlock(self.t_us[cut], values, stale, continues)


class Grid:
    """Holds the last sample of every channel and hands out finished ticks.

    Channels that report late are waited for: with the largest delay D, tick t shows every channel as it
    was at t - D, so torque and speed describe the same moment. Where reports are joined, the
    next one is waited for likewise.
    """

    def __init__(self, channels: Sequence[Channel], hold_us: int) -> None:
        self._channels, self._hold_us = channels, hold_us
        #: D: every tick shows the vehicle as it was so long before
        self.behind_us = behind_us(channels)
        self._shift_us = {c.role: self.behind_us - c.delay_us for c in channels}
        #: role -> the sample in force: its stamp and value
        self._held: dict[str, tuple[int, float]] = {c.role: _NOTHING for c in channels}
        #: role -> samples not yet passed by a tick
        self._ahead: dict[str, _TimedColumn | _Lists] = {}
        self._next_us: int | None = None
        self._continues = False

    def restart(self, first_us: int, *, clock_set_back: bool) -> None:
        """Go on at ``first_us`` after a gap, or in a new epoch (then old stamps mean nothing any more)."""
        self._next_us = -(-first_us // STEP_US) * STEP_US
        self._continues = False
        if clock_set_back:
            self._held = {c.role: self._lasting(c, first_us) for c in self._channels}
            self._ahead.clear()

    def _lasting(self, channel: Channel, now_us: int) -> tuple[int, float]:
        """Return what is left of a channel in a new epoch: the last value, where it never grows too old."""
        role = channel.role
        stamps, samples = self._ahead.get(role) or ([self._held[role][0]], [self._held[role][1]])
        if channel.stale_us < FOREVER_US or stamps[-1] == _NEVER_US:
            return _NOTHING
        return now_us, float(samples[-1])

    def waiting(self, role: str) -> int:
        """Return how many samples of a role no tick has passed yet."""
        return len(self._ahead[role][0]) if role in self._ahead else 0

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
            if not len(t_us):
                continue
            before = self._ahead.get(role)
            if len(t_us) > _FEW or (before is not None and len(before[0]) > _FEW):
                if before is not None:
                    t_us = np.concatenate((before[0], t_us))
                    value = np.concatenate((before[1], value))
                last = t_us[1:] != t_us[:-1]
                if not last.all():  # no tick sees the others: stamps that stand still must not pile up
                    t_us, value = (np.append(c[:-1][last], c[-1]) for c in (t_us, value))
                self._ahead[role] = t_us, value
            elif before is None:
                self._ahead[role] = t_us.tolist(), value.tolist()
            else:
                self._ahead[role] = [*before[0], *t_us.tolist()], [*before[1], *value.tolist()]

    def ticks_until(self, end_us: int, *, inclusive: bool) -> GridBlock | None:
        """Return all ticks before ``end_us`` (or up to and including it), None when there is none."""
        if self._next_us is None:
            return None
        count = (end_us - self._next_us) // STEP_US + 1
        if not inclusive and self._next_us + (count - 1) * STEP_US == end_us:
            count -= 1
        if count <= 0:
            return None
        ticks = range(self._next_us, self._next_us + count * STEP_US, STEP_US)
        t_us = np.arange(ticks.start, ticks.stop, ticks.step, dtype=np.int64)
        values: dict[str, FloatColumn] = {}
        stale: dict[str, BoolColumn] = {}
        for channel in self._channels:
            role = channel.role
            ahead = self._ahead.get(role)
            newest_us = ticks[-1] - self._shift_us[role]
            if channel.between is not None:
                values[role], stale[role] = self._joined(channel, t_us)
            elif ahead is None or ahead[0][0] > newest_us:
                values[role], stale[role] = self._held_on(channel, t_us)
            elif count <= _FEW and isinstance(ahead[0], list):
                values[role], stale[role] = self._one_by_one(channel, ticks, *ahead)
            else:
                values[role], stale[role] = self._in_columns(channel, t_us, *map(np.asarray, ahead))
        block = GridBlock(t_us, values, stale, self._continues)
        self._next_us = ticks.stop
        self._continues = True
        return block

    def _held_on(self, channel: Channel, t_us: IntColumn) -> tuple[FloatColumn, BoolColumn]:
        """Return what a channel without a new sample shows at ticks (n,), and where that is too old."""
        held_us, held = self._held[channel.role]
        n, shift_us = len(t_us), self._shift_us[channel.role]
        if int(t_us[-1]) - shift_us - held_us <= channel.stale_us:
            return constant(held, n), constant(False, n)
        if int(t_us[0]) - shift_us - held_us > channel.stale_us:
            return constant(math.nan, n), constant(True, n)
        old = t_us - shift_us - held_us > channel.stale_us
        return np.where(old, np.nan, held), old

    def _joined(self, channel: Channel, t_us: IntColumn) -> tuple[FloatColumn, BoolColumn]:
        """Return what a slow channel shows at ticks (n,) and where its next report is missing; pass samples.

        At tick t only reports stamped at or before t are joined, as everywhere.
        """
        role, seen_us = channel.role, t_us - self._shift_us[channel.role]
        held_us, held = self._held[role]
        stamps, samples = map(np.asarray, self._ahead.get(role) or ([], []))
        all_us = np.concatenate(([held_us], stamps)).astype(np.int64)
        value = np.concatenate(([held], samples))
        at = stamps.searchsorted(seen_us, side="right")
        after = np.minimum(at + 1, len(stamps))
        known = (after > at) & (all_us[after] <= t_us)
        span_us = np.where(known, all_us[after] - all_us[at], 1)
        share = (seen_us - all_us[at]) / span_us
        old = np.where(known, span_us > channel.stale_us, seen_us != all_us[at])
        assert channel.between is not None
        joined = np.where(known, channel.between(value[at], value[after], share), value[at])
        if passed := int(at[-1]):
            self._pass(role, passed, stamps, samples)
        return np.where(old, np.nan, joined), old

    def _one_by_one(
        self, channel: Channel, ticks: range, stamps: list[int], samples: list[float]
    ) -> tuple[FloatColumn, BoolColumn]:
        """Return what a channel shows at ticks (n,) and where that is too old; pass its samples."""
        role, stale_us, shift_us, n = channel.role, channel.stale_us, self._shift_us[channel.role], len(ticks)
        held_us, held = self._held[role]
        newest_us = ticks[-1] - shift_us
        passed = bisect_right(stamps, newest_us)
        new = samples[:passed]
        self._pass(role, passed, stamps, samples)
        fresh = newest_us - held_us <= stale_us
        if fresh and new.count(held) == passed:  # most signals seldom change
            return constant(held, n), constant(False, n)
        at = [bisect_right(stamps, t - shift_us) for t in ticks]
        new.insert(0, held)
        value = [new[i] for i in at]
        if fresh:
            return np.array(value), constant(False, n)
        ages_us = [t - shift_us - (stamps[i - 1] if i else held_us) for t, i in zip(ticks, at, strict=True)]
        old = [age_us > stale_us for age_us in ages_us]
        value = [math.nan if too_old else v for v, too_old in zip(value, old, strict=True)]
        return np.array(value), np.array(old)

    def _in_columns(
        self, channel: Channel, t_us: IntColumn, stamps: IntColumn, samples: FloatColumn
    ) -> tuple[FloatColumn, BoolColumn]:
        """Return the same as `_one_by_one`, for many ticks or samples."""
        role, stale_us = channel.role, channel.stale_us
        held_us, held = self._held[role]
        first_us, last_us = (int(end) - self._shift_us[role] for end in (t_us[0], t_us[-1]))
        passed = int(stamps.searchsorted(last_us, side="right"))
        new_us = stamps[:passed]
        tick = (new_us - (first_us - STEP_US + 1)) // STEP_US  # the first one that sees a sample
        at = np.bincount(np.maximum(tick, 0), minlength=len(t_us)).cumsum()
        value = np.concatenate(([held], samples[:passed]))[at]
        self._pass(role, passed, stamps, samples)
        ends_us = int(new_us[0]) - held_us, last_us - int(new_us[-1])
        if max(*ends_us, (new_us[1:] - new_us[:-1]).max(initial=0)) <= stale_us:
            return value, constant(False, len(t_us))
        old = t_us - self._shift_us[role] - np.concatenate(([held_us], new_us))[at] > stale_us
        return np.where(old, np.nan, value), old

    def _pass(
        self, role: str, passed: int, stamps: list[int] | IntColumn, samples: list[float] | FloatColumn
    ) -> None:
        """The first ``passed`` samples ahead lie behind the newest tick: the last of them is held."""
        self._held[role] = int(stamps[passed - 1]), float(samples[passed - 1])
        if passed < len(stamps):
            self._ahead[role] = stamps[passed:], samples[passed:]  # type: ignore[assignment]
        else:
            del self._ahead[role]
