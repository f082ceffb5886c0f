"""Drives as model samples with their truth: simulated on a bus, recorded, or straight from the equation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from canest.config import Config, parse_config, read_databases
from canest.core.frames import FrameBlock
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.registry import create
from canest.grid.grid import Grid, GridBlock
from canest.logs.format_detection import open_log
from canest.logs.truth import read_truth
from canest.offline.scoring import Score
from canest.pipeline.build import build
from canest.pipeline.intake import Intake
from canest.simulation import SimulatedDrive, simulate
from canest.system.shipped_files import find
from canest.vehicle.filtered_model import FilteredModel

Column = np.ndarray[Any, np.dtype[np.float64]]


@dataclass
class Drive:
    """Model samples without and with the excitation gate, signals of the grid, truth; (n,) columns."""

    name: str
    plain: ModelBlock
    excited: ModelBlock
    signals: dict[str, Column]
    mass_kg: Column
    grade: Column
    facts: VehicleFacts

    @property
    def t_s(self) -> Column:
        return (self.plain.t_us - self.plain.t_us[0]) / 1e6

    def part(self, begin: int, end: int) -> Drive:
        cut = slice(begin, end)
        signals = {k: v[cut] for k, v in self.signals.items()}
        return Drive(
            self.name,
            self.plain[cut],
            self.excited[cut],
            signals,
            self.mass_kg[cut],
            self.grade[cut],
            self.facts,
        )


def config_of(raw: dict[str, Any], overrides: Iterable[str] = ()) -> Config:
    """Return a config from the mapping that a simulation knows."""
    text = yaml.safe_dump({**raw, "estimator": {"name": "rlsmf"}})
    return read_databases(parse_config(text, overrides=overrides))


def simulated(
    name: str, overrides: Iterable[str] = (), changes: dict[str, Any] | None = None, seed: int | None = None
) -> Drive:
    """Return a shipped scenario's drive through decoder, grid, model, filter and gates."""
    path = Path(__file__).resolve().parents[2] / "canest" / "simulation" / "scenarios" / f"{name}.yaml"
    scenario = {**yaml.safe_load(path.read_text(encoding="utf-8")), **(changes or {})}
    drive = _simulate(name, yaml.safe_dump(scenario), seed)
    t_us = np.round(drive.truth["t_s"] * 1e6)
    truth = (t_us, drive.truth["mass_kg"], drive.truth["grade"])
    config = config_of(drive.config, overrides)
    return _drive(name, config, [drive.frames], lambda t: tuple(np.interp(t, truth[0], c) for c in truth[1:]))


_SIMULATED: dict[tuple[str, str, int | None], SimulatedDrive] = {}


def _simulate(name: str, text: str, seed: int | None) -> SimulatedDrive:
    key = (name, text, seed)
    if key not in _SIMULATED:
        _SIMULATED[key] = simulate(yaml.safe_load(text), seed)
    return _SIMULATED[key]


def recorded(
    directory: Path, name: str, overrides: Iterable[str] = (), config: str = "class8"
) -> Drive | None:
    """Return NAME.log* with NAME.truth.csv of a folder, or None when it is not there."""
    logs = sorted(directory.glob(f"{name}.log*"))
    truth_path = directory / f"{name}.truth.csv"
    if not logs or not truth_path.is_file():
        return None
    raw = yaml.safe_load(find("configs", config).read_text(encoding="utf-8"))
    score = Score(read_truth(truth_path))
    blocks = [b for b in open_log(logs[0]) if isinstance(b, FrameBlock)]
    return _drive(f"{name} (recorded)", config_of(raw, overrides), blocks, score.truth_at)


def _drive(
    name: str, config: Config, blocks: list[FrameBlock], truth: Callable[[Any], tuple[Column, ...]]
) -> Drive:
    spec = build(config)
    intake, grid = Intake(spec.intake), Grid(spec.grid.channels, spec.grid.hold_us)
    plain, excited = (FilteredModel(spec.model, excitation_gate=gate) for gate in (False, True))
    parts: list[tuple[ModelBlock, ModelBlock, dict[str, Column]]] = []

    def take(ticks: GridBlock) -> None:
        first = plain.process(ticks)
        wanted = ("output_shaft_speed", "undriven_speed", "gps_speed", "vehicle_speed")
        columns = plain.last_columns.signals
        nothing = np.full(len(first), np.nan)
        parts.append((first, excited.process(ticks), {w: columns.get(w, nothing) for w in wanted}))

    for block in blocks:
        for feed in intake.frames(block):
            for ticks in grid.take(feed):
                take(ticks)
    if intake.clock.last_us is not None:
        left = grid.ticks_until(intake.clock.last_us, inclusive=True)
        if left is not None:
            take(left)
    joined = ModelBlock.concatenate([p[0] for p in parts])
    mass, grade = truth(joined.t_us)
    signals = {w: np.concatenate([p[2][w] for p in parts]) for w in parts[0][2]}
    return Drive(
        name,
        joined,
        ModelBlock.concatenate([p[1] for p in parts]),
        signals,
        mass,
        grade,
        spec.estimator.facts,
    )


