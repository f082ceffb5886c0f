"""An altitude that is held between rare reports is not a new measurement every second."""

from __future__ import annotations

import numpy as np
import pytest

import canest

MASS_KG, MU, DRAG_N_PER_MPS2 = 20_000.0, 0.006, 3.6
TRUCK = canest.Vehicle(
    mass_min_kg=8_000, mass_max_kg=40_000, wheel_radius_m=0.5, final_drive=3.0, drag_area_m2=6.0,
    rolling_resistance=MU,
)  # fmt: skip


@pytest.mark.parametrize("every_s", [1, 5])
def test_a_sound_vehicle_lacks_nothing_however_rare_the_altitude(every_s):
    """20 min of a truck without errors on waves of 2 %, its altitude with 3 m of noise."""
    t_s = 0.02 * np.arange(60_000)
    accel = 0.35 * np.sin(2 * np.pi * t_s / 40) + 0.2 * np.sin(2 * np.pi * t_s / 17)
    speed = 15.0 + 0.02 * np.cumsum(accel)
    speed += 8.0 - speed.min()
    grade = 0.02 * np.sin(2 * np.pi * 0.02 * np.cumsum(speed) / 2500)
    sine = grade / np.sqrt(1.0 + grade * grade)
    force = MASS_KG * (np.gradient(speed, 0.02) + 9.80665 * (sine + MU)) + DRAG_N_PER_MPS2 * speed**2
    height = 200.0 + 0.02 * np.cumsum(sine * speed)
    report = (t_s // every_s).astype(int)
    noise = np.random.default_rng(1).normal(0.0, 3.0, report[-1] + 1)
    altitude = (height[np.searchsorted(t_s, every_s * np.arange(report[-1] + 1))] + noise)[report]
    columns = {
        "t_s": t_s, "vehicle_speed": speed, "wheel_force": force, "brake_switch": 0.0 * t_s,
        "altitude": altitude,
    }  # fmt: skip
    assert canest.diagnose(columns, TRUCK, mass_kg=MASS_KG).verdict == "nothing-to-explain"
