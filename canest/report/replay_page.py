"""The report of one replay."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.offline.leg_text import CALENDAR_END_S, EPOCH_S, headline
from canest.offline.model_columns import nearest_gear, residual_N
from canest.pipeline.build import model_spec
from canest.report import figure as look
from canest.report.figure import Rows, numbers, with_gaps
from canest.report.gate_colours import OPEN_COLOUR, spans_of
from canest.report.gate_colours import look as gate_look
from canest.report.page import Bar, Page, Section, Table
from canest.report.recorder import Recorder
from canest.report.replay_figures import cards, legs_section, reported_section
from canest.vehicle.model import LongitudinalModel

if TYPE_CHECKING:
    from canest.config import Config
    from canest.offline.replay import ReplayResult
    from canest.offline.scoring import Score


def write_replay_report(
    path: str | Path,
    result: ReplayResult,
    config: Config,
    recorder: Recorder,
    score: Score | None,
    script_file: str = "",
) -> None:
    """Write the report of one log; script_file as in `Page.render`. Errors: OutputError."""
    replay_page(result, config, recorder, score).write(path, script_file)


def replay_page(result: ReplayResult, config: Config, recorder: Recorder, score: Score | None) -> Page:
    """Return the page of one log."""
    s = result.summary
    page = Page(
        title=f"{Path(result.log).name} · {config.vehicle.name} · estimator {s['estimator']}",
        headline=headline(s),
        facts=_facts(s, recorder),
        cards=cards(s, recorder),
    )
    stamps, columns = recorder.columns()
    if len(stamps):
        page.sections.append(_drive(stamps, columns, config, recorder, score))
    if s["legs"]:
        page.sections.append(legs_section(s))
    if s["reported_masses"]:
        page.sections.append(reported_section(s))
    page.sections.append(_gates(s))
    if recorder.whiteness.count:
        page.sections.append(_residual(recorder, result.innovations))
    if result.warnings:
        page.sections.append(Section("Notes", text=" · ".join(result.warnings)))
    return page


def _facts(s: dict[str, Any], recorder: Recorder) -> list[tuple[str, str]]:
    facts = []
    if recorder.first_us is not None:
        facts.append(("duration", _clock((recorder.last_us - recorder.first_us) * 1e-6)))
        if EPOCH_S < recorder.first_us * 1e-6 < CALENDAR_END_S:
            start = datetime.fromtimestamp(recorder.first_us * 1e-6, UTC)
            facts.insert(0, ("starts", start.strftime("%Y-%m-%d %H:%M:%S UTC")))
    facts.append(("frames", f"{s['frames']:,}"))
    facts.append(("lines skipped", f"{s['skipped_lines']:,}"))
    facts.append(("samples at 50 Hz", f"{s['samples']:,}"))
    return facts


def _drive(
    stamps: IntColumn,
    columns: dict[str, FloatColumn],
    config: Config,
    recorder: Recorder,
    score: Score | None,
) -> Section:
    origin = recorder.first_us or 0
    stamps, columns = with_gaps(stamps, columns)
    x = numbers((stamps - origin) * 1e-6, 2)
    rows = Rows(
        ["mass, t", "grade, %", "speed, km/h", "torque, N m", "gear", "force, kN", "residual, kN"],
        [1.5, 1.3, 0.9, 0.9, 0.45, 0.9, 0.8],
        "seconds since the start",
    )
    mass_true, grade_true = score.truth_at(stamps) if score is not None else (None, None)
    _estimate(rows, 1, x, columns["mass_kg"] / 1e3, columns["mass_std_kg"] / 1e3, "mass", look.BLUE, "t")
    if mass_true is not None and np.isfinite(mass_true).any():
        rows.line(
            1,
            x,
            numbers(mass_true / 1e3, 3),
            "true mass",
            look.Stroke(look.INK, dash="dash"),
            hover="%{y:.2f} t",
        )
    _fit_mass_axis(rows, columns, config)
    _estimate(rows, 2, x, columns["grade"] * 1e2, columns["grade_std"] * 1e2, "grade", look.GREEN, "%")
    if grade_true is not None and np.isfinite(grade_true).any():
        rows.line(
            2,
            x,
            numbers(grade_true * 1e2, 3),
            "true grade",
            look.Stroke(look.INK, dash="dash"),
            hover="%{y:.2f} %",
        )
    _motion(rows, x, columns, config)
    residual = residual_N(
        columns["mass_kg"], columns["accel_mps2"], columns["grade"], columns["mu"], columns["force_N"]
    )
    residual = np.where(columns["gate"] == 0, residual, np.nan)
    rows.line(
        7, x, numbers(residual / 1e3, 3), "residual", look.Stroke(look.RED, width=1.0), hover="%{y:.2f} kN"
    )
    size = np.abs(residual[np.isfinite(residual)]) / 1e3
    if len(size):
        limit = 1.4 * float(np.percentile(size, 99.5))
        rows.axis(7)["range"] = [-limit, limit]
    spans = spans_of(recorder.closures(), origin)
    for gate in sorted(spans, key=lambda name: sum(end - first for first, end in spans[name])):
        rows.spans(spans[gate], f"gate: {gate}", gate_look(gate)[0])
    return Section(
        "The drive",
        text="Bands are two standard deviations. Shaded: a gate is closed, the estimator keeps what it "
        "knows. The residual is m (a + g sin β + g μ cos β) - F with the estimate of the moment, where open.",
        figure=rows.to_json(),
    )


def _motion(rows: Rows, x: list[float | None], columns: dict[str, FloatColumn], config: Config) -> None:
    """Draw what the model was given, rows 3 to 6; a gap where it is not known."""
    rows.line(
        3,
        x,
        numbers(columns["raw_speed_mps"] * 3.6, 2),
        "speed",
        look.Stroke(look.ORANGE),
        hover="%{y:.1f} km/h",
    )
    torque = (
        "torque at the wheels" if LongitudinalModel(model_spec(config)).at_wheels else "net engine torque"
    )
    rows.line(
        4,
        x,
        numbers(columns["raw_torque_Nm"], 0),
        torque,
        look.Stroke(look.GREEN, width=1.2),
        hover="%{y:,.0f} N m",
    )
    gear = nearest_gear(columns["force_per_torque_1pm"], config)
    rows.line(5, x, numbers(gear, 0), "gear", look.Stroke(look.MUTED, width=1.3, shape="hv"))
    # the filter repeats the last force where there is none
    known = np.where(np.isfinite(columns["raw_force_N"]), 1e-3, np.nan)
    rows.line(
        6,
        x,
        numbers(columns["traction_N"] * known, 2),
        "traction",
        look.Stroke(look.VIOLET, width=1.2),
        hover="%{y:.1f} kN",
    )
    rows.line(
        6,
        x,
        numbers(columns["force_N"] * known, 2),
        "net force",
        look.Stroke(look.BLUE, width=1.2),
        hover="%{y:.1f} kN",
    )


def _estimate(
    rows: Rows,
    row: int,
    x: list[float | None],
    value: FloatColumn,
    std: FloatColumn,
    name: str,
    colour: str,
    unit: str,
) -> None:
    """Draw an estimate with its band of two standard deviations, to three decimals."""
    rows.band(row, x, numbers(value - 2 * std, 3), numbers(value + 2 * std, 3), colour, name)
    rows.line(row, x, numbers(value, 3), name, look.Stroke(colour), hover="%{y:.2f} " + unit)


def _fit_mass_axis(rows: Rows, columns: dict[str, FloatColumn], config: Config) -> None:
    """Show the estimate, not the whole prior: its 1st to 99th percentile with room for the band."""
    mass = columns["mass_kg"][np.isfinite(columns["mass_kg"])] / 1e3
    if not len(mass):
        return
    low, high = np.percentile(mass, (1, 99))
    room = max(0.35 * (high - low), 0.06 * high)
    v = config.vehicle
    rows.axis(1)["range"] = [
        max(low - room, 0.9e-3 * v.mass_min_kg),
        min(high + room, 1.1e-3 * v.mass_max_kg),
    ]


def _gates(s: dict[str, Any]) -> Section:
    samples = max(s["samples"], 1)
    bars = [Bar("open: the estimator learns", s["updated"] / samples, OPEN_COLOUR)]
    for gate, count in sorted(s["gates"].items(), key=lambda item: -item[1]):
        colour, meaning = gate_look(gate)
        bars.append(Bar(f"{gate}: {meaning}", count / samples, colour))
    return Section("Gates", text="Share of all samples, by the gate that refused them.", bars=bars)


def _residual(recorder: Recorder, innovations: dict[str, float]) -> Section:
    w = recorder.whiteness
    rows = [
        ["force residual RMS", f"{w.rms_N:,.0f} N", "what the model with its estimate leaves unexplained"],
        ["correlation over one second", _or_dash(w.correlation, "+.2f"), "0 when nothing systematic is left"],
        ["runs test (z)", _or_dash(w.runs_z, "+.1f"), "within ±2 when signs change at random"],
        ["seconds counted", f"{w.count:,}", "open samples on whole seconds"],
    ]
    if innovations.get("windows"):
        nis = _or_dash(innovations["nis"], ".2f")
        rows.append(
            ["normalised innovation squared", nis, "1 when the estimator's standard deviation is right"]
        )
        if "runs_z" in innovations:
            runs = _or_dash(innovations["runs_z"], "+.1f")
            rows.append(["runs test of innovations (z)", runs, f"over {innovations['windows']:,.0f} windows"])
    text = "A correlated residual points at something the model lacks: canest diagnose looks for it."
    table = Table(["", "value", "meaning"], rows, left=(0, 2))
    return Section("What is left over", text=text, table=table)


def _or_dash(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"