def estimate(drive: Drive, name: str, options: dict[str, Any] | None = None, **facts: Any) -> EstimateBlock:
    """Run one estimator over a drive."""
    from dataclasses import replace

    method: Estimator = create(name, replace(drive.facts, **facts), options or {})
    return method.update(drive.excited if method.wants_excitation_gate else drive.plain)


def errors(drive: Drive, found: EstimateBlock, after_s: float = 0.0) -> tuple[float, float, float]:
    """Return mass RMS in kg, worst mass error in percent and grade RMS in degrees from ``after_s`` on."""
    late = (drive.t_s >= after_s) & ~np.isnan(found.mass_kg) & ~np.isnan(drive.mass_kg)
    difference = (found.mass_kg - drive.mass_kg)[late]
    worst = 100.0 * np.max(np.abs(difference) / drive.mass_kg[late])
    grade = np.degrees(np.arctan(found.grade[late]) - np.arctan(drive.grade[late]))
    return float(np.sqrt(np.mean(difference**2))), float(worst), float(np.sqrt(np.mean(grade**2)))


def from_equation(
    seconds: float,
    mass: Callable[[Column], Column],
    grade: Callable[[Column], Column],
    noise: float = 0.0,
    seed: int = 0,
    name: str = "equation",
) -> Drive:
    """Return a drive made with eq. 2 itself, as the 2005 paper's section 4.3 does: fuelling steps, one gear.

    noise: standard deviation of white noise on the acceleration, m/s2; the force gets 1 % per 0.05 of it.
    """
    n = round(seconds / STEP_S)
    rng = np.random.default_rng(seed)
    t = np.arange(n) * STEP_S
    m, slope, mu = mass(t), grade(t), 0.006
    # each step lasts one to four seconds, so that the batch start of four seconds sees more than one level
    lengths = rng.integers(50, 200, n // 50)
    steps = np.repeat(rng.uniform(0.0, 1.0, n // 50), lengths)[:n]
    traction = 28_000.0 * steps
    beta = np.arctan(slope)
    v, speed, accel = 20.0, np.empty(n), np.empty(n)
    for k in range(n):
        road = m[k] * GRAVITY_MPS2 * (np.sin(beta[k]) + mu * np.cos(beta[k]))
        accel[k] = (traction[k] - 3.8 * v * v - road) / m[k]
        v += accel[k] * STEP_S
        speed[k] = v
    force = traction - 3.8 * speed**2
    zeros, nan = np.zeros(n), np.full(n, np.nan)
    exact = (force - m * GRAVITY_MPS2 * (np.sin(beta) + mu * np.cos(beta))) / m
    restart = np.zeros(n, bool)
    restart[0] = True
    block = ModelBlock(
        t_us=np.arange(n) * STEP_US,
        speed_mps=speed,
        accel_mps2=exact + noise * rng.standard_normal(n),
        force_N=force * (1.0 + 0.2 * noise * rng.standard_normal(n)),
        mu=zeros + mu,
        traction_N=traction,
        aero_N=3.8 * speed**2,
        force_per_torque_1pm=zeros + 7.0,
        rotating_mass_kg=zeros,
        coasting_N=nan,
        undriven_mps=nan,
        accelerometer_mps2=nan,
        slope=nan,
        altitude_m=nan,
        yaw_rate_radps=nan,
        raw_speed_mps=speed,
        raw_force_N=force,
        raw_torque_Nm=traction / 7.0,
        gear=zeros,
        gate=np.zeros(n, np.uint8),
        restart=restart,
        stopped=np.zeros(n, bool),
        ax_ok=np.zeros(n, bool),
    )
    facts = VehicleFacts(mass_min_kg=3_000.0, mass_max_kg=150_000.0, rolling_resistance=mu)
    return Drive(name, block, block, {}, m, slope, facts)
