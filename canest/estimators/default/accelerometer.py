"""Accelerometer fault detection: its changes against those of speed and traction (docs/theory.md, 4.2)."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from canest.core import jit
from canest.estimators.default.constants import Vehicle
from canest.estimators.default.model import Window

#: a second, in windows; a change of the acceleration that is no noise, m/s2
_SECOND, _CHANGE_MPS2 = 5.0, 0.2
#: nor the rounding of a coarse speed: four times what that makes of a change, sqrt(6) stds a second
_ROUNDED_1PS = 10.0
#: squares of such changes, (m/s2)2: how many decide, and how many are remembered
_FEWEST, _MOST = 1.5, 20.0
#: seconds for the gain by the traction: how many decide, and how many are remembered
_FEWEST_S, _MOST_S = 10.0, 300.0
#: share by which a sound sensor shows too little, and too much, which few changes tell less well
_LITTLE, _MUCH, _OF_FEW_M2PS4 = 0.06, 0.08, 0.4
#: a sensor that was faulty is sound again where its gain is surely so near
_SURELY = 0.10
#: stds that are no chance
_STDS = 3.0
#: slower than this a speed sensor's pulses are too rare, m/s
_MOVING_MPS = 2.0


class Comparison(NamedTuple):
    """Sums over the second that is under way, means of the one before, and the sums of products.

    Of the changes from second to second of acceleration (v), sensor (x) and traction (F); e = x - (1 + p) v.
    """

    sensed: float = 0.0
    accel: float = 0.0
    traction: float = 0.0
    windows: float = 0.0
    sensed_before: float = 0.0
    traction_before: float = 0.0
    accel_before: float = math.nan
    vv: float = 0.0  #: of large changes, as vx
    vx: float = 0.0
    seconds: float = 0.0  #: of all, as the others
    Fv: float = 0.0
    Fx: float = 0.0
    FF: float = 0.0
    ee: float = 0.0
    faulty: bool = False


#: where the means of the second before begin, and the sums of products
_BEFORE: Final = 4
_PRODUCTS: Final = 7
#: those of a comparison that begins
_NO_PRODUCTS: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@jit.kernel
def verdict(c: Comparison, v: Vehicle) -> float:
    """Return 1 where the sensor's gain is another one than `1 + p`, -1 where it is surely that, else 0.

    What a road does to the speed a sensor does not feel, so vx / vv is its gain or less. A road does not know
    the traction, so Fx / Fv is its gain, or more where the driver answers the road.
    """
    ratio, unknown = 1.0 + v.pitch, v.pitch_slack
    if c.vv >= _FEWEST and c.vx > c.vv * ratio * (1.0 + unknown + _MUCH + _OF_FEW_M2PS4 / c.vv):
        return 1.0
    if c.seconds < _FEWEST_S or c.Fv <= 0.0:
        return 0.0
    due = ratio * c.Fv
    std = _STDS * math.sqrt(c.ee / c.seconds * c.FF)
    if due - c.Fx > (unknown + _LITTLE) * due + std:
        return 1.0
    return -1.0 if abs(c.Fx - due) + std < (unknown + _SURELY) * due else 0.0


@jit.kernel
def compare(c: Comparison, w: Window, v: Vehicle) -> Comparison:
    """Return the comparison after one more window."""
    if math.isnan(w.sensed_mps2) or w.speed_mps <= _MOVING_MPS or w.gap_s > 0.0:
        return Comparison(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, *c[_PRODUCTS:])
    sensed, accel = c.sensed + w.sensed_mps2, c.accel + w.accel_mps2
    traction, windows = c.traction + w.traction_N, c.windows + 1.0
    if windows < _SECOND:
        return Comparison(sensed, accel, traction, windows, *c[_BEFORE:])
    sensed, accel, traction = sensed / _SECOND, accel / _SECOND, traction / _SECOND
    if math.isnan(c.accel_before):
        return Comparison(0.0, 0.0, 0.0, 0.0, sensed, traction, accel, *c[_PRODUCTS:])
    vv, vx, seconds, Fv, Fx, FF, ee, was_faulty = c[_PRODUCTS:]
    dv, dx, dF = accel - c.accel_before, sensed - c.sensed_before, traction - c.traction_before
    if abs(dv) > max(_CHANGE_MPS2, _ROUNDED_1PS * v.speed_floor_mps):
        left = min(_MOST / (vv + dv * dv), 1.0)
        vv, vx = left * (vv + dv * dv), left * (vx + dv * dx)
    e, left = dx - (1.0 + v.pitch) * dv, min(_MOST_S / (seconds + 1.0), 1.0)
    seconds, ee = left * (seconds + 1.0), left * (ee + e * e)
    Fv, Fx, FF = left * (Fv + dF * dv), left * (Fx + dF * dx), left * (FF + dF * dF)
    done = Comparison(
        0.0, 0.0, 0.0, 0.0, sensed, traction, accel, vv, vx, seconds, Fv, Fx, FF, ee, was_faulty
    )
    found = verdict(done, v)
    if found == 0.0 or (found < 0.0 and not was_faulty):
        return done
    # what comes next is judged by itself
    return Comparison(0.0, 0.0, 0.0, 0.0, sensed, traction, accel, *_NO_PRODUCTS, found > 0.0)
