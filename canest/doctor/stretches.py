"""Gathers samples of some roles into stretches that are long enough to compare them with each other."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from canest.core.columns import finite
from canest.core.frames import FloatColumn, IntColumn

Samples = dict[str, tuple[IntColumn, FloatColumn]]

#: signals are compared over stretches of at least this, however small the blocks they come in
STRETCH_US = 5_000_000
#: or over so many samples: stamps may stand still, or be those of many senders
MOST_WAITING = 50_000
#: no quantity of a vehicle is larger, in the unit of any role; a float on the bus may be
LARGEST = 1e9


def comparable(samples: Samples) -> Samples:
    """Return samples without a value where there is a number that no vehicle has: sums would overflow."""
    return {role: (t_us, _without_large(values)) for role, (t_us, values) in samples.items()}


def _without_large(values: FloatColumn) -> FloatColumn:
    if not len(values) or (values.max() < LARGEST and values.min() > -LARGEST):  # not with a NaN
        return values
    return np.where(np.abs(values) < LARGEST, values, np.nan)


class Stretches:
    """Keeps the samples of ``roles`` until a stretch is full; memory does not grow with the log."""

    def __init__(self, roles: Collection[str]) -> None:
        self._roles = tuple(roles)
        self._waiting: dict[str, list[tuple[IntColumn, FloatColumn]]] = {}
        self.waiting = 0  #: samples
        self._since_us: int | None = None

    def add(self, samples: Samples) -> int | None:
        """Take the samples of a block; return the stamp of the latest one, None where there is none."""
        latest_us = None
        for role in self._roles:
            if role in samples and len(stamps := samples[role][0]):
                self._waiting.setdefault(role, []).append(samples[role])
                self.waiting += len(stamps)
                if self._since_us is None or stamps[0] < self._since_us:
                    self._since_us = int(stamps[0])
                latest_us = max(latest_us or 0, int(stamps[-1]))
        return latest_us

    def push(self, samples: Samples) -> Samples | None:
        """Take the samples of a block; return a stretch when one is full."""
        latest_us = self.add(samples)
        if latest_us is None or self._since_us is None:
            return None
        full = latest_us - self._since_us >= STRETCH_US or self.waiting > MOST_WAITING
        return self.rest() if full else None

    def rest(self) -> Samples:
        """Return what has come since the last stretch, and begin another."""
        self._since_us, self.waiting = None, 0
        stretch = {role: _joined(parts) for role, parts in self._waiting.items()}
        self._waiting.clear()
        return stretch


def _joined(parts: list[tuple[IntColumn, FloatColumn]]) -> tuple[IntColumn, FloatColumn]:
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([t for t, _ in parts]), np.concatenate([v for _, v in parts])


def known(samples: tuple[IntColumn, FloatColumn]) -> tuple[IntColumn, FloatColumn]:
    """Return the samples that have a value."""
    t_us, values = samples
    if finite(values) is values:
        return samples
    rows = np.isfinite(values)
    return t_us[rows], values[rows]


def at(stamps: IntColumn, samples: tuple[IntColumn, FloatColumn]) -> FloatColumn:
    """Return a signal at other stamps (n,), NaN before its first sample and after its last."""
    t_us, values = known(samples)
    if not len(values):
        return np.full(len(stamps), np.nan)
    return np.asarray(np.interp(stamps, t_us, values, left=np.nan, right=np.nan), np.float64)


def held(stamps: IntColumn, samples: tuple[IntColumn, FloatColumn]) -> FloatColumn:
    """Return a state at other stamps (n,): that of the last sample before, NaN where there is none."""
    index = np.searchsorted(samples[0], stamps, side="right") - 1
    return np.where(index >= 0, samples[1][np.maximum(index, 0)], np.nan)
