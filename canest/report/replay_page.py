"""The report of one replay."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canest.core.samples import GRAVITY_MPS2
from canest.offline.leg_text import CALENDAR_END_S, EPOCH_S, headline
from canest.report.config_section import config_section
from canest.report.drive_section import drive_section
from canest.report.gate_colours import OPEN_COLOUR
from canest.report.gate_colours import look as gate_look
from canest.report.page import Bar, Page, Section, Table
from canest.report.recorder import Recorder
from canest.report.replay_figures import cards, legs_section, reported_section
from canest.report.verdicts import (
    of_correlation,
    of_count,
    of_low_nis,
    of_nis,
    of_residual,
    of_runs,
    why_not_valid,
)

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
    if reasons := why_not_valid(s):
        page.sections.append(Section("Why not valid", text=" ".join(reasons)))
    stamps, columns = recorder.columns()
    if len(stamps):
        page.sections.append(drive_section(stamps, columns, config, recorder, score))
    if s["legs"]:
        page.sections.append(legs_section(s))
    if s["reported_masses"]:
        page.sections.append(reported_section(s))
    page.sections.append(_gates(s))
    if recorder.whiteness.count:
        page.sections.append(_residual(recorder, result))
    if result.warnings:
        page.sections.append(Section("Notes", text=" · ".join(result.warnings)))
    page.sections.append(config_section(config))
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


def _gates(s: dict[str, Any]) -> Section:
    samples = max(s["samples"], 1)
    bars = [Bar("open: the estimator learns", s["updated"] / samples, OPEN_COLOUR)]
    for gate, count in sorted(s["gates"].items(), key=lambda item: -item[1]):
        colour, meaning = gate_look(gate)
        bars.append(Bar(f"{gate}: {meaning}", count / samples, colour))
    return Section("Gates", text="Share of all samples, by the gate that refused them.", bars=bars)


def _residual(recorder: Recorder, result: ReplayResult) -> Section:
    w, innovations = recorder.whiteness, result.innovations
    weight_N = GRAVITY_MPS2 * (result.summary["mass_kg"] or 0.0)
    judged = [
        ("force residual RMS", f"{w.rms_N:,.0f} N", of_residual(w.rms_N, weight_N)),
        (
            "correlation over one second",
            _or_dash(w.correlation, "+.2f"),
            of_correlation(w.correlation),
        ),
        ("runs test (z)", _or_dash(w.runs_z, "+.1f"), of_runs(w.runs_z)),
        ("seconds counted", f"{w.count:,}", of_count(w.count)),
    ]
    if innovations.get("windows"):
        nis = innovations["nis"]
        judged.append(("normalised innovation squared", _or_dash(nis, ".2f"), of_nis(nis)))
        if "low_nis" in innovations:
            low_nis = innovations["low_nis"]
            judged.append(
                ("normalised innovation squared, low-passed", f"{low_nis:.2f}", of_low_nis(low_nis))
            )
        if "runs_z" in innovations:
            z = innovations["runs_z"]
            name = f"runs test of {innovations['windows']:,.0f} innovations (z)"
            judged.append((name, _or_dash(z, "+.1f"), of_runs(z, "innovations")))
    text = (
        "The residual is what the model with its estimate leaves unexplained, at open gates, each second. "
        "Normalised innovations squared are 1 when the estimator's standard deviation is right."
    )
    rows = [[name, value, verdict.text] for name, value, verdict in judged]
    table = Table(["", "value", "what it means"], rows, left=(0, 2), tones=[v.tone for _, _, v in judged])
    return Section("What is left over", text=text, table=table)


def _or_dash(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"
