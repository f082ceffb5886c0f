"""One-second means of open samples: where the residual is measured.

A second is long enough that speed quantisation and driveline oscillation average out, and short enough
that torque steps, gears and fans do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import RATE_HZ

WINDOW_TICKS = round(RATE_HZ)  #: one second
#: windows that belong together in cross-validation and in standard errors: errors of a road, of the wind
#: and of a driver last for seconds, not for one window
CHUNK_S = 8.0


@dataclass(frozen=True)
class Windows:
    """Which ticks each window averages: index (ticks,), -1 outside; chunk (n,) and middle t_s (n,)."""

    index: IntColumn
    count: int
    chunk: IntColumn
    t_s: FloatColumn

    def mean(self, x: FloatColumn) -> FloatColumn:
        """Return the mean of a tick column over each window (n,)."""
        inside = self.index >= 0
        return np.bincount(self.index[inside], weights=x[inside], minlength=self.count) / WINDOW_TICKS


def windows_of(open_: BoolColumn, t_s: FloatColumn, usable: BoolColumn) -> Windows:
    """Cut runs of open, usable samples into whole windows (a run's remainder is left out).

    t_s: seconds since the start, which never go back; where they stand still the clock was set back.
    """
    good = open_ & usable & np.isfinite(t_s)
    follows = np.zeros(len(good), np.bool_)
    step_s = np.diff(t_s)
    follows[1:] = good[1:] & good[:-1] & (step_s > 0.0) & (step_s < 0.03)
    starts = np.flatnonzero(good & ~follows)
    lengths = np.diff(np.append(np.cumsum(good)[starts] - 1, good.sum()))
    index = np.full(len(good), -1, np.int64)
    count = 0
    for start, length in zip(starts.tolist(), lengths.tolist(), strict=True):
        whole = length // WINDOW_TICKS
        span = whole * WINDOW_TICKS
        index[start : start + span] = count + np.arange(span) // WINDOW_TICKS
        count += whole
    inside = index >= 0
    centre = np.bincount(index[inside], weights=t_s[inside] - t_s[0], minlength=count) / WINDOW_TICKS
    return Windows(index, count, (centre // CHUNK_S).astype(np.int64), centre)
