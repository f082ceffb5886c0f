"""A trolleybus in Zurich: masses against counted passengers, grade against altitude.

    python benchmarks/measured/ztbus.py FOLDER -o docs/measured/ztbus.md

FOLDER holds missions of ZTBus as they are published (B183_....csv, also compressed), of one bus or both:
https://doi.org/10.3929/ethz-b-000626723 (ETH Research Collection; ZTBus_samples.zip has ten missions,
ZTBus_compressed.zip all 1,409). Nothing has to be converted: configs/ztbus.yaml names the published columns.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from altitude import (
    GRADE_HEADER,
    REVISIT_HEADER,
    Way,
    check_revisits,
    grade_against_altitude,
    rows_of_grades,
    rows_of_revisits,
    way_of,
)
from common import (
    BLUE,
    GREY,
    ORANGE,
    Column,
    Estimates,
    Line,
    Page,
    arguments,
    files_in,
    line_through,
    made_by,
    number,
    plt,
    run,
    share,
)

from canest.config import Config, load_config

NAME = re.compile(r"B\d{3}_.*\.csv")
WINDOW_M = 200.0
#: slower, the height hardly changes, whatever a receiver shows
CREEP_MPS = 2.0
ATTRIBUTION = (
    'Data: "ZTBus: A Large Dataset of Time-Resolved City Bus Driving Missions", Fabio Widmer, Andreas Ritter '
    "and Christopher H. Onder, ETH Zurich, 2023, "
    "[doi:10.3929/ethz-b-000626723](https://doi.org/10.3929/ethz-b-000626723), "
    "described in Scientific Data 10, 687, [doi:10.1038/s41597-023-02600-6]"
    "(https://doi.org/10.1038/s41597-023-02600-6). Licence: "
    "[CC BY 4.0](https://creativecommons.org/licenses/by/4.0/). "
    "Changed: what is shown here was computed from it."
)


class Mission(NamedTuple):
    """One file. passengers: at `t_s`, NaN from a door's opening until the next count (n,)."""

    name: str
    t_s: Column
    passengers: Column
    rides: list[tuple[float, float, float]]  #: from, to, passengers: from a count to the next open door
    way: Way
    estimates: dict[str, Estimates]


class Fit(NamedTuple):
    """Masses of one method against passengers: of valid samples and of rides."""

    valid: float
    samples: Line
    in_two_std: float
    rides: Line
    rides_in_two_std: float
    all_rides: Line


def read_mission(path: Path, config: Config, names: list[str]) -> Mission:
    """Read what no estimator sees, and run them all."""
    table = pd.read_csv(path)
    t_s = table["time_unix"].to_numpy(float)
    counted = table["itcs_numberOfPassengers"].to_numpy(float)
    open_door = table["status_doorIsOpen"].fillna(0).to_numpy(float) > 0
    passengers = np.full(len(t_s), np.nan)
    rides = []
    counts = np.flatnonzero(np.isfinite(counted))
    for at, following in zip(counts, [*counts[1:], len(t_s)], strict=True):
        opened = np.flatnonzero(open_door[at:following])
        end = at + int(opened[0]) if len(opened) else following
        passengers[at:end] = counted[at]
        if end > at:
            rides.append((t_s[at], t_s[end - 1], float(counted[at])))
    way = way_of(
        t_s,
        table["odometry_vehicleSpeed"].to_numpy(float),
        table["gnss_altitude"].to_numpy(float),
        np.degrees(table["gnss_latitude"].to_numpy(float)),
        np.degrees(table["gnss_longitude"].to_numpy(float)),
    )
    return Mission(path.name.split(".")[0], t_s, passengers, rides, way, run(path, config, names, path.name))


def samples_of(mission: Mission, e: Estimates) -> tuple[Column, Column, Column]:
    """Return passengers, mass and std of one valid sample a second in motion."""
    at = np.searchsorted(mission.t_s, e.t_s, side="right") - 1
    count = mission.passengers[np.maximum(at, 0)]
    wanted = e.valid & e.moving & np.isfinite(count)
    wanted &= np.round(e.t_s * 50).astype(np.int64) % 50 == 0
    return count[wanted], e.mass_kg[wanted], e.std_kg[wanted]


def rides_of(mission: Mission, e: Estimates, valid: bool) -> Column:
    """Return passengers, mass and std at each ride's end, (rides, 3). valid: of its last valid sample."""
    wanted = e.known & e.valid if valid else e.known
    rows = []
    for begin, end, count in mission.rides:
        a, b = np.searchsorted(e.t_s, [begin, end])
        found = np.flatnonzero(wanted[a:b])
        if len(found):
            rows.append((count, e.mass_kg[a + found[-1]], e.std_kg[a + found[-1]]))
    return np.array(rows, float).reshape(-1, 3)


