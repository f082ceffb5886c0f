"""The slope of a vehicle that coasts: a line through its raw speeds (docs/theory.md, section 4.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S

#: ticks in which a driveline comes to rest after it has opened, and in which it has closed before it is
#: reported closed
SETTLES, EARLY = 6, 8
#: ticks of a line: fewer show too little, after more the slope may be another
FEWEST, LONGEST = 8, 50
#: ticks that a line looks back to
REACH = SETTLES + LONGEST + EARLY
#: no air and no retarder pulls harder, N; no road makes a vehicle roll faster and faster than this, m/s2
MOST_N, MOST_MPS2 = 1e7, 4.0


def run_lengths(ticks: FloatColumn, coasting_N: FloatColumn, before: float) -> FloatColumn:
    """Return how many samples the vehicle has coasted for, without one missing, by each of them, (n,).

    ticks, coasting_N (NaN: no coasting): (n + 1,), the first that of the sample before, after `before` ticks.
    """
    coasts = np.abs(coasting_N) <= MOST_N
    index = np.arange(len(ticks), dtype=np.float64)
    begins = np.where(coasts, index - 1.0, index)  # as if the run had begun on the sample before
    breaks = ~coasts
    breaks[1:] |= np.diff(ticks) != 1.0
    begins[0], breaks[0] = -before, True
    return (index - np.maximum.accumulate(np.where(breaks, begins, -np.inf)))[1:]


def line(speed_mps: FloatColumn) -> tuple[float, float]:
    """Return the slope of speeds one tick apart, m/s2, and its variance: noise, and what the line bends."""
    n = len(speed_mps)
    x = (np.arange(n) - 0.5 * (n - 1)) * STEP_S
    sxx = float(np.sum(x * x))
    square = x * x - sxx / n
    squares = float(np.sum(square * square))
    v = speed_mps - speed_mps[0]
    slope, bend = float(np.sum(v * x)) / sxx, float(np.sum(v * square)) / squares
    off = v - np.sum(v) / n - slope * x - bend * square
    noise = float(np.sum(off * off)) / (n - 3)
    turned = max(bend * bend - noise / squares, 0.0) * (n * STEP_S) ** 2
    return slope, noise / sxx + turned


def lines(
    run: FloatColumn, coasting_N: FloatColumn, rotating_kg: FloatColumn, speed_mps: FloatColumn,
    ends: NDArray[np.int64], window: int,
) -> FloatColumn:  # fmt: skip
    """Return the line that ended in each window: acceleration, variance, force, mass, time back, (5, w).

    run: `run_lengths` of the samples (n,). ends: samples that end windows of `window` ticks, (w,). A line
    ends with its coasting, or when it is `LONGEST`. NaN where none has ended.
    """
    out = np.full((5, len(ends)), np.nan)
    usable = run - SETTLES - EARLY
    coasts = np.flatnonzero(usable > 0.0)
    lengths = usable[coasts] % LONGEST
    full = lengths == 0.0
    stops = (lengths >= FEWEST) & (np.append(run, np.inf)[coasts + 1] <= 1.0)
    for at in np.flatnonzero(full | stops):
        last, n = int(coasts[at]), int(lengths[at]) or LONGEST
        seen = last if full[at] else last + 1  # that it has stopped is known a sample later
        w = int(np.searchsorted(ends, seen))
        if w < len(ends) and seen > ends[w] - window and last - EARLY - n + 1 >= 0:
            rows = slice(last - EARLY - n + 1, last - EARLY + 1)
            slope, var = line(speed_mps[rows])
            if abs(slope) <= MOST_MPS2 and var <= MOST_MPS2 * MOST_MPS2:
                back_s = (ends[w] - last + EARLY + 0.5 * (n - 1)) * STEP_S
                out[:, w] = slope, var, np.sum(coasting_N[rows]) / n, rotating_kg[last - EARLY], back_s
    return out
