"""The report of a comparison: every estimator over the truth, and the table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import STEP_S, STEP_US
from canest.report import figure as look
from canest.report.config_section import config_section
from canest.report.figure import Rows, numbers, with_gaps
from canest.report.page import Card, Column, Page, Section, Table, cells, titles

if TYPE_CHECKING:
    from canest.config import Config
    from canest.offline.compare import Comparison

#: points per curve; there are two curves per estimator
POINTS_MAX = 5_000
FIRST_STRIDE = 10
#: drawn at first: the default and this many more, best first; the others wait in the legend
SHOWN_FIRST = 5

COLUMNS: tuple[Column, ...] = (
    Column("mass_end_pct", "mass at the end %", "+.2f"),
    Column("mass_rms_pct", "mass RMS %", ".2f"),
    Column("mass_max_pct", "worst %", ".2f"),
    Column("grade_rms_deg", "grade RMS °", ".3f"),
    Column("to_5pct_s", "to 5 %, s", ".1f"),
    Column("ns_per_sample", "ns/sample", ",.0f"),
)


def write_compare_report(path: str | Path, log: str, config: Config, result: Comparison) -> None:
    """Write the report. Errors: OutputError."""
    page = compare_page(log, config.vehicle.name, result)
    page.sections.append(config_section(config))
    page.write(path)


def ranked(estimators: dict[str, Any]) -> list[str]:
    """Return the names, smallest mass error first, those without one last (by grade error).

    The error is the RMS, in a drive too short for one that of the end.
    """

    def key(name: str) -> tuple[bool, float, bool, float, bool, float]:
        row = estimators[name]
        mass, end, grade = row["mass_rms_pct"], row["mass_end_pct"], row["grade_rms_deg"]
        return mass is None, mass or 0.0, end is None, abs(end or 0.0), grade is None, grade or 0.0

    return sorted(estimators, key=key)


def compare_page(log: str, vehicle: str, result: Comparison) -> Page:
    """Return the page, but for its config."""
    estimators, default = result.table["estimators"], result.table["default"]
    order = ranked(estimators)
    best = order[0]
    page = Page(
        title=f"{Path(log).name} · {vehicle} · {len(order)} estimators", headline="Estimators compared"
    )
    if estimators[best]["mass_rms_pct"] is not None:
        page.headline = f"{best} is nearest: mass within {estimators[best]['mass_rms_pct']:.2f} % RMS"
        page.cards = [
            Card(name, f"{estimators[name]['mass_rms_pct']:.2f} %", _card_note(estimators[name]),
                 "good" if name == default else "")
            for name in order[:5] if estimators[name]["mass_rms_pct"] is not None
        ]  # fmt: skip
    rows = [[name, *cells(estimators[name], COLUMNS), estimators[name]["note"]] for name in order]
    marked = order.index(default) if default in order else None  # --only may have left it out
    table = Table(["estimator", *titles(COLUMNS), "note"], rows, marked, (0, 7))
    speed_note = "compiled" if result.table.get("compiled") else "interpreted"
    text = (
        "Smallest mass error first: the RMS, or at the end where the drive is too short for one. "
        f"The config's own estimator is marked. Costs are of {speed_note} kernels."
    )
    page.sections.append(Section("Figures", text=text, table=table))
    if result.table["notes"]:
        page.sections.append(Section("Notes", text=" · ".join(result.table["notes"])))
    if len(result.true_mass_kg):
        page.sections.append(_curves(result, order, default))
    return page


def _card_note(row: dict[str, Any]) -> str:
    if row["grade_rms_deg"] is None:
        return "mass RMS"
    return f"mass RMS; grade {row['grade_rms_deg']:.3f}°"


def _curves(result: Comparison, order: list[str], default: str) -> Section:
    any_estimates = next(iter(result.estimates.values()))
    t_us = any_estimates.t_us
    stride = FIRST_STRIDE
    while len(t_us) / stride > POINTS_MAX:
        stride *= 2
    keep = np.flatnonzero(t_us // STEP_US % stride == 0)
    columns = {"speed": result.speed_mps, "true mass": result.true_mass_kg, "true grade": result.true_grade}
    for name, e in result.estimates.items():
        columns |= {f"{name} mass": e.mass_kg, f"{name} grade": e.grade}
    stamps, columns = with_gaps(t_us[keep], {name: column[keep] for name, column in columns.items()})
    x = numbers((stamps - t_us[0]) * 1e-6, 2)
    rows = Rows(["mass, t", "grade, %", "speed, km/h"], [2.2, 1.8, 0.8], "seconds since the start")
    shown = {default, *order[:SHOWN_FIRST]}
    strokes = _strokes(order, default)
    for name in order:
        mass, grade = columns[f"{name} mass"], columns[f"{name} grade"]
        first = len(rows.traces)
        rows.line(1, x, numbers(mass / 1e3, 3), name, strokes[name], hover="%{y:.2f} t")
        rows.line(2, x, numbers(grade * 1e2, 3), name, strokes[name], hover="%{y:.2f} %", legend=False)
        if name not in shown:
            for trace in rows.traces[first:]:
                trace["visible"] = "legendonly"
        rows.traces[first]["meta"] = {"unit": "t", "digits": 3}
        rows.traces[first + 1]["meta"] = {"unit": "%", "digits": 2}
    limits = _draw_truth(rows, x, columns)
    rows.line(
        3,
        x,
        numbers(columns["speed"] * 3.6, 2),
        "speed",
        look.Stroke(look.MUTED),
        hover="%{y:.1f} km/h",
        legend=False,
    )
    rows.traces[-1]["meta"] = {"unit": "km/h", "digits": 1}
    way_m = np.cumsum(np.abs(np.nan_to_num(result.speed_mps))) * STEP_S
    _, gapped = with_gaps(t_us[keep], {"way": way_m[keep]})
    no = np.zeros(len(x), np.bool_)
    rows.link(x, gapped["way"] / 1e3, no, robust=["yaxis", "yaxis2"], limits=limits)
    return Section(
        "Mass and grade over the drive",
        text="The nearest few are drawn; click a name in the legend to add or remove an estimator.",
        figure=rows.to_json(),
    )


def _strokes(order: list[str], default: str) -> dict[str, look.Stroke]:
    """Return a look per estimator: the default's alone is wide; where colours repeat, the line is dotted."""
    own, *others = look.SERIES
    strokes = {default: look.Stroke(own, width=2.4)}
    for index, name in enumerate(name for name in order if name != default):
        again, at = divmod(index, len(others))
        strokes[name] = look.Stroke(others[at], width=1.3, dash="dot" if again else "solid")
    return strokes


def _draw_truth(rows: Rows, x: list[float | None], columns: dict[str, FloatColumn]) -> dict[str, list[float]]:
    """Draw true mass and grade where they are known; return beyond what the axes need not go."""
    stroke = look.Stroke(look.INK, dash="dash")
    limits = {}
    mass_t, grade_pct = columns["true mass"] / 1e3, columns["true grade"] * 1e2
    if np.isfinite(mass_t).any():
        rows.line(1, x, numbers(mass_t, 3), "truth", stroke, hover="%{y:.2f} t")
        rows.traces[-1]["meta"] = {"unit": "t", "digits": 3}
        limits["yaxis"] = [0.7 * float(np.nanmin(mass_t)), 1.35 * float(np.nanmax(mass_t))]
    if np.isfinite(grade_pct).any():
        rows.line(2, x, numbers(grade_pct, 3), "truth", stroke, hover="%{y:.2f} %", legend=False)
        rows.traces[-1]["meta"] = {"unit": "%", "digits": 2}
        limits["yaxis2"] = [float(np.nanmin(grade_pct)) - 2.0, float(np.nanmax(grade_pct)) + 2.0]
    return limits
