"""Drives with their truth, and how right an estimator was on one of them: shared by the benchmarks."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import yaml

from canest.config.database_files import read_databases
from canest.config.load import load_config, parse_config
from canest.core.errors import ConfigError
from canest.core.frames import BoolColumn, FloatColumn, FrameBlock
from canest.core.samples import EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.contract import updated
from canest.estimators.registry import create, estimator_class, require_known
from canest.pipeline.build import facts_of
from canest.pipeline.pipeline import Pipeline
from canest.simulation.run import simulate

FIRST_S, LATER_S = 60.0, 120.0
#: open gates needed after a change of load before the mass must be right
SETTLED_S = 60.0
#: what a spreader loses from one sample to the next is no change of load, kg
CHANGE_KG = 100.0
#: beyond this share of the mass, `valid` is wrong; and beyond so many standard deviations
WRONG, WRONG_STDS = 0.08, 3.0


@dataclass(frozen=True)
class Drive:
    """A drive ready for estimators: model samples, facts, and the truth on the same ticks (n,)."""

    samples: ModelBlock
    facts: VehicleFacts
    mass_kg: FloatColumn
    grade: FloatColumn
    speed_mps: FloatColumn

    def between(self, from_s: float, to_s: float) -> BoolColumn:
        """Return which samples lie between two times from the first sample on, (n,)."""
        t = (self.samples.t_us - self.samples.t_us[0]) * 1e-6
        found: BoolColumn = (t >= from_s) & (t < to_s)
        return found

    def part(self, kept: BoolColumn) -> Drive:
        """Return some of the samples."""
        truth = (self.mass_kg[kept], self.grade[kept], self.speed_mps[kept])
        return Drive(self.samples[kept], self.facts, *truth)


def prepare(
    *scenarios: dict[str, Any],
    edit: Callable[[FrameBlock], FrameBlock] | None = None,
    excitation_gate: bool = False,
    own_config: bool = False,
) -> Drive:
    """Simulate scenarios one after the other and pass their frames through the pipeline.

    edit: what happens to the frames on the bus. excitation_gate: for methods that wind up without excitation.
    own_config: by the data sheet of the simulated vehicle, else by the config of the truck of class 8.
    """
    drives = [simulate(scenario) for scenario in scenarios]
    frames = FrameBlock.concatenate([drive.frames for drive in drives])
    truth = {key: np.concatenate([drive.truth[key] for drive in drives]) for key in drives[0].truth}
    gate = f"gates.low_excitation.enabled={str(excitation_gate).lower()}"
    overrides = ["estimator.name=canest", gate]
    if own_config:
        cfg = read_databases(parse_config(yaml.safe_dump(drives[0].config), overrides=overrides))
    else:
        cfg = load_config("class8", overrides)
    parts: list[ModelBlock] = []
    pipeline = Pipeline(cfg, listener=lambda samples, _: parts.append(samples))
    pipeline.push(edit(frames) if edit else frames)
    pipeline.finish()
    samples = ModelBlock.concatenate(parts)
    t = samples.t_us * 1e-6
    at = np.clip(np.searchsorted(truth["t_s"], t, side="right") - 1, 0, None)
    return Drive(
        samples,
        facts_of(cfg),
        truth["mass_kg"][at],
        np.interp(t, truth["t_s"], truth["grade"]),
        np.interp(t, truth["t_s"], truth["speed_mps"]),
    )


def estimator_name(text: str) -> str:
    """Return the name of an estimator that a command line gives."""
    try:
        require_known(text, "--estimator")
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def by_gate(estimators: Sequence[str]) -> dict[bool, list[str]]:
    """Return the estimators that want the samples without and with the low-excitation gate."""
    wanted: dict[bool, list[str]] = {}
    for name in estimators:
        wanted.setdefault(estimator_class(name).wants_excitation_gate, []).append(name)
    return wanted


def without_accelerometer(samples: ModelBlock) -> ModelBlock:
    """Return the samples of the same drive on a vehicle that has no accelerometer."""
    n = len(samples)
    return replace(samples, accelerometer_mps2=np.full(n, np.nan), ax_ok=np.zeros(n, np.bool_))


def estimate(
    name: str, drive: Drive, start_kg: float, *, accelerometer: bool
) -> tuple[EstimateBlock, dict[str, float]]:
    """Return the estimates of a drive, and what the estimator's snapshot has of its innovations."""
    return estimate_with(partial(create, name), drive, start_kg, accelerometer=accelerometer)


