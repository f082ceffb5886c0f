"""Reports of several logs in one directory: their index, and the file with plotly that they share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from canest.report.page import Page, Section, Table

INDEX = "index.html"


class Entry(NamedTuple):
    """One log: its name, the file name of its report, its summary, and why there is none."""

    name: str
    report: str
    summary: dict[str, Any] | None
    error: str


def write_index(directory: Path, entries: Sequence[Entry]) -> None:
    """Write the page that leads to all reports. Errors: OutputError."""
    index_page(entries).write(directory / INDEX)


def index_page(entries: Sequence[Entry]) -> Page:
    """Return the page: one row per log, failed ones with the reason."""
    rows = [
        [entry.name, *(_cells(entry.summary) if entry.summary else ["failed", *[""] * 5, entry.error])]
        for entry in entries
    ]
    links = [entry.report if entry.summary else "" for entry in entries]
    done = sum(entry.summary is not None for entry in entries)
    header = ["log", "status", "mass, kg", "std, kg", "mass error, %", "grade error, deg", "samples", ""]
    return Page(
        title="canest replay",
        headline=f"{done} of {len(entries)} logs replayed",
        sections=[Section("Logs", table=Table(header, rows, left=(0, 1, 7), links=links))],
    )


def _cells(s: dict[str, Any]) -> list[str]:
    errors = s.get("errors") or {}
    return [
        s["status"],
        _number(s["mass_kg"], ",.0f"),
        _number(s["mass_std_kg"], ",.0f"),
        _number(errors.get("mass_rms_pct"), ".2f"),
        _number(errors.get("grade_rms_deg"), ".3f"),
        f"{s['samples']:,}",
        s.get("reason", ""),
    ]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
