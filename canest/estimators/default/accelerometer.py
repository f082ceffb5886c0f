"""Accelerometer fault detection: its changes against those of the speed (docs/theory.md, section 4.2)."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from canest.core import jit
from canest.estimators.default.model import Window

#: a second, in windows; a change of the acceleration that is no noise, m/s2
_SECOND, _CHANGE_MPS2 = 5.0, 0.2
#: nor the rounding of a coarse speed: four times what that makes of a change, sqrt(6) stds a second
_ROUNDED_1PS = 10.0
#: squares of changes, (m/s2)2: how many decide, and how many are remembered
_FEWEST, _MOST = 1.5, 5.0
#: share of a change that a sound accelerometer shows: 0.8 to 1.1 on trucks and cars, more on soft springs,
#: less where a road changes the speed, which it does not feel; one in g shows 0.1
_LEAST_SHARE, _MOST_SHARE = 0.25, 1.6
#: slower than this a speed sensor's pulses are too rare, m/s
_MOVING_MPS = 2.0


class Comparison(NamedTuple):
    """Sums over the second that is under way, means of the one before, and the sums of squares."""

    sensed: float = 0.0
    accel: float = 0.0
    windows: float = 0.0
    sensed_before: float = 0.0
    accel_before: float = math.nan
    squares: float = 0.0
    products: float = 0.0
    faulty: bool = False


#: where the means of the second before begin, and the sums of squares
_BEFORE: Final = 3
_SQUARES: Final = 5


@jit.kernel
def compare(c: Comparison, w: Window, rounding_mps: float) -> Comparison:
    """Return the comparison after one more window. rounding_mps: std of the speed within its resolution."""
    if math.isnan(w.sensed_mps2) or w.speed_mps <= _MOVING_MPS or w.gap_s > 0.0:
        return Comparison(0.0, 0.0, 0.0, c.sensed_before, math.nan, *c[_SQUARES:])
    sensed, accel, windows = c.sensed + w.sensed_mps2, c.accel + w.accel_mps2, c.windows + 1.0
    if windows < _SECOND:
        return Comparison(sensed, accel, windows, *c[_BEFORE:])
    sensed, accel, squares, products, faulty = sensed / _SECOND, accel / _SECOND, *c[_SQUARES:]
    change = accel - c.accel_before
    if abs(change) > max(_CHANGE_MPS2, _ROUNDED_1PS * rounding_mps):
        squares += change * change
        products += change * (sensed - c.sensed_before)
        left = min(_MOST / squares, 1.0)
        squares *= left
        products *= left
        sound = _LEAST_SHARE * squares < products < _MOST_SHARE * squares
        faulty = not (sound or squares < _FEWEST)
    return Comparison(0.0, 0.0, 0.0, sensed, accel, squares, products, faulty)
