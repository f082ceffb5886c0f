"""The longitudinal model's working columns: what each force term reads and changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from canest.core.columns import constant
from canest.core.frames import BoolColumn, FloatColumn, IntColumn


@dataclass(slots=True, eq=False)
class ModelColumns:
    """One block of ticks on its way from signals to forces; all columns (n,), unfiltered.

    torque_Nm: net torque at the crank (indicated less friction), positive drives.
    engine_radps: crank speed. ratio: total ratio crank to wheel. gear: gear number (0 unknown).
    radius_m: rolling radius. efficiency: driveline efficiency, crank to wheel.
    crank_inertia_kgm2, wheel_inertia_kgm2: rotating parts. speed_mps, accel_mps2: of the vehicle.
    wind_mps: against the motion. drag_area_m2, density_kgpm3: aerodynamics. mu: rolling resistance.
    extra_N: other forces along the road, positive drives (retarder at the output shaft, brake drag).
    wheel_torque_Nm: measured torque at the wheels, NaN where the crank torque is used.
    signals: every held role by name. elapsed_s: event time since the first sample of the stream.
    """

    t_us: IntColumn
    elapsed_s: FloatColumn
    torque_Nm: FloatColumn
    engine_radps: FloatColumn
    ratio: FloatColumn
    gear: FloatColumn
    radius_m: FloatColumn
    efficiency: FloatColumn
    crank_inertia_kgm2: FloatColumn
    wheel_inertia_kgm2: FloatColumn
    speed_mps: FloatColumn
    accel_mps2: FloatColumn
    wind_mps: FloatColumn
    drag_area_m2: FloatColumn
    density_kgpm3: FloatColumn
    mu: FloatColumn
    extra_N: FloatColumn
    wheel_torque_Nm: FloatColumn
    signals: Mapping[str, FloatColumn]
    #: columns that a term hands on to later terms or to the diagnosis
    auxiliary: dict[str, FloatColumn] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_us)

    def signal(self, role: str, missing: float = 0.0) -> FloatColumn:
        """Return a held role, ``missing`` where it has no value."""
        column = self.signals.get(role)
        if column is None:
            return constant(missing, len(self))
        unknown = np.isnan(column)
        return np.where(unknown, missing, column) if np.count_nonzero(unknown) else column

    def on(self, role: str, threshold: float = 0.5) -> BoolColumn:
        """Return where a switch or level is above a threshold (False where unknown)."""
        column = self.signals.get(role)
        return constant(False, len(self)) if column is None else column > threshold
