"""A small source of model samples with known truth, independent of pipeline and `canest.simulation`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock, VehicleFacts

MU = 0.006
FACTS = VehicleFacts(mass_min_kg=7_000.0, mass_max_kg=40_000.0, rolling_resistance=MU, has_accelerometer=True)


@dataclass
class Drive:
    block: ModelBlock
    mass_kg: float
    grade: np.ndarray


def drive(
    seconds: float = 60.0,
    mass_kg: float = 21_250.0,
    grade: Any = 0.0,
    seed: int = 1,
    noise_mps2: float = 0.0,
    pulse_s: float = 6.0,
    gaps: bool = False,
) -> Drive:
    """Throttle pulses on a road; ``grade`` is a number or a function of time. No filter, so the relation
    M (a + g sin(beta) + g mu cos(beta)) = F holds exactly but for white noise on the acceleration."""
    n = round(seconds / STEP_S)
    rng = np.random.default_rng(seed)
    t = np.arange(n) * STEP_S
    slope = np.broadcast_to(grade(t) if callable(grade) else float(grade), (n,)).astype(float)
    beta = np.arctan(slope)
    level = np.repeat(
        rng.uniform(0.1, 1.0, n // max(1, round(pulse_s / STEP_S)) + 1), round(pulse_s / STEP_S)
    )[:n]
    smooth = np.convolve(np.concatenate((np.full(25, level[0]), level)), np.ones(26) / 26, "valid")
    road = GRAVITY_MPS2 * (np.sin(beta) + MU * np.cos(beta))
    force = mass_kg * (road + 0.5 * (smooth - 0.55)) + 0.0 * t
    accel = force / mass_kg - road
    speed = 15.0 + np.cumsum(accel) * STEP_S
    gate = np.zeros(n, np.uint8)
    if gaps:
        for start in range(600, n, 900):
            gate[start : start + 60] = Gate.SHIFT
    restart = np.zeros(n, bool)
    restart[0] = True
    restart[1:] = gate[:-1] != 0
    nan = np.full(n, np.nan)
    block = ModelBlock(
        t_us=np.arange(n) * STEP_US,
        speed_mps=speed,
        accel_mps2=accel + noise_mps2 * rng.standard_normal(n),
        force_N=force,
        mu=np.full(n, MU),
        traction_N=force + 500.0,
        aero_N=np.full(n, 500.0),
        force_per_torque_1pm=np.full(n, 10.0),
        rotating_mass_kg=np.full(n, 600.0),
        coasting_N=nan,
        undriven_mps=nan,
        accelerometer_mps2=accel + GRAVITY_MPS2 * np.sin(beta) + noise_mps2 * rng.standard_normal(n),
        slope=slope.copy(),
        altitude_m=nan,
        yaw_rate_radps=nan,
        raw_speed_mps=speed,
        raw_force_N=force,
        raw_torque_Nm=(force + 500.0) / 10.0,
        gear=np.zeros(n),
        gate=gate,
        restart=restart,
        stopped=np.zeros(n, bool),
        ax_ok=np.ones(n, bool),
    )
    return Drive(block, mass_kg, slope)


def cut(block: ModelBlock, edges: list[int]) -> list[ModelBlock]:
    """The block in pieces at the given edges."""
    marks = [0, *sorted(edges), len(block)]
    return [block[a:b] for a, b in pairwise(marks)]


def join(parts: list[Any]) -> dict[str, np.ndarray]:
    """Estimate blocks joined, column by column."""
    names = ("mass_kg", "mass_std_kg", "grade", "grade_std", "status")
    return {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}


def with_columns(block: ModelBlock, **columns: np.ndarray) -> ModelBlock:
    return replace(block, **columns)
