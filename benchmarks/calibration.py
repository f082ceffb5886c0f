"""How right is `canest`, and how right about how right it is: many simulated drives, several starts.

    python benchmarks/calibration.py [--drives 4] [--seed 100] [--family NAME]... [--json FILE] [--worst]
    python benchmarks/calibration.py -o docs/measured/calibration.md

Every drive is simulated anew (another road, driver, load and, where `errors` is set, other undeclared
errors: torque, wind, rolling resistance, slip, oscillation, delay) and estimated from starts of 9, 21 and
36 t, with and without the accelerometer. Coverage is the share of samples after the first minute whose
truth lies within 2 and 3 standard deviations.
"""

from __future__ import annotations

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from calibration_tables import page, table

from canest.config.load import load_config
from canest.core import jit
from canest.core.frames import FloatColumn
from canest.core.samples import EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.registry import create
from canest.pipeline.build import facts_of
from canest.pipeline.pipeline import Pipeline
from canest.simulation.run import simulate

STARTS_KG = (9000.0, 21000.0, 36000.0)
FIRST_S, LATER_S = 60.0, 120.0
#: open gates needed after a change of load before the mass must be right
SETTLED_S = 60.0


@dataclass(frozen=True)
class Family:
    """Drives of one kind: driver, road, duration, whether small errors are drawn, and the loads."""

    name: str
    driver: dict[str, Any]
    road: dict[str, Any]
    duration_s: float
    errors: bool
    loads_kg: tuple[float, float] = (9000.0, 36000.0)
    changes_s: tuple[float, ...] = ()

    def scenario(self, rng: np.random.Generator) -> dict[str, Any]:
        """Draw one drive's scenario."""
        loads = [float(round(m, -2)) for m in rng.uniform(*self.loads_kg, 1 + len(self.changes_s))]
        road = {"kind": "highway", "grade_max": float(rng.uniform(0.02, 0.05)), **self.road}
        return {
            "seed": int(rng.integers(1 << 31)),
            "duration_s": self.duration_s,
            "vehicle": "class8",
            "mass_kg": [{"t_s": t, "mass_kg": m} for t, m in zip((0.0, *self.changes_s), loads, strict=True)],
            "road": {"kind": "flat"} if road["kind"] == "flat" else road,
            "driver": self.driver,
            "small_errors": self.errors,
            "sensors": {"altitude_noise_m": 2.0},
        }


_ONE_GEAR = {"kind": "pulses", "start_mps": 21.0, "fixed_gear": 10, "max_mps": 26.0, "min_mps": 16.0}
_ONE_GEAR |= {"on_s": [8, 14], "off_s": [4, 8]}
_LAUNCHES = {"kind": "stop-and-go", "speeds_mps": [16.0, 19.0], "drive_s": [70, 110], "stand_s": [10, 20]}
_CITY = {"kind": "stop-and-go", "long_stops": [[240, 75], [600, 80]]}
_CRUISE = {"kind": "cruise", "speed_mps": 23.5, "start_mps": 20.0, "retarder": True}
_CRUISE_ROAD = {"grade_max": 0.04, "stretch_m": [500, 1500]}
FAMILIES = (
    Family("pulses", {"kind": "pulses"}, {}, 300, False),
    Family("one gear", _ONE_GEAR, {"grade_max": 0.028}, 330, False, (15000.0, 30000.0)),
    Family("launches", _LAUNCHES, {"kind": "flat"}, 500, False),
    Family("city", _CITY, {"grade_max": 0.035}, 900, False, changes_s=(260.0, 620.0)),
    Family("pulses*", {"kind": "pulses"}, {}, 300, True),
    Family("mixed*", {"kind": "mixed", "retarder": True}, {"bends": True}, 400, True),
    Family("hills*", {"kind": "mixed", "retarder": True}, {"bends": True, "grade_max": 0.06}, 400, True),
    Family("launches*", _LAUNCHES, {"grade_max": 0.02}, 500, True),
    Family("city*", _CITY, {"grade_max": 0.035}, 900, True, changes_s=(260.0, 620.0)),
    Family("cruise*", _CRUISE, _CRUISE_ROAD, 400, True, (18000.0, 36000.0)),
)


@dataclass(frozen=True)
class Drive:
    """A drive ready for estimators: model samples, facts, and the truth on the same ticks (n,)."""

    samples: ModelBlock
    facts: VehicleFacts
    mass_kg: FloatColumn
    grade: FloatColumn
    speed_mps: FloatColumn


def prepare(scenario: dict[str, Any], config: str = "class8") -> Drive:
    """Simulate a scenario and pass its frames through the pipeline."""
    drive = simulate(scenario)
    cfg = load_config(config, ["estimator.name=canest"])
    parts: list[ModelBlock] = []
    pipeline = Pipeline(cfg, listener=lambda samples, _: parts.append(samples))
    pipeline.push(drive.frames)
    pipeline.finish()
    samples = ModelBlock.concatenate(parts)
    t, truth = samples.t_us * 1e-6, drive.truth
    at = np.clip(np.searchsorted(truth["t_s"], t, side="right") - 1, 0, None)
    return Drive(
        samples,
        facts_of(cfg),
        truth["mass_kg"][at],
        np.interp(t, truth["t_s"], truth["grade"]),
        np.interp(t, truth["t_s"], truth["speed_mps"]),
    )


