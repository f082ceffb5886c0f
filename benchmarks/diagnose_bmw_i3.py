"""Diagnosis of measured trips of an electric car: found on half of the trips, judged on the other half.

    python benchmarks/diagnose_bmw_i3.py DIR_WITH_TABLES -o docs/measured/bmw-i3.md

DIR holds one table per trip (.csv or .parquet, also compressed) with the columns that `configs/bmw-i3.yaml`
names. The page says what was found and what it does to trips that took no part in finding it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from canest.config import load_config
from canest.core import jit
from canest.diagnosis.data.drive import Drive
from canest.diagnosis.data.problem import MIN_WINDOWS, Problem
from canest.diagnosis.data.reference import reference_for
from canest.diagnosis.entries import Entry, entries
from canest.diagnosis.outcome import reference_limits
from canest.diagnosis.report.format import entry_name, entry_value, interval, score_rows
from canest.diagnosis.report.revised_config import revised_config
from canest.diagnosis.run import Diagnosis, diagnose
from canest.diagnosis.search.value_fit import fit_on
from canest.pipeline.build import effects_of
from canest.vehicle.effects import Effect

SUFFIXES = (".csv", ".parquet")
#: effects that are nearly constant forces at ordinary speeds
STEADY = {
    "rolling_resistance",
    "rolling_resistance_temperature",
    "rolling_warmup",
    "brake_drag",
    "torque_offset",
    "headwind",
}


@dataclass(frozen=True)
class Trip:
    """One held-out trip: residual RMS in N and estimated mass in kg, without and with what was found.

    filtered_N: the residual after what may be an error of the reference's grade is filtered out.
    """

    name: str
    open_s: int
    residual_N: tuple[float, float]
    filtered_N: tuple[float, float]
    mass_kg: tuple[float, float]


def trips_in(folder: Path) -> list[Path]:
    """Return the tables of a folder by name."""
    return sorted(p for p in folder.iterdir() if any(s in SUFFIXES for s in p.suffixes))


def judge(path: Path, config_name: str, sides: tuple[list[Effect], list[Effect]]) -> Trip | None:
    """Run both models on a trip; None where the gates are hardly ever open."""
    config = load_config(config_name)
    drive = Drive.load(path, config)
    run = drive.run(sides[0])
    reference = reference_for(drive, run)
    try:
        problem = Problem([(drive, reference, run)])
    except Exception as error:
        print(f"{path.name}: {error}", file=sys.stderr)
        return None
    residuals, filtered, masses = [], [], []
    for effects in sides:
        # the mass is free on every trip and with either model, as it is for the estimator
        _, taken = fit_on(problem, effects, [], np.ones(problem.rows, np.bool_))
        left = problem.residual_N(effects) - taken
        residuals.append(float(np.sqrt((left**2).mean())))
        filtered.append(float(np.sqrt((problem.whiten(left) ** 2).mean())) * problem.unit_N)
        mass = drive.estimate(effects).mass_kg
        known = mass[np.isfinite(mass)]
        masses.append(float(known[-1]) if len(known) else float("nan"))
    pairs = [(before, after) for before, after in (residuals, filtered, masses)]
    return Trip(drive.name, problem.rows, *pairs)


def spread_pct(masses: list[float]) -> tuple[float, float]:
    """Return standard deviation and interquartile range, as per cent of the median."""
    median = statistics.median(masses)
    q1, _, q3 = statistics.quantiles(masses, n=4)
    return 100 * statistics.stdev(masses) / median, 100 * (q3 - q1) / median


def pooled_rows(trips: list[Trip], field: str, label: str) -> list[str]:
    """Return table rows: RMS over all seconds, its change with a 95 % interval (whole trips drawn anew)."""
    weight = np.array([t.open_s for t in trips], float)
    square = np.array([getattr(t, field) for t in trips]) ** 2 * weight[:, None]
    before, after = np.sqrt(square.sum(axis=0) / weight.sum())
    draws = np.random.default_rng(0).integers(0, len(trips), (2000, len(trips)))
    sums = square[draws].sum(axis=1)
    low, high = 100 * (np.percentile(np.sqrt(sums[:, 1] / sums[:, 0]), [2.5, 97.5]) - 1)
    fell = int((square[:, 1] < square[:, 0]).sum())
    change = 100 * (after / before - 1)
    return [
        f"| {label} | {before:.1f} N | {after:.1f} N |",
        f"| its change, 95 % interval | | {change:+.1f} % [{low:+.1f} … {high:+.1f} %] |",
        f"| trips in which it fell | | {fell} of {len(trips)} |",
    ]


def draw(trips: list[Trip], path: Path) -> None:
    """Draw residual and mass of every held-out trip, before and after."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    plt.rcParams["svg.hashsalt"] = "canest"
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for axis, field, label in (
        (axes[0], "residual_N", "residual RMS, N"),
        (axes[1], "mass_kg", "estimated mass, kg"),
    ):
        for i, trip in enumerate(trips):
            before, after = getattr(trip, field)
            axis.plot([i, i], [before, after], color="#cbd5e1", lw=1.5, zorder=1)
        for side, (name, colour) in enumerate((("before", "#d97706"), ("after", "#1d4ed8"))):
            values = [getattr(t, field)[side] for t in trips]
            axis.scatter(range(len(trips)), values, color=colour, s=22, label=name, zorder=2)
        axis.set_ylabel(label)
        axis.set_xticks(range(len(trips)), [t.name for t in trips], rotation=90, fontsize=7)
        axis.grid(axis="y", color="#e6eaf0")
    axes[0].legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})


