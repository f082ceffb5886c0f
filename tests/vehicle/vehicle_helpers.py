"""Shared by the vehicle's tests: a truck with round numbers, and ticks with chosen signals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from canest.config.schema import Config
from canest.core.samples import STEP_US
from canest.grid.grid import GridBlock

RADIUS_M, FINAL_DRIVE, EFFICIENCY = 0.5, 4.0, 0.9
ENGINE_INERTIA, WHEEL_INERTIA = 3.0, 100.0
REFERENCE_NM, FRICTION_PCT = 2000.0, 5.0
DRAG_AREA_M2, DENSITY, MU = 6.0, 1.2, 0.006
VEHICLE: dict[str, Any] = {
    "mass_min_kg": 8_000,
    "mass_max_kg": 32_000,
    "wheel_radius_m": RADIUS_M,
    "wheel_inertia_kgm2": WHEEL_INERTIA,
    "final_drive": FINAL_DRIVE,
    "gear_ratios": {1: 8.0, 2: 4.0, 3: 2.0, 4: 1.0},
    "driveline_efficiency": EFFICIENCY,
    "engine_inertia_kgm2": ENGINE_INERTIA,
    "reference_torque_Nm": REFERENCE_NM,
    "friction_torque_pct": FRICTION_PCT,
    "drag_area_m2": DRAG_AREA_M2,
    "air_density_kgpm3": DENSITY,
    "rolling_resistance": MU,
}


def config(
    roles: Sequence[str],
    effects: Sequence[dict[str, Any]] = (),
    vehicle: dict[str, Any] | None = None,
    required: Sequence[str] = (),
    **sections: Any,
) -> Config:
    return Config.model_validate(
        {
            "vehicle": VEHICLE | (vehicle or {}),
            "dbc": [],
            "signals": {r: {"column": r, "optional": r not in required} for r in roles},
            "effects": list(effects),
            **sections,
        }
    )


def ticks(
    values: dict[str, Any],
    n: int = 2,
    first: int = 0,
    continues: bool = False,
    stale: Sequence[str] = (),
) -> GridBlock:
    """``n`` ticks; a value is a number for all of them or one per tick; roles in ``stale`` are too old."""
    columns = {r: np.broadcast_to(np.asarray(v, float), (n,)).copy() for r, v in values.items()}
    for role in stale:
        columns[role] = np.full(n, np.nan)
    return GridBlock(
        (first + np.arange(n, dtype=np.int64)) * STEP_US,
        columns,
        {r: np.full(n, r in stale) for r in columns},
        continues,
    )
