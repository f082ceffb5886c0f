"""What a slow signal is between two reports: what its ends allow.

A speed that comes once a second and is held makes a step of the acceleration each time, which filters take
for a force. Joined by a line it needs the report that comes next, so ticks are as far behind as reports are
apart (`Channel.wait_us`). That is the same for a log and for a bus.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from canest.core.frames import FloatColumn

#: two reports of a ratio are the same within this share
_SAME_SHARE = 0.03

#: (report before, report after, how far between them: 0 to 1), each (n,) -> value (n,)
Between = Callable[[FloatColumn, FloatColumn, FloatColumn], FloatColumn]


@np.errstate(over="ignore", invalid="ignore")  # reports may be any float: the model judges what comes out
def line(before: FloatColumn, after: FloatColumn, share: FloatColumn) -> FloatColumn:
    """Return the value on the straight line between the reports; NaN where either is."""
    return before + share * (after - before)


def larger(before: FloatColumn, after: FloatColumn, share: FloatColumn) -> FloatColumn:
    """Return the report that is further from zero: a brake may have acted since the one before."""
    return np.where(np.abs(after) > np.abs(before), after, before)


def smaller(before: FloatColumn, after: FloatColumn, share: FloatColumn) -> FloatColumn:
    """Return the report that is nearer to zero: a driveline may have been open since the one before."""
    return np.where(np.abs(after) < np.abs(before), after, before)


def unchanged(before: FloatColumn, after: FloatColumn, share: FloatColumn) -> FloatColumn:
    """Return the report before where the one after is the same, else NaN: a shift lies between them."""
    return np.where(np.abs(after - before) <= _SAME_SHARE * np.abs(before), before, np.nan)


def earlier(before: FloatColumn, after: FloatColumn, share: FloatColumn) -> FloatColumn:
    """Return the report before: a lever has nothing between two values."""
    return before
