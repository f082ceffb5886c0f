"""Kidambi et al. (2014): Figures 4 to 7, 9, Table 1, 11 to 13."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from data import Drive, errors, estimate, recorded, simulated
from page import Page, axes, plt

from canest.estimators.registry import create

TRUE_KG, SETTLED_S = 2_309.0, 25.0
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "RLS 0.995/0.95": ("rlsmf", {"preset": "2014", "start": "given"}),
    "EKF": ("ekf", {"preset": "2014"}),
}
OURS: dict[str, tuple[str, dict[str, Any]]] = {
    "RLSMF, default": ("rlsmf", {"start": "given"}),
    "EKF, default": ("ekf", {}),
}


def write(page: Page, drives: Path | None) -> None:
    page.section("Kidambi et al. (2014): RLS, EKF, grade observer, PMG")
    page.text(
        "A simulated 2,309 kg car with half-shaft torques, undriven-wheel speed and accelerometer; the "
        "samples are at 50 Hz (the paper's at 30 Hz; the EKF's noise variances are converted)."
    )
    _launches(page, drives)
    _selection(page)
    _hill(page)


def launches(drive: Drive, seconds: float) -> list[Drive]:
    """Return the parts of a drive that start at rest and run for some seconds."""
    moving = drive.plain.raw_speed_mps > 0.5
    starts = np.flatnonzero(moving[1:] & ~moving[:-1]) + 1
    length = round(seconds * 50)
    found, last = [], -length
    for begin in starts.tolist():
        if begin - last >= length and begin + length <= len(moving):
            speed = drive.plain.raw_speed_mps[begin : begin + length]
            if speed.max() > 8.0 and speed[100:].min() > 2.0:
                found.append(drive.part(begin, begin + length))
                last = begin
    return found


def _launches(page: Page, drives: Path | None) -> None:
    page.section("Figures 4 to 7: ten launches from rest, right and wrong starts", 3)
    sets = [("car", TRUE_KG, simulated("launches-car", changes={"duration_s": 700}))]
    if drives is not None:
        truck = recorded(drives, "launches-flat")
        if truck is not None:
            sets.append(("recorded truck", float(truck.mass_kg[0]), truck))
    for tag, true_kg, drive in sets:
        parts = launches(drive, SETTLED_S + 3.0)[:10]
        rows: list[list[Any]] = []
        if tag == "car":
            rows += [
                ["paper, right start, RLS and EKF", None, "-1.5 … 1.5", "0.2 … 0.6"],
                ["paper, -22 % and -3.5 %, RLS and EKF", None, "-5 … 13 (2,200 … 2,600 kg)", "not stated"],
            ]
        for start, mass, grade in (("right start", 1.0, 0.0), ("-22 % and -3.5 %", 0.78, -0.035)):
            figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6))
            for label, (name, options) in {**METHODS, **OURS}.items():
                masses, grades = [], []
                for part in parts:
                    found = estimate(part, name, options, initial_mass_kg=mass * true_kg, initial_grade=grade)
                    masses.append(100 * (found.mass_kg[round(SETTLED_S * 50)] / true_kg - 1))
                    grades.append(100 * found.grade[round(SETTLED_S * 50)])
                    if label == "EKF":
                        left.plot(part.t_s, 100 * (found.mass_kg / true_kg - 1), "C1", lw=0.7)
                    if label.startswith("RLS "):
                        left.plot(part.t_s, 100 * (found.mass_kg / true_kg - 1), "C0", lw=0.7)
                right.plot(masses, grades, "o", label=label, ms=4)
                rows.append(
                    [f"{tag}, {start}, {label}", float(np.sqrt(np.mean(np.square(masses)))),
                     f"{min(masses):.1f} … {max(masses):.1f}", f"{min(grades):.2f} … {max(grades):.2f}"]
                )  # fmt: skip
            left.set(
                xlabel="time, s", ylabel="mass error, %", title="RLS (blue), EKF (orange), paper's tunings"
            )
            right.set(xlabel="mass error at 25 s, %", ylabel="grade at 25 s, %")
            right.legend(fontsize=7)
            kind = "4-5" if mass == 1.0 else "6-7"
            page.figure(
                figure, f"2014-figure-{kind}-{tag.replace(' ', '-')}",
                f"Figures {kind.replace('-', ' and ')}, {tag}: {len(parts)} launches, {start}",
            )  # fmt: skip
        page.table(["after 25 s", "mass RMS, %", "mass errors, %", "grades, % (truth 0)"], rows)
    page.why(
        "Same finding: from the right start both stay within a few percent, from a wrong one both settle "
        "where the first seconds left them. The scatter is not the paper's number for number: the car, its "
        "torque sensors and its launches are others. The paper gives no initial P for the EKF; here it is "
        "the one that it gives for RLS. What the first seconds do depends on it: with P ten times larger "
        "the settled errors change sign."
    )


def _selection(page: Page) -> None:
    page.section("Figure 9 and Table 1: mass selection by concurrent filters", 3)
    drive = simulated("launches-car")
    paper = {
        (-55, 5.0): 177, (55, 5.0): 184, (-22, 3.5): 177, (22, 3.5): 131, (-22, -3.5): 131, (22, -3.5): 131,
    }  # fmt: skip
    wide = {"mass_min_kg": 800.0, "mass_max_kg": 6_000.0}
    rows = []
    for (mass, grade), seconds in paper.items():
        start = {"initial_mass_kg": TRUE_KG * (1 + mass / 100), "initial_grade": grade / 100, **wide}
        row: list[Any] = [f"({mass:+d} %, {grade:+.1f} %)", seconds]
        for options in ({"preset": "2014"}, {}):
            when, value = _first_agreement(drive, options, start)
            row += [when, None if value is None else 100 * (value / TRUE_KG - 1)]
        rows.append(row)
    page.table(
        [
            "initial guess", "paper: time to c_v < 0.01, s", "paper's tuning here, s", "its mass error, %",
            "default, s", "its mass error, %",
        ],
        rows,
    )  # fmt: skip
    start = {"initial_mass_kg": TRUE_KG * 1.55, "initial_grade": -0.05, **wide}
    figure, (top, middle, bottom) = axes(3, height=1.9)
    for label, options in (("paper's tuning", {"preset": "2014"}), ("default", {})):
        found = estimate(drive, "ekf-select", options, **start)
        top.plot(drive.t_s, found.mass_kg, label=label, lw=1)
        middle.plot(drive.t_s, 100 * found.grade, lw=1)
    top.axhline(TRUE_KG, color="k", ls="--", lw=1)
    middle.axhline(0, color="k", ls="--", lw=1)
    bottom.plot(drive.t_s, drive.plain.speed_mps, lw=1)
    top.set_ylabel("mass, kg")
    middle.set_ylabel("grade, %")
    bottom.set_ylabel("speed, m/s")
    top.legend(fontsize=8)
    page.figure(figure, "2014-figure-9", "Figure 9 in kind: +55 % and -5 % at the start")
    page.why(
        "Filters that were started from each other agree trivially until excitation has moved them "
        "apart. The paper's condition is met as soon as five filters run, on a drive that excites from "
        "the first second. The mass they agree on is the one the first launch left. On its own drive the "
        "filters disagreed until hard accelerations at 131 and 177 s. By default agreement counts here only "
        "after each filter has narrowed 1/m itself, which the paper does not require."
    )


def _first_agreement(drive: Drive, options: dict[str, Any], start: dict[str, Any]) -> tuple[Any, Any]:
    from dataclasses import replace

    method: Any = create("ekf-select", replace(drive.facts, **start), options)
    for k in range(0, len(drive.excited), 50):
        method.update(drive.excited[k : k + 50])
        if method._selected is not None and k > 50:
            return k / 50.0, 1.0 / method._selected[0]
    return None, None


def _hill(page: Page) -> None:
    page.section("Figures 11 to 13: from level ground onto a hill of 11.8 %", 3)
    drive = simulated("hill-11.8-percent")
    methods = {
        **METHODS,
        "DGO": ("dgo", {}),
        "PMG": ("pmg", {}),
        **OURS,
    }
    rows = []
    for number, (label, mass, grade) in enumerate(
        (("right", 1.0, 0.0), ("-22 % and 3.5 %", 0.78, 0.035), ("+72 % and 3.5 %", 1.72, 0.035))
    ):
        figure, (top, bottom) = axes(2, height=2.8)
        for name, (method, options) in methods.items():
            found = estimate(
                drive,
                method,
                options,
                initial_mass_kg=mass * TRUE_KG,
                initial_grade=grade,
                mass_max_kg=5_000.0,
            )
            e = errors(drive, found, 15.0)
            end = 100 * (found.mass_kg[-1] / TRUE_KG - 1)
            rows.append([f"start {label}: {name}", float(end), 100 * e[0] / TRUE_KG, e[1], e[2]])
            if name not in OURS:
                top.plot(drive.t_s, found.mass_kg, label=name, lw=1)
                bottom.plot(drive.t_s, 100 * found.grade, lw=1)
        top.axhline(TRUE_KG, color="k", ls="--", lw=1)
        bottom.plot(drive.t_s, 100 * drive.grade, "k--", lw=1)
        top.set_ylabel("mass, kg")
        bottom.set_ylabel("grade, %")
        bottom.set_ylim(-10, 25)
        bottom.set_xlabel("time, s")
        top.legend(fontsize=8, ncols=4)
        page.figure(figure, f"2014-figure-{11 + number}", f"Figure {11 + number}: start {label}")
    page.table(["from 15 s on", "mass at the end, %", "mass RMS, %", "mass worst, %", "grade RMS, deg"], rows)
    page.text(
        "Paper: with right starts all stay within 5 % of mass; with wrong ones RLS and EKF degrade "
        "substantially, DGO answers a wrong mass with a wrong grade, PMG is accurate whatever its start."
    )
    page.why(
        "The hill begins within 40 m, three seconds at this speed. RLS gives a fixed share of every "
        "innovation to the mass while the grade catches up, and on the constant climb after it nothing "
        "takes it back. The paper's RLS stayed within 5 % from the right start, on a longer transition. "
        "PMG's mass depends on an accelerometer without offset: the simulated one has a bias and coarse "
        "steps, as production sensors do; the paper's was a seat-track instrument."
    )
