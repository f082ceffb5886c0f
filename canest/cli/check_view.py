"""What `canest check` prints: the verdict and the problems first, then the roles that matter."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from canest.doctor.reasons import gate_shares
from canest.system.terminal import console as console_for

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from canest.doctor.check import Report
    from canest.doctor.signal_report import RoleReport, Sender

#: columns of a table that goes to a file or a pipe
_FILE_WIDTH = 180
#: narrower terminals do without the least useful columns
_WIDE = 140
COLUMNS = ("role", "need", "expected as", "verdict", "from", "rate Hz", "values", "n/a", "error", "range")
NARROW = ("role", "verdict", "from", "rate Hz", "range")
#: labels of a role that are shown, commonest first
_LABELS = 6


def show(report: Report, title: str, verbose: bool = False) -> None:
    """Print a report. verbose: all roles, all senders and all labels."""
    terminal = sys.stdout.isatty()
    console = console_for(highlight=False, width=None if terminal else _FILE_WIDTH)
    console.print(title, soft_wrap=True, markup=False)
    if report.stops:
        _print_sentence(console, "stops", "bold red", report.stops, terminal)
    else:
        but = "; what the hints say may make it wrong" if report.hints else ""
        ready = f"nothing stops the estimator (at the end: {report.status}){but}"
        _print_sentence(console, "ready", "bold green", ready, terminal)
    for hint in report.hints:
        _print_sentence(console, "hint", "yellow", hint, terminal)
    for note in report.notes:
        _print_sentence(console, "note", "dim", note, terminal)
    if report.samples:
        shares = gate_shares(report.gates, report.samples)
        opened = f"{report.samples:,} samples at 50 Hz, {100 * report.updated / report.samples:.0f} % open"
        _print_sentence(console, "gates", "dim", opened + (f"; closed: {shares}" if shares else ""), terminal)
    shown = [entry for entry in report.roles if verbose or _matters(entry)]
    _table(console, shown, verbose)
    for entry in shown:
        if entry.labels and (verbose or entry.role in ("gear", "selected_gear")):
            _print_sentence(console, "label", "dim", _labels(entry, verbose), terminal)
    folded = [entry for entry in report.roles if entry not in shown]
    for what, sound in (("also ok", True), ("without a value, and not needed", False)):
        names = [entry.role for entry in folded if (entry.verdict == "ok") == sound]
        if names:
            _print_sentence(console, "roles", "dim", f"{what} (-v shows them): {', '.join(names)}", terminal)


def _print_sentence(console: Console, head: str, colour: str, text: str, terminal: bool) -> None:
    """Print one sentence: on a terminal wrapped under itself, into a file as one line."""
    from rich.table import Table
    from rich.text import Text

    if not terminal:
        console.print(Text.assemble((f"{head:<5} ", colour), text), soft_wrap=True)
        return
    grid = Table.grid(padding=(0, 1, 0, 0))
    grid.add_column(width=5, no_wrap=True)
    grid.add_column(overflow="fold")
    grid.add_row(Text(head, colour), Text(text))
    console.print(grid)


def _matters(entry: RoleReport) -> bool:
    """Return whether a role is a problem, or one that nothing works without."""
    if entry.need == "optional":
        return bool(entry.hint) or entry.verdict == "elsewhere"
    return True


def _table(console: Console, entries: list[RoleReport], verbose: bool) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    columns = COLUMNS if console.width >= _WIDE else NARROW
    for name in columns:
        words = name in ("role", "need", "expected as", "verdict", "range")
        table.add_column(
            name,
            justify="left" if words else "right",
            no_wrap=name in ("role", "verdict"),
            overflow="fold",
        )
    for entry in entries:
        for row in _rows(entry, verbose or entry.verdict != "ok"):
            # names are the user's: as text, since a bracket in one is no markup
            table.add_row(*(Text.assemble(row.get(name, "")) for name in columns))
    console.print(table)


def _rows(entry: RoleReport, everyone: bool) -> Iterator[dict[str, str | Text]]:
    """Yield the rows of one role: as the config expects it, then, for ``everyone``, whoever else sends it."""
    from rich.text import Text

    # there may be another way to the ratio
    mild = entry.need in ("optional", "ratio") or entry.verdict == "several"
    colour = "green" if entry.verdict == "ok" else "yellow" if mild else "red"
    expected = entry.expected + (f" @0x{entry.source:02X}" if entry.source is not None else "")
    unit = f" {entry.unit}" if entry.unit else ""
    head: dict[str, str | Text] = {
        "role": entry.role,
        "need": entry.need,
        "expected as": expected,
        "verdict": Text(entry.verdict, colour),
        "range": "" if entry.low is None else f"{entry.low:.4g} .. {entry.high:.4g}{unit}",
    }
    # an 11-bit identifier has no address, nor has a column of a table
    without_address = "table" if entry.from_table else "its id"
    mine = [s for s in entry.senders if entry.source in (None, s.address)]
    others = [s for s in entry.senders if s not in mine] if everyone else []
    if not mine:
        yield head | {"from": "-"}
    for index, sender in enumerate([*mine, *others]):
        first = bool(mine) and index == 0
        yield (head if first else {"verdict": Text("also", "dim")}) | {
            **_range(entry, sender, first),
            "from": f"0x{sender.address:02X}" if sender.address is not None else without_address,
            "rate Hz": "" if sender.rate_hz is None else f"{sender.rate_hz:.1f}",
            "values": f"{sender.valid:,}" if sender.valid else "",
            "n/a": f"{sender.not_available:,}" if sender.not_available else "",
            "error": f"{sender.error_value:,}" if sender.error_value else "",
        }


def _range(entry: RoleReport, sender: Sender, first: bool) -> dict[str, str]:
    """Return a sender's own range, where it is known: not that of another beside its address."""
    unit = f" {entry.unit}" if entry.unit else ""
    if sender.low is not None:
        return {"range": f"{sender.low:.4g} .. {sender.high:.4g}{unit}"}
    return {} if first else {"range": ""}


def _labels(entry: RoleReport, verbose: bool) -> str:
    """Return what a role's raw numbers or texts are called, how often they came and what they count as."""
    shown = entry.labels if verbose else entry.labels[:_LABELS]
    parts = []
    for label in shown:
        name = repr(label.label) if label.label == label.raw else f"{label.raw} {label.label}".strip()
        value = "no value" if label.value is None else f"{label.value:g}"
        parts.append(f"{name} is {value} ({label.count:,} times)")
    left = len(entry.labels) - len(shown)
    return f"{entry.role}: " + ", ".join(parts) + (f" and {left} more" if left else "")
