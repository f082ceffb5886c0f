"""Is `valid` true where the benchmark of calibration does not look? Drives that break an estimator's model.

    python benchmarks/stress.py [--seeds 4] [--seed 500] [--row NAME]... [--estimator NAME]... [--json FILE]
    python benchmarks/stress.py -o docs/measured/stress.md

Loads that change in motion, wrong signals, roads and drivers that mislead, vehicles unlike their data sheet:
every row is a number of simulated drives (another road, load and driver by seed), with and without the
accelerometer. What is asked of an estimator is less that it is right than that it knows when it is not.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

from judging import Drive, by_gate, estimate, estimator_name, judge, prepare
from stress_rows import BY_NAME, ROWS, Row
from tables import Run, grouped, page_table, text_table

from canest.core import jit
from canest.core.nearest_name import expected_name
from canest.core.samples import EstimateBlock

FIGURES = ("rms_120", "bias", "settled_max", "std", "in2", "in3", "grade_rms", "grade_in2", "grade_in3")
FIGURES += ("valid", "ever_valid", "valid_wrong", "valid_beyond", "nis")
NAMES = [row.name for row in ROWS]
GROUPS = list(dict.fromkeys(row.group for row in ROWS))

Job = tuple[str, int, list[str]]


def one_drive(job: Job) -> list[Run]:
    """Simulate one drive of a row and judge every estimator on it, with and without accelerometer."""
    jit.enable()
    name, seed, estimators = job
    row, runs = BY_NAME[name], []
    for gate, names in by_gate(estimators).items():
        drive = draw(row, seed, excitation_gate=gate)
        for estimator in names:
            for accelerometer in row.accelerometer:
                estimates, innovations = estimate(estimator, drive, row.start_kg, accelerometer=accelerometer)
                figures = judged(row, drive, estimates) | innovations
                about = {"drive": name, "seed": seed, "estimator": estimator, "accelerometer": accelerometer}
                runs.append(about | figures)
    return sorted(runs, key=lambda run: estimators.index(run["estimator"]))


def draw(row: Row, seed: int, *, excitation_gate: bool = False) -> Drive:
    """Simulate one drive of a row, with what is wrong with its signals and facts."""
    drive = prepare(
        *row.scenarios(seed),
        edit=row.edit_frames,
        excitation_gate=excitation_gate,
        own_config=row.own_config,
    )
    samples = row.edit_samples(drive.samples) if row.edit_samples else drive.samples
    return replace(drive, samples=samples, facts=replace(drive.facts, **row.facts))


def judged(row: Row, drive: Drive, estimates: EstimateBlock) -> dict[str, float]:
    """Return the figures of one run, over the part of the drive that its row asks about."""
    if row.judged_s is None:
        return judge(drive, estimates)
    kept = drive.between(*row.judged_s)
    columns = (estimates.mass_kg, estimates.mass_std_kg, estimates.grade, estimates.grade_std)
    part = EstimateBlock(*(column[kept] for column in columns), status=estimates.status[kept])
    return judge(drive.part(kept), part, first_s=0.0, later_s=0.0)


def run_all(jobs: list[Job], workers: int) -> list[Run]:
    """Return the runs of all drives in order; progress goes to stderr."""
    with ProcessPoolExecutor(workers) as pool:
        waiting = {pool.submit(one_drive, job): number for number, job in enumerate(jobs)}
        found: dict[int, list[Run]] = {}
        for done in as_completed(waiting):
            number = waiting[done]
            found[number] = done.result()
            name, seed, _ = jobs[number]
            print(f"{len(found)}/{len(jobs)} {name}, seed {seed}", file=sys.stderr, flush=True)
    return [run for number in sorted(found) for run in found[number]]


def page(runs: list[Run], command: str) -> str:
    """Return the tables as a page of the docs."""
    lines = [
        "# Stress",
        "",
        "Simulated drives that break the model of an estimator. `valid but off by 8 %` and `by 3 std` are",
        "shares of the `valid` samples, in the mean over the drives; by 3 std counts where an accuracy of",
        "the torque is stated as bad as it is. Mass RMS and mean error count from 120 s on, the rest from",
        "60 s on. Of the first 10 s after eight hours of silence, and of the manoeuvre, all samples count.",
        "NIS: normalised innovation squared, 1 when honest.",
        "",
        f"    {command} -o docs/measured/stress.md",
        "",
    ]
    for group in GROUPS:
        mine = list(grouped(runs, [row.name for row in ROWS if row.group == group]))
        if mine:
            lines += [f"## {group}", "", *page_table(mine, FIGURES), ""]
    return "\n".join(lines)


def row_name(text: str) -> str:
    """Return the name of a row that a command line gives."""
    if text not in BY_NAME:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected_name(text, NAMES, 'a row')}")
    return text


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="drives per row")
    parser.add_argument("--seed", type=int, default=500, help="the first of them")
    listed = "; ".join(NAMES).replace("%", "%%")  # argparse fills in what follows one %
    parser.add_argument("--row", action="append", type=row_name, help=f"only these, of: {listed}")
    parser.add_argument(
        "--estimator", action="append", type=estimator_name, help="only these (default: canest)"
    )
    parser.add_argument("-o", "--output", type=Path, help="write a page here")
    parser.add_argument("--json", type=Path, help="write every run's figures here")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    rows, estimators = options.row or NAMES, options.estimator or ["canest"]
    jobs = [
        (name, seed * BY_NAME[name].phases + phase, estimators)
        for name in rows
        for seed in range(options.seed, options.seed + options.seeds)
        for phase in range(BY_NAME[name].phases)
    ]
    runs = run_all(jobs, options.jobs)
    print("\n".join(text_table(list(grouped(runs, NAMES)), FIGURES)))
    if options.output:
        command = f"python benchmarks/stress.py --seeds {options.seeds} --seed {options.seed}"
        command += "".join(f" --estimator {name}" for name in options.estimator or [])
        options.output.write_text(page(runs, command), encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps(runs, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