def page(d: Diagnosis, found: list[Entry], trips: list[Trip], figure: str, used: int, wall_s: float) -> str:
    """Return the page in Markdown."""
    masses = [[t.mass_kg[side] for t in trips] for side in (0, 1)]
    (std_b, iqr_b), (std_a, iqr_a) = spread_pct(masses[0]), spread_pct(masses[1])
    median = [statistics.median(m) for m in masses]
    lines = [
        "# An electric car, measured",
        "",
        'Trips of a BMW i3 as tables of decoded signals at 10 Hz (origin: "Battery and Heating Data in Real',
        'Driving Cycles", TU Munich; the data is not part of this project). Ratio, radius and efficiency of',
        "the config are assumed, the passengers unknown, the friction brake is not measured. There is no",
        f"truth: the reference is {d.references[0].text}; the mass is free",
        "on every trip.",
        "",
        "    python benchmarks/diagnose_bmw_i3.py DIR_WITH_TABLES -o docs/measured/bmw-i3.md",
        "",
        f"Every second trip by name was diagnosed ({used} trips, {d.problem.rows:,} s with open gates,",
        f"{wall_s:.0f} s of computing), the other {len(trips)} judged.",
        "",
        "## Found",
        "",
        f"**{d.finding}** Verdict: {d.verdict}.",
        "",
        reference_limits(d.references),
        "",
        "| effect | value ± std | removes | inseparable from |",
        "|---|---|---|---|",
    ]
    for e in found[:10]:
        name = f"**{entry_name(e)}**" if e.selected else entry_name(e)
        equivalent = ", ".join(e.equivalent) or "-"
        lines.append(f"| {name} | {entry_value(e)} | {100 * e.explained:.1f} % | {equivalent} |")
    lines += ["", "Bold: added to the model. On the diagnosed trips, whole trips held out:", "",
              "| | before | after |", "|---|---|---|"]  # fmt: skip
    for label, key, b, a in score_rows(d):
        lines.append(f"| {label} | {b} {interval(d.before, key)} | {a} {interval(d.after, key)} |")
    lines += [
        "",
        f"## On the {len(trips)} trips that took no part",
        "",
        "Nothing is fitted here but the mass of each trip, which is free with either model. The second",
        "residual leaves out what may be an error of the reference's grade. Temperature joined the effects",
        "that are tried after earlier versions had been judged on these same trips, which showed summer and",
        "winter apart: its coefficient is fitted without them, the idea is not, so the intervals flatter it.",
        "",
        "| | before | after |",
        "|---|---|---|",
        *pooled_rows(trips, "residual_N", "residual RMS"),
        *pooled_rows(trips, "filtered_N", "residual RMS, grade errors filtered out"),
        f"| estimated mass, median | {median[0]:.0f} kg | {median[1]:.0f} kg |",
        f"| its spread over trips, standard deviation | {std_b:.2f} % | {std_a:.2f} % |",
        f"| its spread over trips, interquartile range | {iqr_b:.2f} % | {iqr_a:.2f} % |",
        "",
        f"![Residual and mass of the held-out trips]({figure})",
        "",
        spread_formatted(std_b, std_a, iqr_b, iqr_a, len(trips)),
        *steady_formatted(d),
        "",
    ]
    return "\n".join(lines)


def spread_formatted(std_b: float, std_a: float, iqr_b: float, iqr_a: float, n: int) -> str:
    """Describe what the spread of the mass does, and what it can be."""
    # the standard deviation of a standard deviation from n normal values
    std_std = std_b / np.sqrt(2 * (n - 1))
    if (std_a, iqr_a) == (std_b, iqr_b):
        text = "Nothing was added, so the spread of the estimated mass is what it was"
    elif std_a < std_b and iqr_a <= iqr_b:
        text = f"The spread of the estimated mass falls from {std_b:.2f} to {std_a:.2f} %"
    elif std_a >= std_b and iqr_a >= iqr_b:
        text = f"The spread of the estimated mass does not fall ({std_b:.2f} to {std_a:.2f} %)"
    else:
        text = "Standard deviation and interquartile range of the estimated mass do not agree on a change"
    return (
        f"{text}. From {n} trips a standard deviation is known to ± {std_std:.2f} points. Part of the\n"
        "spread is real: passengers and luggage are mass, one person is 5 % of this car, and nothing in the\n"
        "tables has who was on board."
    )


def steady_formatted(d: Diagnosis) -> list[str]:
    """Describe why the mass may not move."""
    added = {c.candidate.effect for c in d.search.chosen}
    if not added or not added <= STEADY:
        return []
    return [
        "",
        "What was added is a force that hardly changes within a trip. A steady force that is missing looks",
        "like a slope to the estimator, so that adding it corrects the grade; the mass comes from what",
        "changes, and stays.",
    ]


def main() -> None:
    """Diagnose, judge, write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("-c", "--config", default="bmw-i3")
    options = parser.parse_args()
    paths = trips_in(options.folder)
    if len(paths) < 4:
        sys.exit(f"{options.folder}: found {len(paths)} tables, expected some trips")
    config = load_config(options.config)
    jit.enable()
    begin = time.monotonic()
    d = diagnose(
        paths[0::2], config, progress=lambda text, share: print(f"{share:4.0%} {text}", file=sys.stderr)
    )
    wall_s = time.monotonic() - begin
    base = effects_of(config)
    sides = (base, effects_of(revised_config(d)))
    trips = [t for p in paths[1::2] if (t := judge(p, options.config, sides)) and t.open_s >= MIN_WINDOWS]
    options.output.parent.mkdir(parents=True, exist_ok=True)
    figure = options.output.with_suffix(".svg")
    draw(trips, figure)
    text = page(d, entries(d), trips, figure.name, len(d.problem.parts), wall_s)
    options.output.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
