"""The report of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from canest.diagnose.outcome import Entry
from canest.diagnose.run import Diagnosis
from canest.report.page import Page


def report_page(diagnosis: Diagnosis, found: Sequence[Entry], logs: Sequence[str]) -> Page:
    """Return the page."""
    title = " · ".join(Path(log).name for log in logs[:3]) + (
        f" and {len(logs) - 3} more" if len(logs) > 3 else ""
    )
    return Page(title=f"{title} · {diagnosis.config.vehicle.name} · diagnosis", headline=diagnosis.finding)
