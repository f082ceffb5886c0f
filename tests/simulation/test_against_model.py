"""Two models of one vehicle, written apart: the estimators' regression must hold on simulated drives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from canest.config import parse_config, read_databases
from canest.pipeline.pipeline import Pipeline
from canest.simulation import SimulatedDrive, simulate
from canest.simulation.files import config_text

G = 9.80665


def regression(drive: SimulatedDrive) -> tuple[np.ndarray, np.ndarray]:
    """Return known force and specific force (acceleration, true grade, rolling) of the samples left open."""
    seen: list[Any] = []
    pipeline = Pipeline(
        read_databases(parse_config(config_text(drive.config))),
        listener=lambda samples, _: seen.append(samples),
    )
    pipeline.push(drive.frames)
    pipeline.finish()
    t_s, force, accel, mu, gate = (
        np.concatenate([getattr(s, name) for s in seen])
        for name in ("t_us", "force_N", "accel_mps2", "mu", "gate")
    )
    beta = np.arctan(np.interp(t_s / 1e6, drive.truth["t_s"], drive.truth["grade"]))
    specific = accel + G * (np.sin(beta) + mu * np.cos(beta))
    usable = (gate == 0) & np.isfinite(force + specific)
    return force[usable], specific[usable]


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
