"""The default estimator with something changed, on the drives of two benchmarks.

Shared by `sensitivity.py` and `ablation.py`. A drive is simulated once, then every variant estimates it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import calibration
import numpy as np
import stress
from calibration_drives import INSIDE
from judging import Drive, estimate_with, judge
from patched import patched
from stress_rows import BY_NAME
from tables import HEADINGS, Run

from canest.core import jit
from canest.core.frames import FloatColumn
from canest.core.samples import ModelBlock, VehicleFacts
from canest.estimators.default.constants import CONSTANTS, Constants
from canest.estimators.default.estimator import GaussianSum

START_KG = 21000.0
FAMILIES = {family.name: family for family in INSIDE}
NAMES = [*FAMILIES, *BY_NAME]
DEFAULT = "default"
FIGURES = ("rms_120", "in2", "grade_rms", "grade_in2", "valid", "valid_wrong")
#: figures in percent, whose differences can be compared with each other
SHARES = tuple(figure for figure in FIGURES if figure != "grade_rms")
#: a run changes noticeably where an RMS changes by this share of it, or a share by so many points
NOTICED_RMS, NOTICED_POINTS = 0.02, 1.0


@dataclass(frozen=True)
class Variant:
    """The estimator with something changed.

    values: constants. patch: other names of its modules ("module.NAME"), see `patched`. facts: what it knows
    of the vehicle. edit: what happens to the samples.
    """

    name: str
    values: Mapping[str, float] = field(default_factory=dict)
    patch: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    edit: Callable[[ModelBlock], ModelBlock] | None = None

    def make(self, facts: VehicleFacts) -> GaussianSum:
        """Return an estimator of this kind."""
        constants = changed(CONSTANTS, self.values)
        kind: type[GaussianSum] = type("Variant", (GaussianSum,), {"constants": constants})
        return kind(GaussianSum.descriptions[0].name, replace(facts, **self.facts))


Job = tuple[str, int, Sequence[Variant]]


class Effect(NamedTuple):
    """What a variant changes: mean differences from the default, and in how many runs that is noticeable."""

    differences: dict[str, float]
    errors: dict[str, float]  #: standard errors of these means
    noticed: float  #: percent of the runs

    @property
    def size(self) -> float:
        """The largest difference of a figure in percent, in points."""
        sizes = [abs(self.differences[figure]) for figure in SHARES]
        return max((size for size in sizes if not np.isnan(size)), default=0.0)

    def is_certain(self, figure: str) -> bool:
        """Return whether a difference is larger than two of its standard errors."""
        return abs(self.differences[figure]) > 2.0 * self.errors[figure]


def changed(constants: Constants, values: Mapping[str, float]) -> Constants:
    """Return constants with some values changed."""
    return constants._replace(**{name: float(value) for name, value in values.items()})


def without(column: str, samples: ModelBlock) -> ModelBlock:
    """Return the samples without one signal."""
    return replace(samples, **{column: np.full(len(samples), np.nan)})


def draw(name: str, seed: int) -> Drive:
    """Simulate a drive of a family of `calibration.py` or of a row of `stress.py`."""
    if name in FAMILIES:
        return calibration.draw(FAMILIES[name], seed)[1]
    row = BY_NAME[name]
    return stress.draw(row, seed * row.phases + seed % row.phases)


def one_drive(job: Job) -> list[Run]:
    """Simulate one drive and judge every variant on it, without and with accelerometer."""
    jit.enable()
    name, seed, variants = job
    drive = draw(name, seed)
    row = BY_NAME.get(name)
    start_kg = row.start_kg if row else START_KG
    runs: list[Run] = []
    for variant in variants:
        edited = replace(drive, samples=variant.edit(drive.samples)) if variant.edit else drive
        for accelerometer in row.accelerometer if row else (False, True):
            with patched(variant.patch):
                estimates, _ = estimate_with(variant.make, edited, start_kg, accelerometer=accelerometer)
            figures = stress.judged(row, drive, estimates) if row else judge(drive, estimates)
            about = {"drive": name, "seed": seed, "variant": variant.name, "accelerometer": accelerometer}
            runs.append(about | {figure: figures[figure] for figure in FIGURES})
    return runs


def run_all(jobs: Sequence[Job], workers: int) -> list[Run]:
    """Return the runs of all drives in order; progress goes to stderr."""
    found: dict[int, list[Run]] = {}
    with ProcessPoolExecutor(workers) as pool:
        waiting = {pool.submit(one_drive, job): number for number, job in enumerate(jobs)}
        for done in as_completed(waiting):
            found[waiting[done]] = done.result()
            name, seed, _ = jobs[waiting[done]]
            print(f"{len(found)}/{len(jobs)} {name}, seed {seed}", file=sys.stderr, flush=True)
    return [run for number in sorted(found) for run in found[number]]


def means(runs: list[Run]) -> dict[str, float]:
    """Return the means of the figures over the runs that have them.

    The mean, also of an RMS: in a pooled square the stops in which a load changes would drown the rest.
    """
    return {figure: _mean(_column(runs, figure)) for figure in FIGURES}


def effect(default: list[Run], variant: list[Run]) -> Effect:
    """Compare the runs of a variant with those of the default on the same drives in the same order.

    The standard error takes the runs of one drive, without and with accelerometer, as one.
    """
    differences, errors, noticed = {}, {}, np.zeros(len(default), np.bool_)
    drives: dict[tuple[str, int], list[int]] = {}
    for number, run in enumerate(default):
        drives.setdefault((run["drive"], run["seed"]), []).append(number)
    for figure in FIGURES:
        before, after = _column(default, figure), _column(variant, figure)
        differences[figure] = _mean(after - before)
        of_drives = np.array([_mean((after - before)[rows]) for rows in drives.values()])
        errors[figure] = _standard_error(of_drives)
        least = NOTICED_POINTS if "rms" not in figure else NOTICED_RMS * before
        noticed |= (np.abs(after - before) > least) | (np.isnan(after) != np.isnan(before))
    return Effect(differences, errors, 100.0 * float(np.mean(noticed)))


def by_variant(runs: list[Run]) -> dict[str, list[Run]]:
    """Return the runs of every variant."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run["variant"], []).append(run)
    return found


