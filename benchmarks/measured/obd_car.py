"""A diesel car over OBD-II: does it weigh the same in every file, and does the grade fit its altitude?

    python benchmarks/measured/obd_car.py FOLDER -o docs/measured/obd-car.md

FOLDER holds the recordings of logger 3BA199E2 (.MF4): examples/other/matlab-basics/LOG_datastore/3BA199E2
of https://github.com/CSS-Electronics/api-examples (MIT licence). Folders in it are searched. Recordings of
other cars are left out: what is asked for 28 values in turn, 0.14 Hz each, is shown as refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from altitude import GRADE_HEADER, Way, grade_against_altitude, rows_of_grades, way_of
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
    number,
    plt,
    run,
    share,
    spread_pct,
)

import canest
from canest.config import Config, load_config

LONG_S = 300.0
WINDOW_M = 200.0
LICENCE = (
    "Data: [CSS-Electronics/api-examples](https://github.com/CSS-Electronics/api-examples), MIT licence, "
    "(c) CSS Electronics. Changed: what is shown here was computed from it."
)
#: the same signals, each held until the next report
HELD = ("engine_torque_pct", "engine_speed", "vehicle_speed")


class Recording(NamedTuple):
    """One file. runs: variant -> method -> estimates."""

    name: str
    seconds: float
    way: Way
    runs: dict[str, dict[str, Estimates]]


class End(NamedTuple):
    """The mass that a file ends with: of its last valid sample, else of its last one."""

    mass_kg: float
    std_kg: float
    valid: float


def held(config: Config) -> Config:
    """Return the config whose slow signals are held, not joined."""
    signals = {
        role: s.model_copy(update={"period_s": None, "stale_s": 1.5}) if role in HELD else s
        for role, s in config.signals.items()
    }
    return config.model_copy(update={"signals": signals})


def without(config: Config, role: str) -> Config:
    """Return the config without a role."""
    return config.model_copy(update={"signals": {k: s for k, s in config.signals.items() if k != role}})


def read(path: Path, config: Config, names: list[str]) -> Recording | None:
    """Run all methods, and ours in variants; None where the first one gives no mass at all."""
    every = run(path, config, names, path.name)
    if not every[names[0]].known.any():
        return None
    ours = [name for name in OURS if name in names]
    runs = {
        "": every,
        "held": run(path, held(config), ours, f"{path.name}, held"),
        "no accelerometer": run(
            path, without(config, "longitudinal_accel"), ours, f"{path.name}, no accelerometer"
        ),
    }
    s = canest.read_signals(path, config)
    v = s.values
    way = way_of(s.t_s, v["vehicle_speed"], v["altitude"], v["latitude"], v["longitude"])
    return Recording(path.stem, float(s.t_s[-1] - s.t_s[0]), way, runs)


def end_of(e: Estimates) -> End:
    """Return the mass at the end of a file."""
    at = np.flatnonzero(e.known & e.valid)
    at = at if len(at) else np.flatnonzero(e.known)
    if not len(at):
        return End(np.nan, np.nan, 0.0)
    return End(float(e.mass_kg[at[-1]]), float(e.std_kg[at[-1]]), e.valid_share())


def write_masses(page: Page, recordings: list[Recording], names: list[str], config: Config) -> None:
    """Write the masses of every file, and how far they lie apart."""
    long = [r for r in recordings if r.seconds >= LONG_S]
    page.section("Does the car weigh the same?")
    page.text(
        "The mass at the end of each file (of its last valid sample where there is one) and its standard "
        "deviation, in kg, by `canest`. The guess of the reference torque is "
        f"{config.vehicle.torque_accuracy_pct / 2:g} % of each standard deviation, and the same in all files."
    )
    rows = []
    for r in recordings:
        end, minutes = end_of(r.runs[""][OURS[0]]), number(r.seconds / 60, 1)
        rows.append((r.name, minutes, number(end.mass_kg), number(end.std_kg), share(end.valid)))
    page.table(("file", "minutes", "mass", "std", "valid, of the driving"), rows)
    page.text(
        f"Spread of the {len(long)} files of five minutes and more: largest less smallest, of their mean."
    )
    table = []
    for variant, what in (("", ""), ("held", ", signals held"), ("no accelerometer", ", no accelerometer")):
        for name in names:
            if name in long[0].runs[variant]:
                masses = [end_of(r.runs[variant][name]).mass_kg for r in long]
                shown = (number(m) for m in masses)
                table.append((f"`{name}`{what}", number(spread_pct(masses), 1, " %"), *shown))
    page.table(
        ("method", "spread", *(r.name.split("-", 1)[0] + "-" + r.name.split("-")[1] for r in long)), table
    )


def draw(page: Page, recordings: list[Recording]) -> None:
    """Draw mass and grade of the longest files."""
    longest = sorted(recordings, key=lambda r: -r.seconds)[:4]
    figure, axes = plt.subplots(
        2, len(longest), figsize=(11, 4), layout="constrained", squeeze=False, sharey="row"
    )
    for (top, low), r in zip(axes.T, longest, strict=True):
        e = r.runs[""][OURS[0]]
        thin = slice(None, None, 50)
        minutes = (e.t_s - e.t_s[0])[thin] / 60
        mass, std = e.mass_kg[thin], e.std_kg[thin]
        top.fill_between(minutes, mass - 2 * std, mass + 2 * std, color=GREY, alpha=0.4, lw=0)
        top.plot(minutes, mass, color=BLUE, lw=1)
        top.set(ylim=(1000, 3000), title=r.name.rsplit("-", 1)[0], xlabel="minutes")
        way = r.way
        edges = np.searchsorted(way.metres, np.arange(way.metres[0], way.metres[-1], WINDOW_M))
        slope = np.diff(way.altitude_m[edges]) / np.diff(way.metres[edges])
        low.plot(way.metres[edges[:-1]] / 1000, 100 * slope, color=ORANGE, drawstyle="steps-post", lw=1)
        grade = np.interp(way.t_s, e.t_s, e.grade)
        low.plot(way.metres[::3] / 1000, 100 * grade[::3], color=BLUE, lw=0.8)
        low.set(ylim=(-8, 8), xlabel="km")
    axes[0, 0].set_ylabel("mass, kg (two std)")
    axes[1, 0].set_ylabel("grade, % (altitude: orange)")
    page.figure(figure, "files", "Mass and grade in four files")


def main() -> None:
    options = arguments(__doc__ or "", "recordings of an OBD-II logger")
    names = options.estimators
    config = load_config("obd-car")
    paths = files_in(options, lambda name: name.lower().endswith(".mf4"), "recordings, .MF4")
    found = {path: read(path, config, names) for path in paths}
    recordings = [r for r in found.values() if r is not None]
    page = Page(options.output, "A car over OBD-II, measured")
    page.text(
        "A diesel car whose engine was asked for torque, speed and road speed (whole km/h) twice a second. "
        "The logger has a satellite receiver (1 Hz) and inertial sensors (100 Hz, 0.125 m/s² steps). Nobody "
        "weighed it, and nobody wrote down its reference torque, brakes or pedals. It must weigh the same in "
        "all files."
    )
    page.text(LICENCE)
    made_by(page, options)
    write_masses(page, recordings, names, config)
    draw(page, recordings)
    page.section("Grade against altitude")
    page.text(
        f"Mean grade over windows of {WINDOW_M:.0f} m beside the slope of the receiver's altitude, in "
        "degrees. The altitude has an error of its own, which shows where the car comes by again (dashes: it "
        "does not)."
    )
    checks = {
        f"`{name}`": grade_against_altitude([(r.way, r.runs[""][name]) for r in recordings], WINDOW_M)
        for name in names
    }
    page.table(GRADE_HEADER, rows_of_grades(checks))
    refused = [path.name for path, r in found.items() if r is None]
    page.section("What failed")
    page.items([
        f"Refused, since signals come too seldom or are missing: {', '.join(refused) or 'none'}. "
        "`canest check` says which, and what a rate costs.",
        "Neither brake nor pedal is known, so nothing is learned without propulsion.",
    ])  # fmt: skip
    page.write()


if __name__ == "__main__":
    main()