def within(line: Line, x: Column, y: Column, std: Column) -> float:
    return float(np.mean(np.abs(y - line.at(x)) < 2 * std)) if len(x) else np.nan


def fit(missions: list[Mission], name: str) -> Fit:
    """Fit one line through the masses of all missions."""
    runs = [(m, m.estimates[name]) for m in missions]
    x, y, std = (np.concatenate(c) for c in zip(*(samples_of(m, e) for m, e in runs), strict=True))
    rides = np.concatenate([rides_of(m, e, True) for m, e in runs])
    every = np.concatenate([rides_of(m, e, False) for m, e in runs])
    line, of_rides = line_through(x, y), line_through(*rides[:, :2].T)
    moving = sum(int(e.moving.sum()) for _, e in runs)
    valid = sum(int((e.valid & e.moving).sum()) for _, e in runs) / max(moving, 1)
    return Fit(
        valid, line, within(line, x, y, std), of_rides, within(of_rides, *rides.T),
        line_through(*every[:, :2].T),
    )  # fmt: skip


def altitude_gained(missions: list[Mission]) -> tuple[float, float]:
    """Return by how much the receiver's altitude rises in all while a bus creeps or stands, and drives, m."""
    standing, driving = 0.0, 0.0
    for m in missions:
        rise_m, speed_mps = np.diff(m.way.altitude_m), np.diff(m.way.metres)  # a row a second
        slow = speed_mps < CREEP_MPS
        standing += float(np.nansum(rise_m[slow]))
        driving += float(np.nansum(rise_m[~slow]))
    return standing, driving


def draw_masses(page: Page, missions: list[Mission], ours: Fit) -> None:
    """Draw masses over passengers, and the longest mission over time."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained", width_ratios=(1, 1.8))
    rides = np.concatenate([rides_of(m, m.estimates["canest"], True) for m in missions])
    x, y, std = rides.T
    left.errorbar(x, y / 1000, 2 * std / 1000, fmt="o", ms=3, lw=0.6, color=BLUE, ecolor=GREY)
    ends = np.array([x.min(), x.max()]) if len(x) else np.array([0.0, 1.0])
    left.plot(
        ends, ours.rides.at(ends) / 1000, color=ORANGE, label=f"{ours.rides.slope:.0f} kg per passenger"
    )
    left.set(xlabel="passengers counted", ylabel="mass, t (bars: two std)")
    left.legend(frameon=False)
    mission = max(missions, key=lambda m: len(m.t_s))
    e = mission.estimates["canest"]
    begin = e.t_s[0]
    for a, b, count in mission.rides:
        right.plot(np.array([a, b]) / 60 - begin / 60, [ours.rides.at(count) / 1000] * 2, color=ORANGE, lw=2)
    shown = slice(None, None, 250)
    mass = np.where(e.valid & e.moving, e.mass_kg, np.nan)[shown] / 1000
    right.plot((e.t_s[shown] - begin) / 60, mass, ".", ms=2, color=BLUE)
    right.set(xlabel=f"minutes of {mission.name}", ylabel="valid mass, t", ylim=(18.5, 25))
    right.plot([], [], color=ORANGE, lw=2, label="line at the counted passengers")
    right.legend(frameon=False)
    page.figure(figure, "mass", "Valid masses against counted passengers, and over one mission")


def draw_grade(page: Page, mission: Mission) -> None:
    """Draw the grade of half an hour beside the altitude's slope."""
    e, way = mission.estimates["canest"], mission.way
    some = way.t_s < way.t_s[0] + 5400
    figure, axis = plt.subplots(figsize=(10, 2.6), layout="constrained")
    metres = way.metres[some]
    edges = np.searchsorted(metres, np.arange(metres[0], metres[-1], WINDOW_M))
    slope = np.diff(way.altitude_m[edges]) / np.diff(metres[edges])
    axis.plot(metres[edges[:-1]] / 1000, 100 * slope, color=ORANGE, drawstyle="steps-post", lw=1,
              label="altitude over 200 m")  # fmt: skip
    grade = np.interp(way.t_s[some], e.t_s, e.grade)
    axis.plot(metres[::5] / 1000, 100 * grade[::5], color=BLUE, lw=0.7, label="estimated")
    axis.set(xlabel=f"km of {mission.name}", ylabel="grade, %", ylim=(-12, 12))
    axis.legend(frameon=False, ncols=2)
    page.figure(figure, "grade", "Estimated grade and the altitude's slope over the first ninety minutes")


