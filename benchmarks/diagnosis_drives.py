"""The drives that judge the diagnosis: what is planted in them, and what is known of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

#: effect -> its fitted parameter, the range it is drawn from, and its neutral value; sizes that a workshop
#: would want to know of
SIZES: dict[str, tuple[str, tuple[float, float], float]] = {
    "headwind": ("wind_mps", (4.5, 9.0), 0.0),
    "drag_area": ("cda_delta_m2", (1.5, 3.5), 0.0),
    "rolling_resistance": ("crr_delta", (0.002, 0.004), 0.0),
    "rolling_resistance_speed": ("crr_per_mps", (0.00012, 0.0003), 0.0),
    "rolling_warmup": ("crr_cold", (0.004, 0.008), 0.0),
    "torque_gain": ("gain", (0.86, 0.93), 1.0),
    "torque_offset": ("torque_Nm", (80.0, 160.0), 0.0),
    "torque_delay": ("delay_s", (0.12, 0.25), 0.0),
    "driveline_loss": ("loss", (0.07, 0.14), 0.0),
    "wheel_radius": ("factor", (0.94, 0.97), 1.0),
    "rotating_inertia": ("inertia_kgm2", (2.5, 6.0), 0.0),
    "brake_drag": ("force_N", (600.0, 1600.0), 0.0),
    "retarder_unreported": ("torque_Nm", (150.0, 400.0), 0.0),
    "cornering_drag": ("coefficient_s2pm", (0.025, 0.06), 0.0),
    "switched_load": ("power_kW", (18.0, 40.0), 0.0),
}
_FIXED: dict[str, dict[str, Any]] = {
    "rolling_warmup": {"tau_s": 300.0},
    "switched_load": {"signal": "fan_speed", "law": "cubic"},
}
#: every simulated engine reports this much later than the torque acts, s
USUAL_DELAY_S = 0.06
DURATION_S = 500.0


@dataclass(frozen=True)
class Case:
    """One drive. planted: effect -> value, empty for a clean drive; reference: `truth` or `mass`."""

    family: str
    seed: int
    planted: dict[str, float]
    reference: str
    scenario: dict[str, Any]


def scenario(rng: np.random.Generator, planted: dict[str, float], *, errors: bool) -> dict[str, Any]:
    """Draw road, driver and load; errors: with the small errors that every vehicle has."""
    entries = [{"effect": n, SIZES[n][0]: value, **_FIXED.get(n, {})} for n, value in planted.items()]
    driver: dict[str, Any] = {"kind": str(rng.choice(["mixed", "pulses"]))}
    return {
        "seed": int(rng.integers(1 << 31)),
        "duration_s": DURATION_S,
        "vehicle": "class8",
        "mass_kg": float(round(rng.uniform(10_000, 36_000), -2)),
        "road": {"kind": "highway", "grade_max": float(rng.uniform(0.02, 0.045)), "bends": True,
                 "bend_radius_m": [120, 600]},
        "driver": driver,
        "bus": {"traffic": False},
        "undeclared": entries,
        "small_errors": errors,
    }  # fmt: skip


def drawn(rng: np.random.Generator, names: tuple[str, ...]) -> dict[str, float]:
    """Draw a value for each effect; a wind may also blow from behind."""
    values = {name: float(rng.uniform(*SIZES[name][1])) for name in names}
    if "headwind" in values and len(names) > 1 and rng.random() < 0.3:
        values["headwind"] *= -1.0
    return values


def cases(seed: int, pairs: int, clean: int) -> list[Case]:
    """Return all drives: clean ones, every effect alone, pairs of effects, and a brake beside a wind."""
    found = []
    for i in range(clean):
        rng = np.random.default_rng((seed, 1, i))
        reference = ("mass", "truth")[i % 2]
        found.append(Case("clean", i, {}, reference, scenario(rng, {}, errors=i % 4 > 1)))
    for i, name in enumerate(SIZES):
        rng = np.random.default_rng((seed, 2, i))
        planted = drawn(rng, (name,))
        found.append(Case("single", i, planted, "truth", scenario(rng, planted, errors=False)))
    both = list(combinations(SIZES, 2))
    order = np.random.default_rng((seed, 3)).permutation(len(both))
    for i in range(pairs):
        rng = np.random.default_rng((seed, 4, i))
        planted = drawn(rng, both[order[i % len(both)]])
        found.append(Case("pair", i, planted, "mass", scenario(rng, planted, errors=bool(i % 2))))
    for i in range(4):
        rng = np.random.default_rng((seed, 5, i // 2))
        planted = {"brake_drag": 800.0, "headwind": 5.0}
        reference = ("mass", "truth")[i % 2]
        found.append(Case("brake and wind", i, planted, reference, scenario(rng, planted, errors=False)))
    return found
