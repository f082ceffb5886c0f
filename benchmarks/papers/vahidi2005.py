"""Vahidi, Stefanopoulou and Peng (2005): Figures 2 to 12 and Table 1."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from data import Drive, errors, estimate, from_equation, recorded, simulated
from page import Page, axes

from canest.estimators.papers.vahidi2005.identify import model_acceleration, road_load, rolling_radius

TRUE_KG = 20_000.0
SINGLE = {"constant": 0.8, "steps": 0.8, "ramp": 0.9, "sine": 0.9}
ROADS = {
    "constant": lambda t: np.zeros_like(t) + 0.01,
    "steps": lambda t: 0.02 * ((t // 25) % 3) - 0.01,
    "ramp": lambda t: np.interp(t, [0, 30, 80, 120, 160], [0.0, 0.0, 0.04, 0.04, -0.02]),
    "sine": lambda t: np.where(t < 30, 0.0, 0.03 * np.sin((t - 30) / 4.0)),
}
EXPERIMENT = {"preset": "2005-experiment", "start": "batch"}


def write(page: Page, drives: Path | None) -> None:
    page.section("Vahidi, Stefanopoulou, Peng (2005): RLS with multiple forgetting")
    _simulation(page)
    _vector(page)
    _bus_simulation(page)
    fixed = [simulated("cruise-fixed-gear")]
    pulses = "pulse-21t"
    if drives is not None:
        fixed += [d for d in (recorded(drives, "cruise-fixed-gear"),) if d is not None]
    _figure_7(page, fixed)
    _figures_9_10(page, pulses, drives)
    _figures_11_12(page)
    _figure_2(page)


def _plot(
    page: Page, drive: Drive, runs: dict[str, Any], name: str, caption: str, mass_range: Any = None
) -> None:
    figure, (top, bottom) = axes(2)
    for label, found in runs.items():
        top.plot(drive.t_s, found.mass_kg / 1000, label=label, lw=1)
        bottom.plot(drive.t_s, 100 * found.grade, lw=1)
    top.plot(drive.t_s, drive.mass_kg / 1000, "k--", lw=1, label="truth")
    bottom.plot(drive.t_s, 100 * drive.grade, "k--", lw=1)
    top.set_ylabel("mass, t")
    bottom.set_ylabel("grade, %")
    bottom.set_xlabel("time, s")
    if mass_range is not None:
        top.set_ylim(*mass_range)
    bottom.set_ylim(100 * np.nanmin(drive.grade) - 4, 100 * np.nanmax(drive.grade) + 4)
    top.legend(fontsize=8, ncols=4)
    page.figure(figure, name, caption)


def _simulation(page: Page) -> None:
    page.section("Figures 3 to 6 and Table 1: the equation itself, clean and with noise", 3)
    page.text(
        "Data made with the paper's eq. 2 (fuelling steps every one to four seconds, one gear, 50 Hz), "
        "batch start of four seconds. RLS with the paper's single factors (0.8 steps, 0.9 ramp and sine) "
        "against RLSMF 1.0/0.8. Errors from 10 s on. Noise: 0.02 m/s2 on the acceleration and 0.4 % on the "
        "force."
    )
    verdicts = {
        "constant": ("good", "good"),
        "steps": ("some overshoots", "good"),
        "ramp": ("bad", "good"),
        "sine": ("bad", "good"),
        "sine, mass ramp": ("bad", "some lag"),
    }
    rows = []
    for noise in (0.0, 0.02):
        for road in verdicts:
            grade = ROADS[road.split(",")[0]]
            slope = 30.0 if "ramp" in road.split(",")[-1] and "," in road else 0.0
            drive = from_equation(160.0, lambda t, s=slope: TRUE_KG + s * t, grade, noise)
            single = estimate(drive, "rls", {"forgetting": SINGLE[road.split(",")[0]], "start": "batch"})
            multiple = estimate(drive, "rlsmf", {"preset": "2005-simulation", "start": "batch"})
            a, b = errors(drive, single, 10.0), errors(drive, multiple, 10.0)
            label = f"{road}{', noise' if noise else ''}"
            rows.append([label, a[0], a[2], verdicts[road][0], b[0], b[2], verdicts[road][1]])
            if not noise and road in ("steps", "sine"):
                limits = (0, 45)
                for kind, found, number in (("single", single, "34"), ("multiple", multiple, "56")):
                    figure = number[road == "sine"]
                    _plot(
                        page, drive, {kind: found}, f"2005-figure-{figure}",
                        f"Figure {figure}: {kind} forgetting, {road} of grade, clean", limits,
                    )  # fmt: skip
    page.table(
        [
            "Table 1: scenario", "single: mass RMS, kg", "grade RMS, deg", "paper",
            "multiple: mass RMS, kg", "grade RMS, deg", "paper",
        ],
        rows,
    )  # fmt: skip
    page.why(
        "Table 1 of the paper has words only, for clean data. Single forgetting shows its overshoots at "
        "every step of grade and never recovers under noise: with a factor of 0.8 it remembers five "
        "samples. Estimates are kept between 3 t and 150 t, which is what bounds the errors of the bad "
        "ones."
    )


def _vector(page: Page) -> None:
    page.section("Vector-type forgetting with mismatched factors", 3)
    page.text(
        "The paper reports that vector-type forgetting sometimes winds up where RLSMF does not, when the "
        "factors do not match the true rates of change. Here: a constant grade with noise, and both "
        "methods with factors that fit (0.998/0.9), that let mass change as fast as grade (0.95/0.95, "
        "0.9/0.9), or grade far faster (0.99/0.4)."
    )
    rows = []
    shown = {}
    drive = from_equation(160.0, lambda t: TRUE_KG + 0 * t, ROADS["constant"], 0.02, seed=4)
    for factors in ((0.998, 0.9), (0.95, 0.95), (0.99, 0.4), (0.9, 0.9)):
        options = {"forgetting_mass": factors[0], "forgetting_grade": factors[1], "start": "batch"}
        row: list[Any] = [f"{factors[0]} / {factors[1]}"]
        for name in ("rls-vector", "rlsmf"):
            found = estimate(drive, name, options)
            e = errors(drive, found, 10.0)
            row += [e[0], e[1], e[2]]
            if factors == (0.95, 0.95):
                shown[name] = found
        rows.append(row)
    columns = ["mass RMS, kg", "worst, %", "grade RMS, deg"]
    header = ["mass / grade factor", *[f"vector: {c}" for c in columns], *[f"RLSMF: {c}" for c in columns]]
    page.table(header, rows)
    _plot(page, drive, shown, "2005-vector", "mismatched factors 0.95/0.95, noise", (0, 80))


def _bus_simulation(page: Page) -> None:
    page.section("The same roads through the bus", 3)
    page.text(
        "The scenarios grade-steps, grade-ramps and grade-sine: signals quantised as J1939 sends them, "
        "through decoder, 50 Hz grid and Butterworth. RLSMF with the paper's two tunings and this "
        "project's default."
    )
    rows = []
    for name in ("grade-steps", "grade-ramps", "grade-sine"):
        drive = simulated(name)
        for label, method, options in (
            ("RLS 0.9", "rls", {"forgetting": 0.9, "start": "batch"}),
            ("RLSMF 1.0/0.8", "rlsmf", {"preset": "2005-simulation", "start": "batch"}),
            ("RLSMF 0.95/0.4", "rlsmf", EXPERIMENT),
            ("RLSMF, default", "rlsmf", {"start": "batch"}),
        ):
            rows.append([name, label, *errors(drive, estimate(drive, method, options), 20.0)])
    page.table(["road", "method", "mass RMS, kg", "worst, %", "grade RMS, deg"], rows)


def _figure_7(page: Page, drives: list[Drive]) -> None:
    page.section("Figure 7: one gear, normal cruise", 3)
    rows: list[list[Any]] = [["paper (real truck), 0.95/0.4", 350.0, 2.8, 0.2]]
    for drive in drives:
        runs = {
            "0.95/0.4, window 1 s": estimate(drive, "rlsmf", EXPERIMENT),
            "0.95/0.4, window 10 s": estimate(drive, "rlsmf", {**EXPERIMENT, "window_s": 10.0}),
            "0.95/0.4, window 10 s, started 2.8 % off": estimate(
                drive,
                "rlsmf",
                {**EXPERIMENT, "window_s": 10.0, "start": "given"},
                initial_mass_kg=1.028 * drive.mass_kg[0],
            ),
            "0.95/0.4, differentiated": estimate(
                drive, "rlsmf", {**EXPERIMENT, "regression": "differentiated"}
            ),
            "default": estimate(drive, "rlsmf", {"start": "batch"}),
        }
        for label, found in runs.items():
            rows.append([f"{drive.name}, {label}", *errors(drive, found, 10.0)])
        tag = "recorded" if "recorded" in drive.name else "simulated"
        _plot(page, drive, runs, f"2005-figure-7-{tag}", f"Figure 7 on {drive.name}", (5, 42))
    page.table(["drive, tuning", "mass RMS, kg", "worst, %", "grade RMS, deg"], rows)
    page.why(
        "With a factor of 0.95 the mass has a memory of 0.4 s and with 0.4 the grade one of 30 ms. The "
        "information is in the window of the integrated regression (eq. 24), and the paper does not give "
        "its t0. Differentiated, the same factors fail: what the torque signal misses in a transient (lag, "
        "1 % steps, its delay against speed) goes straight into the mass. The first four seconds of these "
        "drives hold no pulse, so their batch is the poor one that the paper warns of and the first minute "
        "pays for it; one line starts where the paper's batch left its estimate. The paper's RMS of 350 kg "
        "and 2.8 % is not reached on these drives."
    )


def _figures_9_10(page: Page, name: str, drives: Path | None) -> None:
    page.section("Figures 9 and 10: always on against off in shifts", 3)
    always = ("gates.shift.enabled=false", "gates.driveline.enabled=false")
    rows: list[list[Any]] = [
        ["paper, always on", 420.0, None, 0.77],
        ["paper, off in shifts", 310.0, None, 0.24],
    ]
    pairs = [("simulated", simulated(name), simulated(name, always))]
    if drives is not None:
        off, on = recorded(drives, name), recorded(drives, name, always)
        if off is not None and on is not None:
            pairs.append(("recorded", off, on))
    for tag, off, on in pairs:
        for options, label in ((EXPERIMENT, "0.95/0.4"), ({"start": "batch"}, "default")):
            a, b = estimate(on, "rlsmf", options), estimate(off, "rlsmf", options)
            rows.append([f"{tag}, {label}, always on", *errors(on, a, 20.0)])
            rows.append([f"{tag}, {label}, off in shifts", *errors(off, b, 20.0)])
            if label == "0.95/0.4":
                _plot(
                    page, off, {"always on": a, "off in shifts": b}, f"2005-figure-9-10-{tag}",
                    f"Figures 9 and 10, {tag}: {label}", (5, 42),
                )  # fmt: skip
    page.table(["drive, tuning", "mass RMS, kg", "worst, %", "grade RMS, deg"], rows)
    page.why("The on/off logic has the paper's effect and about its size, most of all in the grade.")


def _figures_11_12(page: Page) -> None:
    page.section("Figures 11 and 12: sensitivity to drag, rolling resistance and wheel radius", 3)
    page.text("Fixed-gear drive, RLSMF default with batch start; one value of the config changed at a time.")
    nominal = {"drag_area_m2": 6.4, "rolling_resistance": 0.006, "wheel_radius_m": 0.5}
    shares = {"drag_area_m2": 0.25, "rolling_resistance": 0.5, "wheel_radius_m": 0.05}
    rows = []
    figure, (top, bottom) = axes(2)
    for key, value in nominal.items():
        points = []
        for step in (-1.0, -0.5, 0.0, 0.5, 1.0):
            changed = value * (1 + step * shares[key])
            drive = simulated("cruise-fixed-gear", (f"vehicle.{key}={changed}",))
            late = drive.t_s > 60
            found = estimate(drive, "rlsmf", {"start": "batch"})
            mean_mass = float(np.nanmean(found.mass_kg[late]))
            points.append((step * shares[key] * 100, *errors(drive, found, 60.0), mean_mass))
        table = np.array(points)
        rows += [[key, f"{p[0]:+.1f} %", *p[1:]] for p in points]
        top.plot(table[:, 0], table[:, 4] / table[2, 4], "o-", label=key)
        bottom.plot(table[:, 0], table[:, 3], "o-")
    top.set_ylabel("mean mass / nominal")
    bottom.set_ylabel("grade RMS, deg")
    bottom.set_xlabel("change of the config's value, %")
    top.legend(fontsize=8)
    page.figure(figure, "2005-figure-11-12", "Figures 11 and 12: sensitivity")
    page.table(["value", "change", "mass RMS, kg", "worst, %", "grade RMS, deg", "mean mass, kg"], rows)
    page.text(
        "Paper: rolling resistance moves the grade only; 25 % of drag changes both errors by less than 25 "
        "%; a wheel radius error goes into the mass with a sensitivity of about 1 and hardly into the "
        "grade."
    )


def _figure_2(page: Page) -> None:
    page.section("Section 3.3 and Figure 2: radius, drag and rolling resistance on a drive of known mass", 3)
    drive = simulated("mixed-36t")
    truth = {"radius": 0.5, "drag": 1.0, "rolling": 0.006}
    wheel = drive.signals["output_shaft_speed"] * 2 * np.pi / 60 / 3.73
    fit = rolling_radius(wheel, drive.signals["undriven_speed"], drive.plain.gate == 0)
    load = road_load(drive.plain, float(drive.mass_kg[0]), drive.grade)
    page.table(
        ["parameter", "found", "std", "declared"],
        [
            ["rolling radius, m", f"{fit.radius_m:.4f}", f"{fit.std_m:.1g}", truth["radius"]],
            ["drag area / declared", load.drag_factor, load.drag_factor_std, truth["drag"]],
            [
                "rolling resistance", f"{load.rolling_resistance:.4f}", f"{load.rolling_resistance_std:.1g}",
                truth["rolling"],
            ],
            ["correlation of the last two", load.correlation, None, None],
        ],
    )  # fmt: skip
    page.text(
        "This drive carries small undeclared errors (torque within 2 %, wind within 3 m/s, rolling "
        "resistance within 15 %, wheel slip), which is what the fit finds: it is the effective value on "
        "this drive."
    )
    figure, (top,) = axes(1, height=3.0)
    part = slice(4000, 8000)
    model = model_acceleration(drive.plain, float(drive.mass_kg[0]), drive.grade, load.rolling_resistance)
    top.plot(drive.t_s[part], drive.plain.accel_mps2[part], label="measured", lw=1)
    top.plot(drive.t_s[part], model[part], label="model", lw=1)
    closed = drive.plain.gate[part] != 0
    top.fill_between(drive.t_s[part], -1.5, 1.5, where=closed, alpha=0.15, color="gray", label="gated")
    top.set_ylim(-1.5, 1.5)
    top.set_ylabel("acceleration, m/s2")
    top.legend(fontsize=8)
    page.figure(
        figure, "2005-figure-2", "Figure 2: model against measurement; shifts do not match, as in the paper"
    )
