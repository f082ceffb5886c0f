"""A truck at a steady throttle in one gear: simple enough to check by hand."""

from __future__ import annotations

from typing import Any

import pytest

from canest.simulation import SimulatedDrive, simulate

MASS_KG = 20_000.0
START_MPS = 20.0
RADIUS_M = 0.5
RATIO = 3.73  # ninth gear is direct
EFFICIENCY = 0.98
INERTIA_KG = 130 / RADIUS_M**2 + 3.2 * (RATIO / RADIUS_M) ** 2  # wheels and engine, seen at the road
QUIET = {
    "torque_delay_s": 0.0,
    "accelerometer_bias_mps2": 0.0,
    "accelerometer_noise_mps2": 0.0,
    "shaft_noise_rpm": 0.0,
    "wheel_noise_kmh": 0.0,
    "altitude_noise_m": 0.0,
    "yaw_noise_radps": 0.0,
}


def steady(
    throttle: float = 0.6,
    duration_s: float = 6.0,
    effects: list[dict[str, Any]] | None = None,
    **changes: Any,
) -> SimulatedDrive:
    """Simulate the truck at a steady throttle in its direct gear, without noise."""
    scenario: dict[str, Any] = {
        "seed": 5,
        "duration_s": duration_s,
        "vehicle": "class8",
        "mass_kg": MASS_KG,
        "road": {"kind": "flat"},
        "driver": {
            "kind": "given",
            "at_s": [0.0],
            "speed_mps": [40.0],
            "throttle": [throttle],
            "start_mps": START_MPS,
            "fixed_gear": 9,
        },
        "sensors": QUIET,
        "bus": {"loss": 0.0, "traffic": False, "cab_controller": False},
        "undeclared": effects or [],
    }
    return simulate(scenario | changes)


@pytest.fixture(scope="session")
def pulses() -> SimulatedDrive:
    return simulate("pulse-21t")
