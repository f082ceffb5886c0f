"""What does every constant of the default estimator change, halved and doubled?

    python benchmarks/sensitivity.py [--drives 4] [--seed 7500] [--drive NAME]... [--only NAME]...
    python benchmarks/sensitivity.py -o docs/measured/sensitivity.md

One constant is changed at a time, on the same simulated drives. What cannot be more than 1 stays below.
"""

from __future__ import annotations

import argparse

from tables import HEADINGS, Run, drive_count, page_head
from variants import (
    DEFAULT,
    FIGURES,
    NAMES,
    Effect,
    Variant,
    by_variant,
    command_line,
    common_options,
    default_line,
    difference,
    effect,
    jobs_of,
    run_all,
    write_results,
)

from canest.estimators.default.constants import CONSTANTS

VALUES = CONSTANTS._asdict()
ABOUT = """\
Every constant of `canest` halved / doubled, one at a time, on {drives} simulated drives of every kind
of the calibration and stress benchmarks, without and with accelerometer, {runs} runs. What cannot be
more than 1 is set to 1 at most, a probability to {most:g}.

Shown are the mean differences from the default, in points (grade RMS: degrees). Bold: beyond two
standard errors of the mean. Effect: the largest of those in percent. A run notices where an RMS
changes by 2 % of it, or a share by a point. Mass RMS is the mean over the runs, stops with a changed
load included. `canest estimators show canest` prints what each constant is, and its source."""
#: what must stay below 1, and the most it is set to
PROBABILITIES = ("answered_share", "surprise_share", "left_out_share")
MOST_PROBABLE = 0.99
#: these too count their share of a whole
WHOLE = ("likelihood_power",)
HALVED, DOUBLED = "halved", "doubled"
#: below both of these a constant changes nothing that matters
SMALL_POINTS, SMALL_RUNS = 0.1, 10.0


def values_of(name: str) -> dict[str, float]:
    """Return the values that a constant is set to."""
    value = VALUES[name]
    doubled = 2.0 * value
    if name in PROBABILITIES:
        doubled = min(doubled, MOST_PROBABLE)
    elif name in WHOLE:
        doubled = min(doubled, 1.0)
    return {HALVED: value / 2.0, DOUBLED: doubled}


def variants_of(names: list[str]) -> list[Variant]:
    """Return the estimator with each of these constants halved, and doubled."""
    return [
        Variant(f"{name} {how}", {name: value}) for name in names for how, value in values_of(name).items()
    ]


def effects(runs: list[Run], names: list[str]) -> list[tuple[str, Effect, Effect]]:
    """Return what each constant changes, halved and doubled; that with the largest effect first."""
    found = by_variant(runs)
    default = found[DEFAULT]
    pairs = [
        (name, effect(default, found[f"{name} {HALVED}"]), effect(default, found[f"{name} {DOUBLED}"]))
        for name in names
    ]
    return sorted(pairs, key=lambda pair: -size(pair[1], pair[2]))


def size(halved: Effect, doubled: Effect) -> float:
    """Return the larger of two effects, points."""
    return max(halved.size, doubled.size)


def without_effect(found: list[tuple[str, Effect, Effect]]) -> list[str]:
    """Return the constants that change nothing that matters."""
    return [
        name
        for name, halved, doubled in found
        if size(halved, doubled) < SMALL_POINTS and max(halved.noticed, doubled.noticed) < SMALL_RUNS
    ]


def table(found: list[tuple[str, Effect, Effect]]) -> list[str]:
    """Return the lines of the table in Markdown."""
    titles = ["constant", "value", "effect, points", "runs that notice, %", *(HEADINGS[f] for f in FIGURES)]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for name, halved, doubled in found:
        cells = [f"`{name}`", f"{VALUES[name]:g}", f"{size(halved, doubled):.2f}"]
        cells.append(f"{halved.noticed:.0f} / {doubled.noticed:.0f}")
        cells += [f"{difference(halved, f)} / {difference(doubled, f)}" for f in FIGURES]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def page(runs: list[Run], found: list[tuple[str, Effect, Effect]], command: str) -> str:
    """Return the table as a page of the docs."""
    default = by_variant(runs)[DEFAULT]
    small = without_effect(found)
    about = ABOUT.format(drives=drive_count(runs), runs=len(default), most=MOST_PROBABLE)
    lines = [
        *page_head("Sensitivity", about, f"{command} -o docs/measured/sensitivity.md"),
        default_line(default),
        "",
        *table(found),
        "",
        f"Effect below {SMALL_POINTS:g} points and noticed by less than {SMALL_RUNS:g} % of the runs, "
        f"{len(small)} of {len(found)}:",
        (", ".join(f"`{name}`" for name in small) or "none") + ".",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    names = list(VALUES)
    common_options(parser, NAMES, names, seed=7500)
    options = parser.parse_args()
    chosen = [name for name in names if not options.only or name in options.only]
    runs = run_all(jobs_of(options, variants_of(chosen)), options.jobs)
    found = effects(runs, chosen)
    print(default_line(by_variant(runs)[DEFAULT]))
    print("\n".join(table(found)))
    write_results(options, page(runs, found, command_line("sensitivity", options)), runs)


if __name__ == "__main__":
    main()
