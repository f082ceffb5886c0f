"""The figures at the head of a replay's report, and the table of its load legs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from canest.core.samples import RATE_HZ
from canest.offline.leg_text import clock_text, span_text
from canest.offline.reported_masses import report_lines
from canest.report.page import Card, Section, Table
from canest.report.recorder import Recorder
from canest.report.verdicts import of_mass_error

_TONES = {"valid": "good", "converging": "warn", "unestimated": "bad"}


def cards(s: Mapping[str, Any], recorder: Recorder) -> list[Card]:
    """Return what a reader looks for first. s: the content of summary.json."""
    shown = []
    last = s["last_valid"]
    if last is not None:
        note = f"± {last['mass_std_kg']:,.0f} kg (1 σ), at {clock_text(last['t_s'])}"
        shown.append(Card("Last valid mass", f"{last['mass_kg']:,.0f} kg", note))
        share = f"{100 * s['valid_share']:.0f} %"
        shown.append(Card("Valid", share, f"of {s['driving_s']:,.0f} s of driving"))
    elif s["mass_kg"] is not None:
        std = f"± {s['mass_std_kg']:,.0f} kg (1 σ)" if s["mass_std_kg"] is not None else ""
        shown.append(Card("Mass at the end", f"{s['mass_kg']:,.0f} kg", std))
    shown.append(Card("Status at the end", s["status"], s["estimator"], _TONES.get(s["status"], "")))
    if s["samples"]:
        share = f"{100 * s['updated'] / s['samples']:.0f} %"
        shown.append(Card("Learned from", share, f"{s['updated'] / RATE_HZ:,.0f} s with open gates"))
    if s.get("errors"):
        std_pct = 100 * last["mass_std_kg"] / last["mass_kg"] if last is not None else 0.0
        shown += _error_cards(s["errors"], std_pct)
    if recorder.whiteness.count:
        shown.append(Card("Force residual RMS", f"{recorder.whiteness.rms_N:,.0f} N", "open samples, 1 Hz"))
    return shown


def _error_cards(errors: Mapping[str, Any], std_pct: float) -> list[Card]:
    """Return the errors over the settled legs, with those over all samples as a note.

    std_pct: standard deviation of the last valid mass, % of it.
    """
    settled, shown = errors["settled"], []
    whole = f"over all samples from {errors['after_s']:g} s on"
    if settled["mass_rms_pct"] is not None:
        note = f"settled legs, worst {settled['mass_max_pct']:.2f} %"
        if errors["mass_rms_pct"] is not None:
            note += f"; {errors['mass_rms_pct']:.2f} % {whole}"
        verdict = of_mass_error(settled["mass_rms_pct"], std_pct)
        note += f"; {verdict.text}"
        shown.append(Card("Mass error RMS", f"{settled['mass_rms_pct']:.2f} %", note, verdict.tone))
    elif errors["mass_rms_pct"] is not None:
        note = f"never valid; {whole}, worst {errors['mass_max_pct']:.2f} %"
        shown.append(Card("Mass error RMS", f"{errors['mass_rms_pct']:.2f} %", note))
    grade_deg, note = settled["grade_rms_deg"], "settled legs"
    if grade_deg is None:
        grade_deg, note = errors["grade_rms_deg"], whole
    if grade_deg is not None:
        shown.append(Card("Grade error RMS", f"{grade_deg:.3f}°", note))
    return shown


def legs_section(s: Mapping[str, Any]) -> Section:
    """Return the table of the load legs."""
    header = ["load", "from, to", "mass, kg", "std, kg", "valid", "km", "climb, m", "stops"]
    known = any(leg["true_mass_kg"] is not None for leg in s["legs"])
    rows = []
    for leg in s["legs"]:
        row = [
            str(leg["load"]) if leg["load"] else leg["status"],
            span_text(leg),
            _figure(leg["mass_kg"]),
            _figure(leg["mass_std_kg"]),
            f"{100 * leg['valid_share']:.0f} %",
            f"{leg['distance_m'] / 1e3:,.1f}",
            f"{leg['climb_m']:,.0f}",
            str(leg["stops"]),
        ]
        if known:
            error = (
                "-" if leg["mass_error_pct"] is None else f"{round(leg['mass_error_pct'], 1) + 0.0:+.1f} %"
            )
            row += [_figure(leg["true_mass_kg"]), error]
        rows.append(row)
    if known:
        header += ["truth, kg", "error"]
    text = (
        "A leg runs from one stop in which the load may have changed to the next. Neighbours whose masses "
        "agree within their standard deviations are one leg. Only a leg with a valid mass is a load."
    )
    return Section("Load legs", text=text, table=Table(header, rows, left=(0, 1)))


def reported_section(s: Mapping[str, Any]) -> Section:
    """Return the table of what other controllers report of the mass."""
    agrees = {True: "yes", False: "no", None: "-"}
    rows = []
    for mass in s["reported_masses"]:
        apart, error = _percent(mass["difference_pct"]), _percent(mass["error_pct"])
        row = [mass["sender"], _figure(mass["mass_kg"]), apart, agrees[mass["agrees"]], error]
        rows.append([*row, f"{mass['values']:,}"])
    text = ". ".join(report_lines(s["reported_masses"], s["legs"])[len(rows) :])
    header = ["sender", "last, kg", "against ours", "within 2 std", "against the truth", "values"]
    return Section("Masses that other controllers report", text=text, table=Table(header, rows))


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} %"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"