def write(page: Page, missions: list[Mission], options: argparse.Namespace) -> None:
    """Write the page."""
    names = options.estimators
    fits = {name: fit(missions, name) for name in names}
    hours = sum(m.t_s[-1] - m.t_s[0] for m in missions) / 3600
    km = sum(m.way.metres[-1] for m in missions) / 1000
    page.text(
        "A trolleybus of 19 t that carries up to 160 passengers. Force of the drives and speed come once a "
        "second. Passengers are counted at stops by infrared sensors. Nobody weighed the bus: a count is "
        "relative truth."
    )
    page.text(ATTRIBUTION)
    made_by(page, options)
    rides = sum(len(m.rides) for m in missions)
    listed = ", ".join(m.name for m in missions)
    page.text(
        f"Missions: {listed}. {hours:.1f} h, {km:.0f} km, {rides} rides from one open door to the next."
    )
    page.section("Mass against passengers")
    page.text(
        "A *ride* has the mass of its last valid sample. *In 2 std*: share of the masses within two of their "
        "own standard deviations of the best line. Samples are one a second."
    )
    page.table(
        ("method", "valid, of the driving", "samples: correlation", "kg per passenger", "empty, t",
         "in 2 std", "rides", "correlation", "kg per passenger", "in 2 std", "scatter, kg"),
        [
            (f"`{name}`", share(f.valid), number(f.samples.correlation, 2), number(f.samples.slope),
             number(f.samples.intercept / 1000, 1), share(f.in_two_std), str(f.rides.points),
             number(f.rides.correlation, 2), number(f.rides.slope), share(f.rides_in_two_std),
             number(f.rides.scatter))
            for name, f in fits.items()
        ],
    )  # fmt: skip
    draw_masses(page, missions, fits["canest"])
    page.text("The same at the end of every ride, valid or not:")
    page.table(
        ("method", "rides", "correlation", "kg per passenger", "scatter, kg"),
        [
            (f"`{name}`", str(f.all_rides.points), number(f.all_rides.correlation, 2),
             number(f.all_rides.slope), number(f.all_rides.scatter))
            for name, f in fits.items()
        ],
    )  # fmt: skip
    page.section("Grade against altitude")
    page.text(
        f"Mean grade over windows of {WINDOW_M:.0f} m beside the slope of the receiver's altitude, in "
        "degrees. A satellite receiver wanders by metres in a minute. Where the bus comes by again, in "
        "either direction, two passes see one road and two errors of the altitude. *Left* is what remains "
        "there without them. An error that belongs to the place, as beside high houses, stays in it. The "
        "last column is the same scatter of the estimate: it needs no altitude."
    )
    standing_m, driving_m = altitude_gained(missions)
    page.text(
        f"The receiver's altitude changes by {standing_m:+.0f} m in all while the bus stands or creeps, and "
        f"by {driving_m:+.0f} m while it drives. A bus that stands keeps its height: the error of the "
        "altitude depends on the motion. So the altitude is no input of any method here, and its slope while "
        "driving has an error of the mean besides the scatter."
    )
    ways = {f"`{name}`": [(m.way, m.estimates[name]) for m in missions] for name in names}
    checks = {name: grade_against_altitude(runs, WINDOW_M) for name, runs in ways.items()}
    page.table(GRADE_HEADER, rows_of_grades(checks))
    page.text(
        "The same from all passes. An estimate less the altitude of one pass, times the same with another "
        "pass, holds the estimate's error squared, and of the altitude's only what both passes share. Each "
        "window has five passes on average, so this is less uncertain than its own pass alone. The interval "
        "draws whole places of 500 m anew. Passes in one direction share more of the altitude's error than "
        "passes in both, on either side of the street: what the first leave and the second do not is the "
        "altitude's. An error of force (resistance, torque, brakes) has the same sign both ways, and the "
        "road's grade has not. So it shows in the scatter of the estimate between both directions."
    )
    revisits = {name: check_revisits(runs, WINDOW_M) for name, runs in ways.items()}
    page.table(REVISIT_HEADER, rows_of_revisits(revisits))
    draw_grade(page, max(missions, key=lambda m: len(m.t_s)))
    page.section("What this cannot show")
    page.items([
        "Counts are made at stops, by sensors that miss some people. Their error is in every scatter here.",
        "A passenger has 70 to 75 kg in the mean, but 20 passengers may have 1.2 or 1.7 t.",
        "The facts of the bus in `configs/ztbus.yaml` are assumed but for its kerb mass. A wrong efficiency "
        "scales all masses alike, and moves neither correlation nor share.",
    ])  # fmt: skip


def main() -> None:
    options = arguments(__doc__ or "", "missions of ZTBus")
    paths = files_in(options, lambda name: bool(NAME.match(name)), "missions of ZTBus, B183_....csv")
    config = load_config("ztbus")
    missions = [read_mission(path, config, options.estimators) for path in paths]
    page = Page(options.output, "A trolleybus, measured")
    write(page, missions, options)
    page.write()


if __name__ == "__main__":
    main()
