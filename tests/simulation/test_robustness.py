"""Whatever is asked for, the motion stays physical and the frames stay in order."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.simulation import simulate

EFFECTS: list[dict[str, Any]] = [
    {"effect": "headwind", "wind_mps": 15.0},
    {"effect": "torque_gain", "gain": 0.7},
    {"effect": "torque_offset", "torque_Nm": 150.0},
    {"effect": "rotating_inertia", "inertia_kgm2": 8.0},
    {"effect": "driveline_loss", "loss": 0.3},
    {"effect": "brake_drag", "force_N": 3000.0},
    {"effect": "wheel_slip", "slip_per_mps2": 0.03},
    {"effect": "wheel_radius", "factor": 0.9, "axles": "all"},
    {"effect": "retarder_unreported", "torque_Nm": 800.0, "cause": "brake"},
    {"effect": "switched_load", "power_kW": 20.0, "signal": "pto_state"},
    {"effect": "drafting", "reduction": 0.6},
]
#: what an effect means grows with the vehicle: torques, inertias, forces and powers by engine torque
SCALED = {"torque_Nm", "inertia_kgm2", "force_N", "power_kW"}
SCALE = {"class8": 1.0, "light-truck": 0.4, "car": 0.15, "electric-car": 0.1}
DRIVERS: list[dict[str, Any]] = [
    {"kind": "pulses"},
    {"kind": "cruise", "speed_mps": 20, "start_mps": 15, "change_mps": 5, "change_every_s": 10},
    {"kind": "mixed", "hold_s": [5, 10]},
    {"kind": "stop-and-go", "drive_s": [15, 20], "stand_s": [3, 5]},
]


@settings(max_examples=15, deadline=None)
@given(
    vehicle=st.sampled_from([("class8", 8e3, 44e3), ("light-truck", 3e3, 8e3), ("car", 1.2e3, 3e3),
                             ("electric-car", 1.2e3, 2e3)]),
    load=st.floats(0, 1),
    grade=st.floats(0, 0.12),
    driver=st.sampled_from(DRIVERS),
    effects=st.lists(st.sampled_from(EFFECTS), max_size=4, unique_by=lambda e: e["effect"]),
    seed=st.integers(0, 2**32),
)  # fmt: skip
def test_any_drive_stays_physical(
    vehicle: tuple[str, float, float],
    load: float,
    grade: float,
    driver: dict[str, Any],
    effects: list[dict[str, Any]],
    seed: int,
):
    name, light, heavy = vehicle
    drive = simulate(
        {
            "duration_s": 40,
            "vehicle": name,
            "mass_kg": light + load * (heavy - light),
            "road": {"kind": "highway", "grade_max": grade, "bends": True},
            "driver": driver,
            "undeclared": [
                {k: v * SCALE[name] if k in SCALED else v for k, v in effect.items()} for effect in effects
            ],
            "small_errors": True,
        },
        seed,
    )
    h = drive.history
    assert all(np.isfinite(column).all() for column in h.values())
    assert h["speed_mps"].min() >= 0 and h["speed_mps"].max() < 60
    assert np.all(np.diff(h["distance_m"]) >= 0)
    assert np.abs(h["accel_mps2"]).max() < 10
    assert np.all((h["pedal"] >= 0) & (h["pedal"] <= 1) & (h["brake"] >= 0) & (h["brake"] <= 1))
    assert np.all(np.diff(drive.frames.t_us) >= 0)
    assert drive.frames.t_us[0] >= 1_700_000_000_000_000
