"""Trips of an electric car, summer and winter: first valid mass against the last, what the model lacks.

    python benchmarks/measured/bmw_i3.py FOLDER -o docs/measured/bmw-i3.md

FOLDER holds the trips as published (TripA01.csv ... TripB38.csv) or as tables with the columns that
configs/bmw-i3.yaml names (A01.csv ..., also compressed or .parquet); A: summer, B: winter. They are
published as "Battery and Heating Data in Real Driving Cycles" (TU Munich):
https://ieee-dataport.org/open-access/battery-and-heating-data-real-driving-cycles
No licence is stated with them, so that no part of them is in this project.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from bmw_i3_diagnosis import write_diagnosis
from common import (
    BLUE,
    GREY,
    ORANGE,
    OURS,
    Estimates,
    Page,
    arguments,
    files_in,
    made_by,
    middle_half_pct,
    number,
    plt,
    run,
    share,
)

from canest.config import Config, load_config

NAME = re.compile(r"(?:Trip)?([AB]\d\d)\b")
#: column of configs/bmw-i3.yaml -> how its published name begins
PUBLISHED = {
    "t_s": "Time",
    "v_kmh": "Velocity",
    "elev_m": "Elevation",
    "throttle_pct": "Throttle",
    "motor_Nm": "Motor Torque",
    "ax_mps2": "Longitudinal Acceleration",
    "ambient_C": "Ambient Temperature",
}
SEASONS = {"A": "summer", "B": "winter", "AB": "both"}
SENSED, UNSENSED = "with", "without"


class First(NamedTuple):
    """The first valid mass of a trip and the last, kg; NaN where none was valid."""

    first_kg: float
    first_std_kg: float
    last_kg: float
    last_std_kg: float
    after_s: float
    valid: float

    @property
    def z(self) -> float:
        return (self.first_kg - self.last_kg) / self.first_std_kg

    @property
    def miss_pct(self) -> float:
        return 100 * (self.first_kg / self.last_kg - 1)


def read_trip(path: Path) -> pd.DataFrame:
    """Return a trip with the columns that the config names, from a published file or a table."""
    if ".parquet" in path.suffixes:
        return pd.read_parquet(path)
    table = pd.read_csv(path, sep=None, engine="python", encoding="latin-1")
    if "motor_Nm" in table:
        return table
    columns = {}
    for name, begins in PUBLISHED.items():
        found = [column for column in table if str(column).strip().startswith(begins)]
        if found:
            columns[name] = table[found[0]]
    return pd.DataFrame(columns)


def first_and_last(e: Estimates) -> First:
    """Return what was valid first, and what the trip ended with."""
    at = np.flatnonzero(e.valid & np.isfinite(e.mass_kg))
    if not len(at):
        return First(*[np.nan] * 5, 0.0)
    a, b = at[0], at[-1]
    return First(e.mass_kg[a], e.std_kg[a], e.mass_kg[b], e.std_kg[b], e.t_s[a] - e.t_s[0], e.valid_share())


def final_mass(e: Estimates) -> float:
    """Return the mass of the last valid sample, else of the last one, kg."""
    at = np.flatnonzero(e.known & e.valid)
    at = at if len(at) else np.flatnonzero(e.known)
    return float(e.mass_kg[at[-1]]) if len(at) else np.nan


def without_accelerometer(config: Config) -> Config:
    signals = {role: s for role, s in config.signals.items() if role != "longitudinal_accel"}
    return config.model_copy(update={"signals": signals})


def summary_rows(trips: dict[str, dict[str, dict[str, Estimates]]]) -> list[tuple[str, ...]]:
    """Return a row for each of our methods, with and without the sensor, summer and winter."""
    rows = []
    for method in OURS:
        for sensor in (SENSED, UNSENSED):
            for letters, season in SEASONS.items():
                found = [
                    first_and_last(runs[sensor][method])
                    for name, runs in trips.items()
                    if name[0] in letters and method in runs[sensor]
                ]
                known = [f for f in found if np.isfinite(f.z)]
                if not known:
                    continue
                inside = sum(abs(f.z) < 2 for f in known)
                rows.append((
                    f"`{method}`", sensor, season, f"{len(known)} of {len(found)}",
                    f"{inside} of {len(known)} ({share(inside / len(known))})",
                    number(float(np.mean([f.miss_pct for f in known])), 1, " %"),
                    number(max((f.miss_pct for f in known), key=abs), 1, " %"),
                    number(float(np.median([f.after_s for f in known])), 0, " s"),
                    number(middle_half_pct(f.last_kg for f in known), 1, " %"),
                ))  # fmt: skip
    return rows


def draw(page: Page, trips: dict[str, dict[str, dict[str, Estimates]]]) -> None:
    """Draw first and last valid mass of every trip."""
    figure, axes = plt.subplots(2, 1, figsize=(9, 4.6), layout="constrained", sharex=True, sharey=True)
    for axis, sensor in zip(axes, (SENSED, UNSENSED), strict=True):
        for i, runs in enumerate(trips.values()):
            f = first_and_last(runs[sensor][OURS[0]])
            axis.errorbar(i, f.first_kg, 2 * f.first_std_kg, fmt="o", ms=4, color=ORANGE, ecolor=GREY)
            axis.plot(i, f.last_kg, "_", ms=10, mew=2, color=BLUE)
        axis.set_ylabel(f"kg, {sensor} sensor")
    axes[1].set_xticks(range(len(trips)), list(trips), rotation=90)
    axes[0].plot([], [], "o", color=ORANGE, label="first valid mass, two std")
    axes[0].plot([], [], "_", mew=2, color=BLUE, label="last valid mass")
    axes[0].legend(frameon=False, ncols=2)
    page.figure(figure, "first", "First and last valid mass of every trip, with and without accelerometer")


def write_masses(page: Page, trips: dict[str, dict[str, dict[str, Estimates]]], names: list[str]) -> None:
    """Write first against last mass, every trip, and all methods side by side."""
    page.section("The first valid mass against the last")
    page.text(
        "A trip's last valid mass is the best that is known of it. The first one is right if it lies within "
        "two of its own standard deviations. *Middle half*: width of the middle half of the last masses, of "
        "their median; one person is 5 % of this car."
    )
    page.table(
        ("method", "accelerometer", "trips in", "with a valid mass", "first within two std of the last",
         "first less last, mean", "worst", "first valid after (median)", "middle half"),
        summary_rows(trips),
    )  # fmt: skip
    draw(page, trips)
    page.text("Every trip, `canest`, masses in kg:")
    rows = []
    for name, runs in trips.items():
        cells = [name]
        for sensor in (SENSED, UNSENSED):
            f = first_and_last(runs[sensor][OURS[0]])
            cells += [f"{number(f.first_kg)} ± {number(f.first_std_kg)}", number(f.last_kg), number(f.z, 1)]
        rows.append(cells)
    page.table(("trip", *("first, with", "last", "z"), *("first, without", "last", "z")), rows)
    page.section("Beside the papers' methods")
    page.text(
        "Masses at the end of the trips, all of one car. The papers' methods do not use the accelerometer."
    )
    table = []
    for name in names:
        masses = [final_mass(runs[UNSENSED][name]) for runs in trips.values()]
        known = [m for m in masses if np.isfinite(m)]
        if len(known) > 3:
            low, high = min(known), max(known)
            table.append((f"`{name}`", f"{len(known)}", number(float(np.median(known))),
                          number(middle_half_pct(known), 1, " %"),
                          f"{number(low)} to {number(high)}"))  # fmt: skip
    page.table(("method, no accelerometer", "trips", "median, kg", "middle half", "all, kg"), table)


def main() -> None:
    options = arguments(__doc__ or "", "trips of the car")
    config = load_config("bmw-i3")
    paths = {
        m.group(1): p
        for p in files_in(options, lambda name: bool(NAME.match(name)), "trips, TripA01.csv or A01.csv")
        if (m := NAME.match(p.name))
    }
    tables = {name: read_trip(path) for name, path in paths.items()}
    names, bare = options.estimators, without_accelerometer(config)
    ours = [name for name in OURS if name in names]
    trips = {
        name: {SENSED: run(table, config, ours, name), UNSENSED: run(table, bare, names, name)}
        for name, table in tables.items()
    }
    page = Page(options.output, "An electric car, measured")
    page.text(
        "Trips of a BMW i3 as decoded signals at 10 Hz (origin: "
        '"Battery and Heating Data in Real Driving Cycles", '
        "TU Munich, [published at IEEE DataPort](https://ieee-dataport.org/open-access/"
        "battery-and-heating-data-real-driving-cycles); no part of them is in this project). Ratio, radius "
        "and efficiency of the config are assumed, passengers are unknown, and the friction brake is not "
        "measured."
    )
    made_by(page, options)
    page.text(f"{len(trips)} trips: {', '.join(trips)}.")
    write_masses(page, trips, names)
    write_diagnosis(page, tables, config)
    page.write()


if __name__ == "__main__":
    main()
