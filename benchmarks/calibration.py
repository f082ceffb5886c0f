"""How right is an estimator, and how right about how right it is: many simulated drives, several starts.

    python benchmarks/calibration.py [--drives 4] [--seed 100] [--family NAME]... [--estimator NAME]...
                                     [--json FILE] [--worst]
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from judging import Drive, by_gate, estimate, estimator_name, judge, prepare
from tables import Run, drive_count, grouped, page_head, page_table, text_table

from canest.core import jit

STARTS_KG = (9000.0, 21000.0, 36000.0)
FIGURES = ("mass_rms", "mass_max", "rms_120", "settled_max", "grade_rms", "in2", "in3", "grade_in2")
FIGURES += ("grade_in3", "std", "valid", "valid_wrong", "valid_beyond", "nis")
PAGE_FIGURES = ("rms_120", "settled_max", "std", "in2", "in3", "grade_rms", "grade_in2", "grade_in3")
PAGE_FIGURES += ("valid", "valid_wrong", "nis")


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


def one_drive(job: tuple[Family, int, list[str]]) -> list[Run]:
    """Simulate one drive and estimate it from every start, with and without accelerometer."""
    jit.enable()
    family, seed, estimators = job
    scenario, drive = draw(family, seed)
    runs = []
    for gate, names in by_gate(estimators).items():
        gated = prepare(scenario, excitation_gate=True) if gate else drive
        for name in names:
            for accelerometer in (False, True):
                for start in STARTS_KG:
                    estimates, innovations = estimate(name, gated, start, accelerometer=accelerometer)
                    runs.append(
                        {
                            "drive": family.name,
                            "seed": seed,
                            "load_t": scenario["mass_kg"][0]["mass_kg"] / 1000,
                            "estimator": name,
                            "accelerometer": accelerometer,
                            "start_t": start / 1000,
                            **judge(gated, estimates),
                            **innovations,
                        }
                    )
    return sorted(runs, key=lambda run: estimators.index(run["estimator"]))


ABOUT = """\
{drives} simulated drives with loads of 9 to 36 t (city: two changes of load in long stops), each
from starts of 9, 21 and 36 t; starred ones carry undeclared errors. RMS is over all samples, gated
ones and stops with a changed load too; `settled` means 60 s of open gates after a change. In n
std: the truth lies within n standard deviations, from 60 s on. NIS: normalised innovation squared,
1 when honest."""


def page(runs: list[Run], command: str) -> str:
    """Return the table as a page of the docs."""
    about = ABOUT.format(drives=drive_count(runs))
    command += " -o docs/measured/calibration.md"
    head = page_head("How right, and how right about how right", about, command)
    table = page_table(list(grouped(runs, [f.name for f in FAMILIES], total=True)), PAGE_FIGURES)
    return "\n".join([*head, *table, ""])


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--drives", type=int, default=4, help="drives per family")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--family", action="append", help="only these families")
    parser.add_argument(
        "--estimator", action="append", type=estimator_name, help="only these (default: canest)"
    )
    parser.add_argument("-o", "--output", type=Path, help="write a page here")
    parser.add_argument("--json", help="write every run's figures here")
    parser.add_argument("--worst", action="store_true", help="also print the worst run of each family")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    estimators = options.estimator or ["canest"]
    families = [f for f in FAMILIES if not options.family or f.name in options.family]
    jobs = [(f, options.seed + i, estimators) for f in families for i in range(options.drives)]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = [run for part in pool.map(one_drive, jobs) for run in part]
    print("\n".join(text_table(list(grouped(runs, [f.name for f in FAMILIES], total=True)), FIGURES)))
    if options.output:
        command = f"python benchmarks/calibration.py --drives {options.drives} --seed {options.seed}"
        command += "".join(f" --estimator {name}" for name in options.estimator or [])
        options.output.write_text(page(runs, command), encoding="utf-8")
    if options.worst:
        for family in families:
            mine = [run for run in runs if run["drive"] == family.name]
            worst = max(mine, key=lambda run: run["rms_120"])
            print(family.name, {k: round(v, 2) if isinstance(v, float) else v for k, v in worst.items()})
    if options.json:
        Path(options.json).write_text(json.dumps(runs, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
