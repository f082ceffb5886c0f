"""An electric car on short full-throttle runs, each ended by the friction brake, which no signal reports."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MASS_KG, RADIUS_M, RATIO, DRAG_AREA_M2, MU = 1800.0, 0.316, 7.94, 0.65, 0.009
CONFIG: dict[str, Any] = {
    "vehicle": {
        "mass_min_kg": 1000,
        "mass_max_kg": 2600,
        "wheel_radius_m": RADIUS_M,
        "wheel_inertia_kgm2": 3.0,
        "final_drive": 1.0,
        "gear_ratios": {1: RATIO},
        "driveline_efficiency": 0.97,
        "engine_inertia_kgm2": 0.03,
        "drag_area_m2": DRAG_AREA_M2,
        "rolling_resistance": MU,
    },
    "dbc": [],
    "signals": {"engine_torque": {"column": "torque"}, "vehicle_speed": {"column": "speed"}},
}
_EFFICIENCY, _INERTIA_KG = 0.97, 3.0 / RADIUS_M**2 + 0.97 * 0.03 * (RATIO / RADIUS_M) ** 2
_DT, _MOST_NM, _MOST_W = 0.01, 320.0, 110e3


def launches(seed: int, runs: int = 3) -> dict[str, NDArray[np.float64]]:
    """Return `t_s`, `speed` (m/s) and `torque` (N m) at 25 Hz, each (n,); the car weighs `MASS_KG`.

    Every run: full torque, limited in power, up to 15 to 28 m/s; 0.3 to 1 s of neither pedal; the friction
    brake with 2.5 to 6 m/s2 beside 0.4 m/s2 of recuperation, down to a stop of 10 s. Every few seconds of
    standing give the road another slope, of 1 % rms; torque is true within 1 %.
    """
    rng = np.random.default_rng(seed)
    gain, rows, t, v, torque = 1.0 + 0.01 * rng.normal(), [], 0.0, 0.0, 0.0
    for _ in range(runs):
        top, brake, slope = rng.uniform(15.0, 28.0), rng.uniform(2.5, 6.0), 0.01 * rng.normal()
        coast_s = rng.uniform(0.3, 1.0)
        phase, since = "stand", 0.0
        while phase != "done":
            wanted, braking = 0.0, 0.0
            if phase == "drive":
                wanted = min(_MOST_NM, _MOST_W / max(v * RATIO / RADIUS_M, 1.0))
            elif phase == "brake":
                wanted = -0.4 * MASS_KG * RADIUS_M / RATIO if v > 3.0 else 0.0
                braking = brake * MASS_KG * min(since / 0.4, 1.0)
            torque += (wanted - torque) * _DT / 0.15
            loss = _EFFICIENCY if torque > 0.0 else 1.0 / _EFFICIENCY
            force = loss * torque * RATIO / RADIUS_M - 0.6 * DRAG_AREA_M2 * v * v - braking
            force -= MASS_KG * 9.80665 * (slope + (MU if v > 0.0 else 0.0))
            held = phase == "stand" or (v == 0.0 and force < 0.0)
            v = 0.0 if held else max(v + force / (MASS_KG + _INERTIA_KG) * _DT, 0.0)
            rows.append((t, v, torque * gain))
            t, since = t + _DT, since + _DT
            ended = {
                "stand": since > 10.0,
                "drive": v > top,
                "coast": since > coast_s,
                "brake": v == 0.0,
            }[phase]
            if ended:
                phase = {"stand": "drive", "drive": "coast", "coast": "brake", "brake": "done"}[phase]
                since = 0.0
    table = np.array(rows)[::4]
    speed = np.round(table[:, 1] + 0.005 * rng.normal(size=len(table)), 2)
    return {"t_s": table[:, 0], "speed": np.maximum(speed, 0.0), "torque": np.round(table[:, 2] * 2.0) / 2.0}
