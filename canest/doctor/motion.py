"""How fast the vehicle is before and after each moment of a stretch: whether it gets faster or slower."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.doctor.stretches import Samples, at
from canest.doctor.switches import SPEEDS
from canest.vehicle.facts import Vehicle

#: a stretch is looked at every 0.1 s, over 0.5 s either way
_STEP_US, STEP_S, _HALF_US = 100_000, 0.1, 500_000
#: and at most so long: stamps may leap, and a table may come in one block
_LONGEST_US = 20_000_000_000


class Motion(NamedTuple):
    """Stamps in us, speed 0.5 s before and after each in m/s, acceleration between in m/s2; all (n,)."""

    stamps: IntColumn
    before_mps: FloatColumn
    after_mps: FloatColumn
    accel_mps2: FloatColumn


def motion_of(stretch: Samples, vehicle: Vehicle) -> Motion | None:
    """Return the motion by the finest speed of a stretch, None without any."""
    role = next((role for role in SPEEDS if role in stretch), None)
    if role is None:
        return None
    first, last = int(stretch[role][0].min()), int(stretch[role][0].max())
    stamps = np.arange(first, min(last, first + _LONGEST_US), _STEP_US, dtype=np.int64)
    factor = vehicle.mps_per_shaft_rpm if role == "output_shaft_speed" else 1.0
    before, after = (at(stamps + d, stretch[role]) * factor for d in (-_HALF_US, _HALF_US))
    return Motion(stamps, before, after, (after - before) * (0.5e6 / _HALF_US))
