"""What does every constant of the default estimator change, halved and doubled?

    python benchmarks/sensitivity.py [--drives 1] [--seed 900] [--drive NAME]... [--only GROUP.NAME]...
    python benchmarks/sensitivity.py -o docs/measured/sensitivity.md

One constant is changed at a time, on the same simulated drives. What cannot be more than 1 stays below.
"""

from __future__ import annotations

import argparse

from tables import HEADINGS, Run, drive_count, page_head
from variants import (
    DEFAULT,
    FAMILIES,
    SHARES,
    Effect,
    Variant,
    by_variant,
    command_line,
    common_options,
    constant_names,
    default_line,
    effect,
    jobs_of,
    run_all,
    value_of,
    write_results,
)

ABOUT = """\
Every constant of `canest` halved / doubled, one at a time, on {drives} simulated drives,
without and with accelerometer, {runs} runs:

- of the calibration benchmark: {calibration}
- of the stress benchmark: {stress}

Shown are the mean differences from the default, in points. Effect: the largest of them. A run
notices where an RMS changes by 2 % of it, or a share by a point. Mass RMS is the mean over the
runs, stops with a changed load included."""
#: what must stay below 1, and the most it is set to
PROBABILITIES = ("driver.answered_share", "load.moving_probability", "load.drift_probability")
PROBABILITIES += ("load.surprised_probability", "noise.ringing")
MOST_PROBABLE = 0.99
#: these too count their share of a whole
WHOLE = ("noise.power",)
#: rows of the stress benchmark that are driven beside the calibration families
ROWS = ("spreader 10 kg/s, mixed", "loaded in motion", "other load after 12 to 22 s", "torque zeros 5 %")
ROWS += ("retarder unreported", "road in steps", "sine road, mixed", "motorway", "rough road", "wind 8 m/s")
HALVED, DOUBLED = "halved", "doubled"
#: below both of these a constant changes nothing that matters
SMALL_POINTS, SMALL_RUNS = 0.1, 10.0


def values_of(name: str) -> dict[str, float]:
    """Return the values that a constant is set to."""
    value = value_of(name)
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
    titles = ["constant", "value", "effect, points", "runs that notice, %", *(HEADINGS[f] for f in SHARES)]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for name, halved, doubled in found:
        cells = [f"`{name}`", f"{value_of(name):g}", f"{size(halved, doubled):.2f}"]
        cells.append(f"{halved.noticed:.0f} / {doubled.noticed:.0f}")
        cells += [f"{halved.differences[f]:+.2f} / {doubled.differences[f]:+.2f}" for f in SHARES]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def page(runs: list[Run], found: list[tuple[str, Effect, Effect]], command: str) -> str:
    """Return the table as a page of the docs."""
    default = by_variant(runs)[DEFAULT]
    small = ", ".join(f"`{name}`" for name in without_effect(found)) or "none"
    driven = dict.fromkeys(run["drive"] for run in default)
    about = ABOUT.format(
        drives=drive_count(runs),
        runs=len(default),
        calibration=", ".join(name for name in driven if name in FAMILIES) or "none",
        stress=", ".join(name for name in driven if name not in FAMILIES) or "none",
    )
    lines = [
        *page_head("Sensitivity", about, f"{command} -o docs/measured/sensitivity.md"),
        default_line(default),
        "",
        *table(found),
        "",
        f"Effect below {SMALL_POINTS:g} points, noticed by less than {SMALL_RUNS:g} % of the runs:",
        f"{small}.",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    names = constant_names()
    common_options(parser, [*FAMILIES, *ROWS], names, seed=900)
    options = parser.parse_args()
    chosen = [name for name in names if not options.only or name in options.only]
    runs = run_all(jobs_of(options, variants_of(chosen)), options.jobs)
    found = effects(runs, chosen)
    print(default_line(by_variant(runs)[DEFAULT]))
    print("\n".join(table(found)))
    write_results(options, page(runs, found, command_line("sensitivity", options)), runs)


if __name__ == "__main__":
    main()
