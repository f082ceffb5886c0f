"""Two models of one vehicle, written apart: the estimators' regression must hold on simulated drives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from canest.config import parse_config, read_databases
from canest.pipeline.pipeline import Pipeline
from canest.simulation import SimulatedDrive, simulate
from canest.simulation.files import config_text

from .conftest import QUIET

G = 9.80665


def samples_of(drive: SimulatedDrive) -> dict[str, np.ndarray]:
    """Return the model's samples left open, and their specific force (acceleration, true grade, rolling)."""
    seen: list[Any] = []
    pipeline = Pipeline(
        read_databases(parse_config(config_text(drive.config))),
        listener=lambda samples, _: seen.append(samples),
    )
    pipeline.push(drive.frames)
    pipeline.finish()
    names = ("t_us", "force_N", "accel_mps2", "mu", "gate", "raw_torque_Nm")
    found = {name: np.concatenate([getattr(s, name) for s in seen]) for name in names}
    beta = np.arctan(np.interp(found["t_us"] / 1e6, drive.truth["t_s"], drive.truth["grade"]))
    found["specific"] = found["accel_mps2"] + G * (np.sin(beta) + found["mu"] * np.cos(beta))
    usable = (found["gate"] == 0) & np.isfinite(found["force_N"] + found["specific"])
    return {name: column[usable] for name, column in found.items()}


def regression(drive: SimulatedDrive) -> tuple[np.ndarray, np.ndarray]:
    """Return known force and specific force of the samples left open."""
    samples = samples_of(drive)
    return samples["force_N"], samples["specific"]


@pytest.mark.parametrize(
    ("name", "mass_kg", "tolerance_pct"),
    [
        ("pulse-21t", 21_250, 1.0),
        ("launches-flat", 23_000, 1.0),
        ("launches-car", 2_309, 0.5),  # measured wheel torque: no delay, no engine inertia
        ("grade-steps", 20_000, 0.5),  # no delay, no noise
    ],
)
def test_the_mass_that_fits_best_is_the_true_one(name: str, mass_kg: float, tolerance_pct: float):
    force, specific = regression(simulate(name))
    assert len(force) > 5000
    fitted = float(force @ specific / (specific @ specific))
    assert abs(fitted / mass_kg - 1) * 100 < tolerance_pct


def test_an_undeclared_headwind_is_what_remains():
    force, specific = regression(simulate("headwind"))
    windless = simulate("headwind")
    speed = windless.truth["speed_mps"].mean()
    expected = 0.5 * 1.184 * 6.4 * ((speed + 6.5) ** 2 - speed**2)
    assert np.mean(force - 21_250 * specific) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(("gear", "ratio", "speeds_mps"), [(3, 6.75, (1.8, 4.2)), (4, 4.90, (2.4, 5.8))])
def test_the_inertia_of_an_engine_in_overrun_is_carried_through_the_losses(
    gear: int, ratio: float, speeds_mps: tuple[float, float]
):
    """With the losses of a driving engine, some hundred newton would remain."""
    slowest, fastest = speeds_mps
    drive = simulate(
        {
            "seed": 5,
            "duration_s": 120,
            "vehicle": "class8",
            "mass_kg": 9_000,
            "road": {"kind": "flat"},
            "driver": {
                "kind": "pulses",
                "on_s": (2.0, 5.0),
                "throttle": (0.2, 0.5),
                "min_mps": slowest,
                "max_mps": fastest,
                "start_mps": slowest,
                "fixed_gear": gear,
            },
            "sensors": QUIET,
            "bus": {"loss": 0.0, "traffic": False, "cab_controller": False},
        }
    )
    samples = samples_of(drive)
    overrun = samples["raw_torque_Nm"] < 0
    assert np.count_nonzero(overrun) > 2000
    residual = (samples["force_N"] - 9_000 * samples["specific"])[overrun].mean()
    crank_kg = 3.2 * (ratio * 3.73 / 0.5) ** 2
    more = (1 / 0.96 - 0.96) * crank_kg * samples["accel_mps2"][overrun].mean()
    assert more < -150
    assert abs(residual) < 0.25 * abs(more)