def without_accelerometer(samples: ModelBlock) -> ModelBlock:
    """Return the samples of the same drive on a vehicle that has no accelerometer."""
    n = len(samples)
    return replace(samples, accelerometer_mps2=np.full(n, np.nan), ax_ok=np.zeros(n, np.bool_))


def settled(drive: Drive) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return where 60 s of open gates have passed since the last change of load."""
    opened = np.cumsum(drive.samples.gate == 0) * 0.02
    changed = np.concatenate(([False], np.diff(drive.mass_kg) != 0))
    since = np.maximum.accumulate(np.where(changed, opened, 0.0))
    return opened - since >= SETTLED_S


def judge(drive: Drive, e: EstimateBlock) -> dict[str, float]:
    """Return one run's figures (percent, degrees)."""
    t = (drive.samples.t_us - drive.samples.t_us[0]) * 1e-6
    error = e.mass_kg - drive.mass_kg
    share = error / drive.mass_kg
    slope = np.degrees(np.arctan(e.grade) - np.arctan(drive.grade))
    moving = (drive.speed_mps > 1.0) & (t >= FIRST_S)
    first, later, known = t >= FIRST_S, t >= LATER_S, np.isfinite(e.mass_kg)
    z = np.abs(error / e.mass_std_kg)
    z_grade = np.abs((e.grade - drive.grade) / e.grade_std)
    valid = e.status == Status.VALID
    done = settled(drive) & first & known
    return {
        "mass_rms": _rms(100 * share[first & known]),
        "mass_max": float(np.max(np.abs(100 * share[first & known]), initial=0.0)),
        "rms_120": _rms(100 * share[later & known]),
        "settled_max": float(np.max(np.abs(100 * share[done]), initial=0.0)),
        "grade_rms": _rms(slope[moving & known]),
        "in2": 100 * _mean(z[first & known] <= 2),
        "in3": 100 * _mean(z[first & known] <= 3),
        "grade_in2": 100 * _mean(z_grade[moving & known] <= 2),
        "grade_in3": 100 * _mean(z_grade[moving & known] <= 3),
        "std": 100 * float(np.median((e.mass_std_kg / e.mass_kg)[first & known])),
        "valid": 100 * _mean(valid[later]),
        "valid_wrong": 100 * _mean(np.abs(share[valid]) > 0.08),
        "known": 100 * _mean(known[first]),
    }


def _rms(x: FloatColumn) -> float:
    return float(np.sqrt(np.mean(x * x))) if len(x) else float("nan")


def _mean(x: np.ndarray[Any, Any]) -> float:
    return float(np.mean(x)) if len(x) else 0.0


#: nobody loads tons in a shorter stop, s
LOADING_STOP_S = 45.0


def loaded_in_long_stops(drive: Drive) -> bool:
    """Return whether every change of load happens in a stop in which a truck can be loaded."""
    edges = np.flatnonzero(np.diff(drive.samples.stopped.astype(int), prepend=0, append=0))
    changes = np.flatnonzero(np.diff(drive.mass_kg))
    stops = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= LOADING_STOP_S * 50]
    return all(any(a - 50 <= c <= b for a, b in stops) for c in changes)


def draw(family: Family, seed: int) -> tuple[dict[str, Any], Drive]:
    """Simulate the first drive from this seed on whose load changes where it can."""
    rng = np.random.default_rng(seed)
    while True:
        scenario = family.scenario(rng)
        drive = prepare(scenario)
        if loaded_in_long_stops(drive):
            return scenario, drive


def one_drive(job: tuple[Family, int]) -> list[dict[str, Any]]:
    """Simulate one drive and estimate it from every start, with and without accelerometer."""
    jit.enable()
    family, seed = job
    scenario, drive = draw(family, seed)
    rows = []
    for accelerometer in (False, True):
        samples = drive.samples if accelerometer else without_accelerometer(drive.samples)
        for start in STARTS_KG:
            facts = replace(drive.facts, initial_mass_kg=start, has_accelerometer=accelerometer)
            estimator = create("canest", facts)
            figures = judge(drive, estimator.update(samples))
            consistency = getattr(estimator, "consistency")()  # noqa: B009 - not of the base class
            rows.append(
                {
                    "family": family.name,
                    "seed": seed,
                    "load_t": scenario["mass_kg"][0]["mass_kg"] / 1000,
                    "accelerometer": accelerometer,
                    "start_t": start / 1000,
                    **figures,
                    **consistency,
                }
            )
    return rows


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--drives", type=int, default=4, help="drives per family")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--family", action="append", help="only these families")
    parser.add_argument("-o", "--output", type=Path, help="write a page here")
    parser.add_argument("--json", help="write every run's figures here")
    parser.add_argument("--worst", action="store_true", help="also print the worst run of each family")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    families = [f for f in FAMILIES if not options.family or f.name in options.family]
    jobs = [(f, options.seed + i) for f in families for i in range(options.drives)]
    with ProcessPoolExecutor(options.jobs) as pool:
        rows = [row for part in pool.map(one_drive, jobs) for row in part]
    names = [f.name for f in FAMILIES]
    print("\n".join(table(rows, names)))
    if options.output:
        command = f"python benchmarks/calibration.py --drives {options.drives} --seed {options.seed}"
        options.output.write_text(page(rows, names, command), encoding="utf-8")
    if options.worst:
        for family in families:
            mine = [r for r in rows if r["family"] == family.name]
            worst = max(mine, key=lambda r: r["rms_120"])
            print(family.name, {k: round(v, 2) if isinstance(v, float) else v for k, v in worst.items()})
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
