"""How near does the default estimator come to the Cramér-Rao bound, on drives drawn from its own priors?

    python benchmarks/cramer_rao.py [--drives 20] [--seed 7600] [--driver NAME]... [--json FILE]
    python benchmarks/cramer_rao.py -o docs/measured/cramer-rao.md

The bound is that of van Trees for a random state, by the recursion of Tichavsky, Muravchik and Nehorai
(1998), along the true states of each drive (`cramer_rao_bound.py`).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cramer_rao_bound import LOADS_KG, OFFSET_STD_NM, ROAD_M, Road, bounds, draw_road, truth_of
from judging import Drive, estimate_with, prepare
from tables import Run, page_head
from variants import Variant

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S
from canest.estimators.default.constants import CONSTANTS
from canest.estimators.windowing import SHIFT
from canest.simulation.run import simulate

DRIVERS: dict[str, dict[str, Any]] = {
    "pulses": {"kind": "pulses"},
    "pulses, one gear": {"kind": "pulses", "start_mps": 21.0, "fixed_gear": 10, "max_mps": 26.0,
                         "min_mps": 16.0, "on_s": [8, 14], "off_s": [4, 8]},
    "mixed": {"kind": "mixed"},
}  # fmt: skip
DURATION_S, START_KG = 300.0, 21000.0
#: parts of a drive that are compared, s
PARTS_S = ((30.0, 60.0), (60.0, 120.0), (120.0, DURATION_S))
#: no road is steeper; in one gear a truck must get up it
STEEPEST = {"pulses": 0.04, "pulses, one gear": 0.02, "mixed": 0.04}
#: what is asked: at most so many times the bound
ASKED = 2.0
#: what an RMS is compared with
LIMITS = ("bound", "linear", "at once")
PERCENT = 100.0
#: long enough for nothing to change, s or m
NEVER = 1e12
#: the estimator, and the same told what the bound knows: all of these stay as they are
STEADY = Variant(
    "Told that load, wind, bias and torque are steady",
    {
        "steady_duration_s": NEVER, "surprise_share": 0.0, "motion_every_s": NEVER,
        "wind_length_m": NEVER, "bias_wander_m2ps5": 0.0, "offset_duration_s": NEVER,
    },
)  # fmt: skip
ESTIMATORS = (Variant("As it is"), STEADY)

ABOUT = """\
RMS error of `canest` beside the Cramér-Rao bound, on {drives} simulated drives drawn from the estimator's
own priors: roads, constant headwind (std 2 m/s), delay of the torque (0.08 s, std 0.04 s) and bias of the
accelerometer. The report lacks a constant torque at the crank (std half a step). Loads of 9 to 36 t,
no altitude, no undriven axle, nothing else undeclared, and the vehicle's facts stated as exact.

The bound is that of van Trees for a random state, by the recursion of Tichavsky, Muravchik and Nehorai
(1998), along the true states of each drive, sample by sample. It has the unknowns above and the rounding of
torque and friction. It knows the pitch and the stiffness of the driveline. It also knows that load,
wind, bias, lacking torque and driver are steady, which the estimator has to find out. What the first four
cost of that is the difference between the two tables. `bound` is also told where the road is curved. `linear`
is not told: it is what the best linear estimator reaches, to whom the curvature is noise of the same variance
and correlation.

Between two gears the vehicle coasts, and there the road shows without the mass. A driveline that opens
swings, and one that is reported open has closed already. So the bound counts a coasting from 0.12 s after
its begin to 0.16 s before its end, as the estimator does, and no sample of the dwell after a closed gate.
From that dwell the estimator takes some of its grade.
`at once` is the bound as if a driveline were at rest at once: all of these samples count, as exactly as all
others.

A stretch of road steeper than 4 % (in one gear 2 %, since the truck has to get up it) is drawn again. So the
roads are milder than the priors say, and RMS below the bound are possible: in one gear they are frequent.

