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
from ablation_changes import CHANCE, pays_on
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
#: drives of a mechanism shown one by one, each way
SHOWN = 2
#: smaller changes of one drive are not shown, points
SMALL = 0.1

WHERE = """\
Means over the drives of one kind, with the mechanism → without it, the most certain first (*with*: with
accelerometer). Each is beyond chance by a t-test of the differences, at {chance:g} % for all tests of a
mechanism together. What acts on few drives is beyond no test: the last table has single drives."""
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
    lines += ["## What pays, and where", "", WHERE.format(chance=100 * CHANCE), ""]
    lines += [*pays_on(runs, [name for name, _ in found]), ""]
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
    print("\n".join(pays_on(runs, [name for name, _ in found])))
    for names_of_set in SETS.values():
        if of_drives(runs, names_of_set):
            print("\n".join(table(runs, found, names_of_set)))
    write_results(options, page(runs, found, command_line("ablation", options)), runs)


if __name__ == "__main__":
    main()