def estimate_with(
    make: Callable[[VehicleFacts], Estimator], drive: Drive, start_kg: float, *, accelerometer: bool
) -> tuple[EstimateBlock, dict[str, float]]:
    """Do as `estimate` does, with an estimator that need not be registered."""
    samples = drive.samples if accelerometer else without_accelerometer(drive.samples)
    facts = replace(drive.facts, initial_mass_kg=start_kg, has_accelerometer=accelerometer)
    estimator = make(facts)
    estimates = updated(estimator, samples)
    found = estimator.snapshot()
    return estimates, {key: float(found.get(key, np.nan)) for key in ("nis", "runs_z", "windows")}


def settled(drive: Drive) -> BoolColumn:
    """Return where 60 s of open gates have passed since the last change of load."""
    opened = np.cumsum(drive.samples.gate == 0) * 0.02
    changed = np.concatenate(([False], np.abs(np.diff(drive.mass_kg)) > CHANGE_KG))
    since = np.maximum.accumulate(np.where(changed, opened, 0.0))
    done: BoolColumn = opened - since >= SETTLED_S
    return done


def judge(
    drive: Drive, e: EstimateBlock, first_s: float = FIRST_S, later_s: float = LATER_S
) -> dict[str, float]:
    """Return one run's figures (percent, degrees); those without a value are NaN."""
    t = (drive.samples.t_us - drive.samples.t_us[0]) * 1e-6
    error = e.mass_kg - drive.mass_kg
    share = error / drive.mass_kg
    slope = np.degrees(np.arctan(e.grade) - np.arctan(drive.grade))
    first, later, known = t >= first_s, t >= later_s, np.isfinite(e.mass_kg)
    moving = (drive.speed_mps > 1.0) & first & np.isfinite(e.grade)
    z = np.abs(error / e.mass_std_kg)
    z_grade = np.abs((e.grade - drive.grade) / e.grade_std)
    sure, sure_grade = first & np.isfinite(z), moving & np.isfinite(z_grade)
    valid = e.status == Status.VALID
    done = settled(drive) & first & known
    return {
        "mass_rms": _rms(100 * share[first & known]),
        "mass_max": _largest(100 * share[first & known]),
        "rms_120": _rms(100 * share[later & known]),
        "bias": 100 * _mean(share[later & known]),
        "settled_max": _largest(100 * share[done]),
        "grade_rms": _rms(slope[moving]),
        "in2": 100 * _mean(z[sure] <= 2),
        "in3": 100 * _mean(z[sure] <= 3),
        "grade_in2": 100 * _mean(z_grade[sure_grade] <= 2),
        "grade_in3": 100 * _mean(z_grade[sure_grade] <= 3),
        "std": 100 * float(np.median((e.mass_std_kg / e.mass_kg)[sure])) if sure.any() else np.nan,
        "valid": 100 * _mean(valid[later]),
        "ever_valid": 100.0 * bool(valid[first].any()),
        "valid_wrong": 100 * _mean(np.abs(share[valid]) > WRONG) if valid.any() else 0.0,
        "valid_beyond": 100 * _mean(z[valid] > WRONG_STDS) if valid.any() else 0.0,
        "known": 100 * _mean(known[first]),
    }


def _rms(x: FloatColumn) -> float:
    return float(np.sqrt(np.mean(x * x))) if len(x) else float("nan")


def _largest(x: FloatColumn) -> float:
    return float(np.max(np.abs(x))) if len(x) else float("nan")


def _mean(x: np.ndarray[Any, Any]) -> float:
    return float(np.mean(x)) if len(x) else float("nan")
