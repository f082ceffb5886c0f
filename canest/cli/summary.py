"""Results as lines for a person, and as JSON for a program."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canest.offline.leg_text import error_parts, leg_text, loads, mass_text, settled_text
from canest.offline.reported_masses import report_lines
from canest.system.result_files import write_result

if TYPE_CHECKING:
    from canest.offline.replay import ReplayResult

_LABEL = 10
#: logs whose notes are shown below a table of many
_MOST_NOTED = 20
#: columns of a table of many logs without the errors
_WITHOUT_TRUTH = 8


def write_json(summary: dict[str, Any], path: str) -> None:
    """Write JSON to a file, or to stdout for '-'. Errors: OutputError."""
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    if path == "-":
        sys.stdout.write(text)
        return
    write_result(path, text)


def result_lines(result: ReplayResult, written: Sequence[Path]) -> list[str]:
    """Return what one replay found, for a terminal."""
    s = result.summary
    lines = [result.log]
    _put(lines, "frames", f"{s['frames']:,} ({s['skipped_lines']:,} lines skipped) in {s['wall_s']:.2f} s")
    _put(lines, "samples", f"{s['samples']:,} at 50 Hz, {s['updated']:,} learned from{_share(s)}")
    if s["gates"]:
        from canest.doctor.reasons import gate_shares

        _put(lines, "gates", gate_shares(s["gates"], s["samples"]))
    _put(lines, "mass", mass_text(s))
    if len(s["legs"]) > 1:
        for leg in s["legs"]:
            _put(lines, f"load {leg['load']}" if leg["load"] else "leg", leg_text(leg))
    if "errors" in s:
        _put(lines, "error", settled_text(s["errors"], s["driving_s"]))
        _put(lines, "", f"all samples, standing too: {errors_text(s['errors'])}")
    for line in report_lines(s["reported_masses"], s["legs"]):
        _put(lines, "reported", line)
    if s.get("reason"):
        _put(lines, "because", s["reason"])
    for note in result.warnings:
        _put(lines, "note", note)
    for path in written:
        _put(lines, "written", str(path))
    return lines


def many_lines(summary: dict[str, Any]) -> list[str]:
    """Return what a replay of many logs found: a row each, then the pool."""
    header = [
        "log",
        "frames",
        "open %",
        "last valid kg",
        "std kg",
        "valid %",
        "loads",
        "at the end",
        "mass RMS %",
        "worst %",
        "grade RMS deg",
    ]
    rows = [header]
    names = short_names([log["log"] for log in summary["logs"]])
    for name, log in zip(names, summary["logs"], strict=True):
        if "error" in log:
            rows.append([name, "failed"])
            continue
        open_pct = 100 * log["updated"] / log["samples"] if log["samples"] else 0.0
        errors = log.get("errors", {}).get("settled", {})
        last = log["last_valid"] or {}
        rows.append([
            name, f"{log['frames']:,}", f"{open_pct:.0f}",
            _figure(last.get("mass_kg"), 0), _figure(last.get("mass_std_kg"), 0),
            f"{100 * log['valid_share']:.0f}", f"{len(loads(log))}", log["status"],
            _figure(errors.get("mass_rms_pct"), 2), _figure(errors.get("mass_max_pct"), 2),
            _figure(errors.get("grade_rms_deg"), 3),
        ])  # fmt: skip
    if "errors" not in summary:
        rows = [row[:_WITHOUT_TRUTH] for row in rows]
    lines = table(rows)
    lines += note_lines(
        [(name, _noted(log)) for name, log in zip(names, summary["logs"], strict=True)],
        "--json PATH",
    )
    done = len(summary["logs"]) - summary["failed"]
    lines.append(f"{done:,} logs, {summary['frames']:,} frames, {summary['failed']:,} failed")
    if "errors" in summary:
        lines.append("pooled: " + settled_text(summary["errors"], summary["driving_s"]))
        lines.append("        all samples, standing too: " + errors_text(summary["errors"]))
    return lines


def note_lines(noted: Sequence[tuple[str, Sequence[str]]], in_full: str) -> list[str]:
    """Return the notes of many logs, a line for each log that has any; ``in_full``: where they all are."""
    noted = [(name, notes) for name, notes in noted if notes]
    lines = [f"note: {name}: {'; '.join(notes)}" for name, notes in noted[:_MOST_NOTED]]
    if len(noted) > _MOST_NOTED:
        lines.append(f"note: {len(noted) - _MOST_NOTED:,} more logs have notes ({in_full} has them all)")
    return lines


def short_names(paths: Sequence[str]) -> list[str]:
    """Return of each path the fewest last parts that no other has: a/x.log where there is b/x.log.

    Each is one line, whatever a name holds.
    """
    parts = [Path(path).parts for path in paths]
    ends = Counter(p[-n:] for p in set(parts) for n in range(1, len(p) + 1))
    names = [str(Path(*next((p[-n:] for n in range(1, len(p)) if ends[p[-n:]] == 1), p))) for p in parts]
    return [name.replace("\n", "\\n").replace("\r", "\\r") for name in names]


def table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as aligned text: the first column to the left, the others to the right."""
    widths = [max(len(row[i]) for row in rows if i < len(row)) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(widths[i]) if i == 0 else cell.rjust(widths[i]) for i, cell in enumerate(row)
        ).rstrip()
        for row in rows
    ]


def errors_text(errors: dict[str, Any]) -> str:
    """Return the errors of a summary as one line."""
    parts = error_parts(errors)
    if not parts:
        return f"none counted: no estimate with known truth later than {errors['after_s']:g} s"
    text = ", ".join(parts) + f", from {errors['after_s']:g} s on"
    if errors["without_estimate"]:
        text += f" ({errors['without_estimate']:,} samples had no estimate)"
    return text


def _noted(log: dict[str, Any]) -> list[str]:
    """Return why a log of many has no estimate, and its notes."""
    because = [f"no estimate: {log['reason']}"] if log.get("reason") else []
    return because + list(log.get("notes", []))


def _share(s: dict[str, Any]) -> str:
    return f" ({100 * s['updated'] / s['samples']:.0f} %)" if s["samples"] else ""


def _figure(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:,.{decimals}f}"


def _put(lines: list[str], label: str, text: str) -> None:
    lines.append(f"  {label:<{_LABEL}}{text}")