All are root mean squares over the samples at which the force is known. `median drive`: half of the drives
have a smaller ratio of their own RMS to their own bound. Asked: RMS at most twice the bound."""


class Compared(NamedTuple):
    """One row: roots of the mean squares over drives, and the ratio of the median drive.

    rms: "mass" (percent) and "grade" (degrees), with "mass bound", "mass linear" and so on.
    median: "mass" and "grade", RMS / bound, each drive by its own.
    """

    driver: str
    accelerometer: bool
    part: int
    rms: dict[str, float]
    median: dict[str, float]


def scenario(driver: str, seed: int) -> tuple[dict[str, Any], Road]:
    """Draw a drive from the priors."""
    rng = np.random.default_rng(seed)
    road = draw_road(rng, STEEPEST[driver])
    grade = road.sine / np.sqrt(1.0 - road.sine**2)
    return {
        "seed": seed,
        "duration_s": DURATION_S,
        "vehicle": "class8",
        "mass_kg": float(np.exp(rng.uniform(*np.log(LOADS_KG)))),
        "road": {"kind": "points", "at_m": list(range(ROAD_M)), "grade": grade.round(7).tolist()},
        "driver": DRIVERS[driver],
        "sensors": {
            "accelerometer_bias_mps2": float(rng.normal(0.0, CONSTANTS.bias_std_mps2)),
            "torque_delay_s": max(float(rng.normal(SHIFT * STEP_S, CONSTANTS.delay_std_s)), 0.0),
        },
        "undeclared": [
            {"effect": "headwind", "wind_mps": float(rng.normal(0.0, CONSTANTS.wind_std_mps))},
            {"effect": "torque_offset", "torque_Nm": float(rng.normal(0.0, OFFSET_STD_NM))},
        ],
    }, road


def exact(drive: Drive) -> Drive:
    """Return the drive without altitude and undriven axle, of a vehicle whose stated facts are exact."""
    facts = replace(
        drive.facts,
        torque_accuracy=0.0,
        wheel_radius_accuracy=0.0,
        rolling_resistance_accuracy=0.0,
        drag_area_accuracy=0.0,
        slips=False,
    )
    unknown = np.full(len(drive.samples), np.nan)
    return replace(
        drive, facts=facts, samples=replace(drive.samples, altitude_m=unknown, undriven_mps=unknown)
    )


def one_drive(job: tuple[str, int]) -> list[Run]:
    """Simulate one drive; return mean squares of errors and bounds, without and with accelerometer."""
    jit.enable()
    driver, seed = job
    drawn, road = scenario(driver, seed)
    drive = exact(prepare(drawn))
    history = simulate(drawn).history
    truth, at_once = (truth_of(drive, history, road, kind) for kind in (False, True))
    t_s = (drive.samples.t_us - drive.samples.t_us[0]) * 1e-6
    runs = []
    for accelerometer in (False, True):
        limits: dict[str, FloatColumn] = {}
        for name, told in (("bound", True), ("linear", False), ("at once", True)):
            mass, grade = bounds(at_once if name == "at once" else truth, accelerometer, told)
            limits |= {f"mass {name}": (PERCENT * mass) ** 2, f"grade {name}": np.degrees(grade) ** 2}
        for variant in ESTIMATORS:
            estimates, _ = estimate_with(variant.make, drive, START_KG, accelerometer=accelerometer)
            squares = {
                "mass": (PERCENT * (estimates.mass_kg / drive.mass_kg - 1.0)) ** 2,
                "grade": np.degrees(np.arctan(estimates.grade) - np.arctan(drive.grade)) ** 2,
            } | limits
            for part, (first_s, last_s) in enumerate(PARTS_S):
                kept = (t_s >= first_s) & (t_s < last_s) & truth.known
                about = {"estimator": variant.name, "driver": driver, "seed": seed}
                about |= {"accelerometer": accelerometer, "part": part}
                runs.append(about | {name: _mean(column[kept]) for name, column in squares.items()})
    return runs


def _mean(column: FloatColumn) -> float:
    return float(np.mean(column))


def compared(runs: list[Run]) -> list[Compared]:
    """Pool the runs of every driver, with and without accelerometer, in every part."""
    found = []
    for driver in dict.fromkeys(run["driver"] for run in runs):
        for accelerometer in (False, True):
            for part in range(len(PARTS_S)):
                key = (driver, accelerometer, part)
                mine = [run for run in runs if (run["driver"], run["accelerometer"], run["part"]) == key]
                names = [name for name in mine[0] if name.startswith(("mass", "grade"))]
                rms = {name: float(np.sqrt(np.mean([run[name] for run in mine]))) for name in names}
                median = {
                    what: float(np.median([np.sqrt(run[what] / run[f"{what} bound"]) for run in mine]))
                    for what in ("mass", "grade")
                }
                found.append(Compared(*key, rms, median))
    return found


def table(rows: list[Compared]) -> list[str]:
    """Return the lines of the table in Markdown."""
    titles = ["driver", "accelerometer", "from, to, s"]
    for what in ("mass, %", "grade, degrees"):
        titles += [f"RMS of {what}", "bound", "linear", "at once", "RMS / bound", "median drive"]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for driver, accelerometer, part, rms, median in rows:
        first_s, last_s = PARTS_S[part]
        cells = [driver, "yes" if accelerometer else "no", f"{first_s:g}, {last_s:g}"]
        for name, digits in (("mass", 2), ("grade", 3)):
            cells += [f"{rms[key]:.{digits}f}" for key in (name, *(f"{name} {kind}" for kind in LIMITS))]
            ratio = rms[name] / rms[f"{name} bound"]
            cells += [f"{ratio:.2f}" if ratio <= ASKED else f"**{ratio:.2f}**", f"{median[name]:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def summary(rows: list[Compared]) -> str:
    """Return in how many rows the RMS is as near as is asked."""
    near = {
        f"{name} {kind}": sum(row.rms[name] <= ASKED * row.rms[f"{name} {kind}"] for row in rows)
        for name in ("mass", "grade")
        for kind in ("bound", "at once")
    }
    return (
        f"At most {ASKED:g} times the bound: mass in {near['mass bound']}, grade in {near['grade bound']} of "
        f"{len(rows)} rows. The others are bold. At most {ASKED:g} times the one `at once`: "
        f"{near['mass at once']} and {near['grade at once']}."
    )


def tables(runs: list[Run]) -> list[str]:
    """Return the lines of the tables of all estimators."""
    lines = []
    for variant in ESTIMATORS:
        rows = compared([run for run in runs if run["estimator"] == variant.name])
        lines += [f"## {variant.name}", "", *table(rows), "", summary(rows), ""]
    return lines


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--drives", type=int, default=20, help="drives per driver")
    parser.add_argument("--seed", type=int, default=7600, help="the first of them")
    parser.add_argument("--driver", action="append", choices=list(DRIVERS), help="only these")
    parser.add_argument("-o", "--output", type=Path, help="write a page here")
    parser.add_argument("--json", type=Path, help="write every run's mean squares here")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.drives)
    jobs = [(driver, seed) for driver in options.driver or DRIVERS for seed in seeds]
    runs: list[Run] = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for number, part in enumerate(pool.map(one_drive, jobs), 1):
            runs += part
            print(f"{number}/{len(jobs)} {jobs[number - 1]}", file=sys.stderr, flush=True)
    lines = tables(runs)
    print("\n".join(lines))
    if options.output:
        command = f"python benchmarks/cramer_rao.py --drives {options.drives} --seed {options.seed}"
        command += "".join(f' --driver "{name}"' for name in options.driver or [])
        command += " -o docs/measured/cramer-rao.md"
        head = page_head("Beside the Cramér-Rao bound", ABOUT.format(drives=len(jobs)), command)
        options.output.write_text("\n".join([*head, *lines]), encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps(runs, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