def _column(runs: list[Run], figure: str) -> FloatColumn:
    return np.array([run[figure] for run in runs], np.float64)


def _mean(column: FloatColumn) -> float:
    known = column[~np.isnan(column)]
    return float(np.mean(known)) if len(known) else float("nan")


def _standard_error(column: FloatColumn) -> float:
    known = column[~np.isnan(column)]
    return float(np.std(known, ddof=1) / np.sqrt(len(known))) if len(known) > 1 else float("inf")


def default_line(runs: list[Run]) -> str:
    """Return the figures of the default in a sentence."""
    figures = means(runs)
    return "Default: " + "; ".join(f"{HEADINGS[f]}: {figures[f]:.2f}" for f in FIGURES) + "."


def difference(found: Effect, figure: str) -> str:
    """Return the mean difference of a figure, bold where it is certain."""
    digits = 3 if figure == "grade_rms" else 2
    text = f"{found.differences[figure]:+.{digits}f}"
    return f"**{text}**" if found.is_certain(figure) else text


def common_options(
    parser: argparse.ArgumentParser, drives: Sequence[str], variants: Sequence[str], seed: int
) -> None:
    """Add the options that both benchmarks have. drives: what is driven unless `--drive` is given."""
    parser.add_argument("--drives", type=int, default=1, help="drives of every kind")
    parser.add_argument("--seed", type=int, default=seed, help="the first of them")
    listed = "; ".join(NAMES).replace("%", "%%")  # argparse fills in what follows one %
    parser.add_argument(
        "--drive", action="append", choices=NAMES, metavar="NAME", help=f"only these, of: {listed}"
    )
    listed = "; ".join(variants).replace("%", "%%")
    parser.add_argument(
        "--only", action="append", choices=variants, metavar="NAME", help=f"only these, of: {listed}"
    )
    parser.add_argument("-o", "--output", type=Path, help="write a page here")
    parser.add_argument("--json", type=Path, help="write every run's figures here")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.set_defaults(usual_drives=list(drives))


def jobs_of(options: Any, variants: Sequence[Variant]) -> list[Job]:
    """Return one job per drive, the default first among its variants."""
    every = (Variant(DEFAULT), *variants)
    seeds = range(options.seed, options.seed + options.drives)
    return [(name, seed, every) for name in options.drive or options.usual_drives for seed in seeds]


def command_line(script: str, options: Any) -> str:
    """Return the command that gives the same page."""
    words = f"python benchmarks/{script}.py --drives {options.drives} --seed {options.seed}"
    words += "".join(f' --drive "{name}"' for name in options.drive or [])
    return words + "".join(f' --only "{name}"' for name in options.only or [])


def write_results(options: Any, page: str, runs: list[Run]) -> None:
    """Write the page and the runs' figures where the options want them."""
    if options.output:
        options.output.write_text(page, encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps(runs, indent=1), encoding="utf-8")
