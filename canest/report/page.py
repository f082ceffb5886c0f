"""Puts figures, cards and tables into one HTML file that needs no network."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from canest import __version__
from canest.core.errors import OutputError
from canest.system.installation import how_to_add
from canest.system.result_files import write_result


@dataclass(slots=True)
class Card:
    """One figure that a reader looks for first. tone: "", "good", "warn" or "bad"."""

    label: str
    value: str
    note: str = ""
    tone: str = ""


@dataclass(slots=True)
class Table:
    """Rows of text. left: columns of words (the others are figures). marked: index of a row to stress."""

    header: list[str]
    rows: list[list[str]]
    marked: int | None = None
    left: tuple[int, ...] = (0,)
    links: list[str] = field(default_factory=list)  #: a page for the first cell of each row, '' for none


class Bar(NamedTuple):
    """One bar: share (0..1) of the whole width, and what is written beside it ("": the share in per cent)."""

    label: str
    share: float
    colour: str
    text: str = ""


@dataclass(slots=True)
class Section:
    """A heading with what stands below it; every part may be missing."""

    title: str
    text: str = ""
    figure: str = ""
    table: Table | None = None
    bars: list[Bar] = field(default_factory=list)


@dataclass(slots=True)
class Page:
    """A whole report: one sentence first, then cards, then sections.

    home: page that the title leads to.
    """

    title: str
    headline: str
    facts: list[tuple[str, str]] = field(default_factory=list)
    cards: list[Card] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    home: str = ""

    def write(self, path: str | Path, script_file: str = "") -> None:
        """Write the file. Errors: OutputError (cannot write, extra `report` not installed)."""
        write_result(path, self.render(str(path), script_file))

    def render(self, where: str = "report", script_file: str = "") -> str:
        """Return the HTML. Errors: OutputError when the extra `report` is not installed.

        script_file: name of the file beside the page that has plotly, '' to put it into the page.
        """
        require_packages(where)
        drawn = any(section.figure for section in self.sections)
        script = plotly_script() if drawn and not script_file else ""
        values: dict[str, Any] = {"page": self, "version": __version__, "script": script}
        values["script_file"] = script_file if drawn else ""
        html: str = _template().render(values)
        return html


def plotly_script() -> str:
    """Return plotly's JavaScript, for pages that share it as a file too."""
    return files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")


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
