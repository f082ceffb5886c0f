"""Does every mechanism of the default estimator pay? Each switched off, on the calibration and stress drives.

    python benchmarks/ablation.py [--drives 4] [--seed 7400] [--drive NAME]... [--only NAME]...
    python benchmarks/ablation.py -o docs/measured/ablation.md

A mechanism is switched off by the values of constants, by what the vehicle's facts say, by another step in
place of one of the loop, or by removing a signal from the samples (`ablation_list.py`). A positive difference
of an RMS means that the mechanism pays.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from ablation_list import MECHANISMS
from tables import HEADINGS, Run, drive_count, page_head
from variants import (
    DEFAULT,
    FAMILIES,
    FIGURES,
    NAMES,
    Effect,
    by_variant,
    command_line,
    common_options,
    default_line,
    difference,
    effect,
    jobs_of,
    means,
    run_all,
    write_results,
)

#: what a set of drives is called, and which they are
SETS = {"calibration": list(FAMILIES), "stress": [name for name in NAMES if name not in FAMILIES]}
#: figures that are better where they are larger
LARGER = ("in2", "grade_in2", "valid")
#: what they are called in a list
SHORT = {
    "rms_120": "mass RMS", "in2": "mass in 2 std", "grade_rms": "grade RMS", "grade_in2": "grade in 2 std",
    "valid": "valid", "valid_wrong": "valid but wrong",
}  # fmt: skip
#: standard errors of a mean difference that count as found, among so many
FOUND = 3.0
#: drives of a mechanism shown one by one, each way
SHOWN = 2
#: smaller changes of one drive are not shown, points
SMALL = 0.1

RARE = "What acts on one kind of drive only hardly shows in a mean: the last table has it."
ABOUT = """\
Each mechanism of `canest` switched off, one at a time, on {drives} simulated drives of the
calibration and stress benchmarks: without accelerometer / with it. The first row is the whole
estimator, the others are mean differences from it, in points (grade RMS: degrees): where an RMS rises,
the mechanism pays. Bold: beyond two standard errors of the mean. A run notices where an RMS changes
by 2 % of it, or a share by a point. Mass RMS is the mean over the runs, stops with a changed load
included. The mechanisms with the largest effect come first."""


def of_drives(runs: list[Run], drives: Sequence[str]) -> list[Run]:
    """Return the runs of some drives."""
    return [run for run in runs if run["drive"] in drives]


def effects(runs: list[Run], names: Sequence[str]) -> list[tuple[str, Effect]]:
    """Return what leaving out each mechanism changes over all drives, the largest effect first."""
    found = by_variant(runs)
    pairs = [(name, effect(found[DEFAULT], found[name])) for name in names]
    return sorted(pairs, key=lambda pair: -pair[1].size)


def table(runs: list[Run], found: list[tuple[str, Effect]], drives: Sequence[str]) -> list[str]:
    """Return the lines of one set's table in Markdown: the default, then differences from it."""
    sets = [
        by_variant([run for run in of_drives(runs, drives) if run["accelerometer"] is has])
        for has in (False, True)
    ]
    sets = [one for one in sets if one]
    titles = ["without", "runs that notice, %", *(HEADINGS[figure] for figure in FIGURES)]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    wholes = [means(one[DEFAULT]) for one in sets]
    cells = [" / ".join(f"{whole[figure]:.2f}" for whole in wholes) for figure in FIGURES]
    lines.append("| **nothing** | | " + " | ".join(cells) + " |")
    for name, _ in found:
        both = [effect(one[DEFAULT], one[name]) for one in sets]
        cells = [name, " / ".join(f"{one.noticed:.0f}" for one in both)]
        cells += [" / ".join(difference(one, figure) for one in both) for figure in FIGURES]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def what_pays(runs: list[Run], found: list[tuple[str, Effect]]) -> list[str]:
    """Return the lines of a table: the figures that are worse without a mechanism, and those better.

    After it those mechanisms without which no figure is certainly another.
    """
    lines = ["| without | drives | worse | better |", "|---|---|---|---|"]
    idle = []
    for name, _ in found:
        before = len(lines)
        for title, drives in SETS.items():
            variants = by_variant(of_drives(runs, drives))
            if not variants:
                continue
            one = effect(variants[DEFAULT], variants[name])
            cells: tuple[list[str], list[str]] = ([], [])
            for figure in FIGURES:
                if one.is_certain(figure, FOUND):
                    is_better = (one.differences[figure] > 0.0) == (figure in LARGER)
                    text = difference(one, figure).replace("**", "")
                    cells[is_better].append(f"{SHORT[figure]} {text}")
            if any(cells):
                lines.append(f"| {name} | {title} | {', '.join(cells[0])} | {', '.join(cells[1])} |")
        if len(lines) == before:
            idle.append(f"- {name}")
    return [*lines, "", "Without these no figure changes so much:", "", *(idle or ["- none"])]


def single_drives(runs: list[Run], found: list[tuple[str, Effect]]) -> list[str]:
    """Return the lines of a table: the drives whose mass RMS changes most, before and after."""
    lines = ["| without | worse, % | better, % |", "|---|---|---|"]
    by_drive = {
        drive: {name: means(mine)["rms_120"] for name, mine in by_variant(of_drives(runs, [drive])).items()}
        for drive in dict.fromkeys(run["drive"] for run in runs)
    }
    for name, _ in found:
        changes = sorted(
            (rms[name] - rms[DEFAULT], f"{drive}: {rms[DEFAULT]:.2f} → {rms[name]:.2f}")
            for drive, rms in by_drive.items()
            if not np.isnan(rms[name] - rms[DEFAULT])
        )
        worse = [text for change, text in changes[::-1][:SHOWN] if change > SMALL]
        better = [text for change, text in changes[:SHOWN] if change < -SMALL]
        lines.append(f"| {name} | {'; '.join(worse)} | {'; '.join(better)} |")
    return lines


def page(runs: list[Run], found: list[tuple[str, Effect]], command: str) -> str:
    """Return the tables as a page of the docs."""
    about = ABOUT.format(drives=drive_count(runs))
    lines = page_head("Ablation", about, f"{command} -o docs/measured/ablation.md")
    lines += ["## What pays", "", f"Mean differences beyond {FOUND:g} standard errors. {RARE}", ""]
    lines += [*what_pays(runs, found), ""]
    for title, names in SETS.items():
        if of_drives(runs, names):
            lines += [f"## On the {title} drives", "", *table(runs, found, names), ""]
    lines += ["## The drives that change most", "", "Mass RMS from 120 s, with the mechanism → without.", ""]
    lines += [*single_drives(runs, found), ""]
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    names = [mechanism.name for mechanism in MECHANISMS]
    common_options(parser, NAMES, names, seed=7400)
    options = parser.parse_args()
    chosen = [m for m in MECHANISMS if not options.only or m.name in options.only]
    runs = run_all(jobs_of(options, chosen), options.jobs)
    found = effects(runs, [mechanism.name for mechanism in chosen])
    print(default_line(by_variant(runs)[DEFAULT]))
    print("\n".join(what_pays(runs, found)))
    for names_of_set in SETS.values():
        if of_drives(runs, names_of_set):
            print("\n".join(table(runs, found, names_of_set)))
    write_results(options, page(runs, found, command_line("ablation", options)), runs)


if __name__ == "__main__":
    main()
