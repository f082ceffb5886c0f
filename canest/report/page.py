"""Puts figures, cards and tables into one HTML file that needs no network."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from canest import __version__
from canest.core.errors import OutputError
from canest.report.palette import DARK, both
from canest.system.installation import how_to_add
from canest.system.result_files import write_result

#: the file that the reports of one directory share: plotly, and our own scripts after it
SCRIPT = "plotly.min.js"
_SCRIPTS = ("theme.js", "detail.js", "figure.js", "cursor.js", "table.js", "start.js")


@dataclass(slots=True)
class Card:
    """One figure that a reader looks for first. tone: "", "good", "warn" or "bad"."""

    label: str
    value: str
    note: str = ""
    tone: str = ""


@dataclass(slots=True)
class Table:
    """Rows of text. left: columns of words (the others are figures). marked: index of a row to stress.

    links: a page for the first cell of each row, '' for none. tones: of its last cell, as of `Card`.
    sortable: by a click on a title; a table of many rows can be searched too.
    """

    header: list[str]
    rows: list[list[str]]
    marked: int | None = None
    left: tuple[int, ...] = (0,)
    links: list[str] = field(default_factory=list)
    tones: list[str] = field(default_factory=list)
    sortable: bool = False


class Column(NamedTuple):
    """A column of a table of records: which key of theirs, its title and its format; "": as text."""

    key: str
    title: str
    form: str = ""


def titles(columns: Sequence[Column]) -> list[str]:
    """Return the header of a table of records."""
    return [column.title for column in columns]


def cells(
    record: Mapping[str, Any], columns: Sequence[Column], factors: Mapping[str, float] | None = None
) -> list[str]:
    """Return a record as a row of a table, '-' where it has no value; factors: of the keys that have one."""
    factors = factors or {}
    return [value_text(record[key], form, factor=factors.get(key, 1.0)) for key, _, form in columns]


def value_text(value: Any, form: str, unit: str = "", factor: float = 1.0) -> str:
    """Return a value as text: in a format of numbers, or to the minute where it is a time."""
    if value is None or value != value:  # noqa: PLR0124 - NaN
        return "-"
    if not form:
        return str(value)[:16] if hasattr(value, "isoformat") else str(value)
    return format(value * factor, form) + unit


class Bar(NamedTuple):
    """One bar: share (0..1) of the whole width, and what is written beside it ("": the share in per cent)."""

    label: str
    share: float
    colour: str
    text: str = ""


@dataclass(slots=True)
class Section:
    """A heading with what stands below it; every part may be missing. listing: folded text of a file."""

    title: str
    text: str = ""
    figure: str = ""
    table: Table | None = None
    bars: list[Bar] = field(default_factory=list)
    listing: str = ""


@dataclass(slots=True)
class Page:
    """A whole report: one sentence first, then cards, then sections.

    home, home_text: page above this one, and what leads to it is called.
    """

    title: str
    headline: str
    facts: list[tuple[str, str]] = field(default_factory=list)
    cards: list[Card] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    home: str = ""
    home_text: str = ""

    def write(self, path: str | Path, script_file: str = "") -> None:
        """Write the file. Errors: OutputError (cannot write, extra `report` not installed)."""
        write_result(path, self.render(str(path), script_file))

    def render(self, where: str = "report", script_file: str = "") -> str:
        """Return the HTML. Errors: OutputError when the extra `report` is not installed.

        script_file: the file beside the page that has all JavaScript (`write_scripts`), '' to put it into it.
        """
        require_packages(where)
        drawn = any(section.figure for section in self.sections)
        script = "" if drawn and script_file else scripts() if drawn else own_script()
        html: str = _template().render({
            "page": self, "version": __version__, "drawn": drawn, "both": both, "palette": json.dumps(DARK),
            "style": _asset("page.css"), "rows_html": rows_html,
            "script_file": "" if script else script_file, "script": script,
        })  # fmt: skip
        return html


def rows_html(table: Table) -> str:
    """Return the rows of a table as HTML. A page may have thousands: a template takes ten times as long."""
    lines = []
    for number, row in enumerate(table.rows):
        tone = table.tones[number] if table.tones else ""
        link = table.links[number] if table.links else ""
        cells_ = [escape(cell) for cell in row]
        if link and cells_:
            cells_[0] = f'<a href="{quote(link, errors="surrogateescape")}">{cells_[0]}</a>'
        kinds = ["left" if column in table.left else "" for column in range(len(row))]
        if tone and kinds:
            kinds[-1] = f"{kinds[-1]} {tone}".strip()
        html = "".join(
            f'<td class="{kind}">{cell}</td>' if kind else f"<td>{cell}</td>"
            for kind, cell in zip(kinds, cells_, strict=True)
        )
        mark = ' class="marked"' if number == table.marked else ""
        lines.append(f"<tr{mark}>{html}</tr>")
    return "\n".join(lines)


def write_scripts(directory: Path) -> str:
    """Write what the pages of a directory share; return the name for `Page.render`. Errors: OutputError."""
    require_packages(directory)
    write_result(directory / SCRIPT, scripts())
    return SCRIPT


def scripts() -> str:
    """Return the JavaScript of a page with figures: plotly's and our own."""
    plotly = files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
    return f"{plotly}\n;\n{own_script()}"


def own_script() -> str:
    """Return the pages' own JavaScript."""
    return "\n".join(_asset(name) for name in _SCRIPTS)


@cache
def _asset(name: str) -> str:
    return files("canest.report").joinpath("assets", name).read_text(encoding="utf-8")


@cache
def _template() -> Any:
    import jinja2

    source = files("canest.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)


def require_packages(where: str | Path) -> None:
    """Refuse before any work is done. Errors: OutputError when the extra `report` is not installed."""
    for package in ("jinja2", "plotly"):
        try:
            found = find_spec(package) is not None
        except ValueError:  # Python's error for a module that is blocked
            found = False
        if not found:
            raise OutputError(
                "cannot write a report",
                where=str(where),
                expected=f"plotly and jinja2: {how_to_add('report')}",
            )
