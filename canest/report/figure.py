"""Small builder of plotly figures as plain JSON: rows above each other with one time axis."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.report.palette import BLUE, GREEN, GRID, GROUND, INK, MUTED, ORANGE, RED, VIOLET

__all__ = [
    "BLUE", "FONT", "GREEN", "GRID", "INK", "MUTED", "ORANGE", "RED", "SERIES", "VIOLET", "Rows", "Stroke",
    "numbers", "with_gaps",
]  # fmt: skip

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
#: colours that colour-blind readers can distinguish too (Okabe and Ito 2008, darkened where too light)
SERIES = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7c3aed", "#8c510a",
    "#475569", "#dc2626", "#65a30d", "#0e7490", "#be185d", "#4338ca", "#a16207",
)  # fmt: skip

Column = NDArray[Any]


def numbers(values: Column, digits: int) -> list[float | None]:
    """Return JSON numbers rounded to ``digits`` decimals, null for what is no number."""
    rounded = np.round(np.asarray(values, np.float64), digits)
    listed: list[float | None] = rounded.tolist()
    for at in np.flatnonzero(~np.isfinite(rounded)).tolist():
        listed[at] = None
    return listed


def with_gaps(stamps: Column, columns: Mapping[str, Column]) -> tuple[Column, dict[str, Column]]:
    """Return stamps and columns, (n,) each, with a NaN where a curve is to break.

    That is where more than five points are missing, and where the clock was set back.
    """
    steps = np.diff(stamps)
    usual = np.median(steps) if len(steps) > 1 else math.inf
    breaks = np.flatnonzero((steps > 5 * usual) | (steps < 0)) + 1
    broken = {name: np.insert(column, breaks, np.nan) for name, column in columns.items()}
    return np.insert(stamps, breaks, stamps[breaks - 1]), broken


class Stroke(NamedTuple):
    """How a curve is drawn: ``shape`` "linear" from point to point, or "hv" in steps."""

    colour: str
    width: float = 1.6
    dash: str = "solid"
    shape: str = "linear"


class Rows:
    """Axes above each other that share the time axis.

    titles, weights: one per row, from the top; weights are relative heights.
    """

    GAP = 0.028

    def __init__(self, titles: Sequence[str], weights: Sequence[float], x_title: str) -> None:
        self.traces: list[dict[str, Any]] = []
        self.linked: dict[str, Any] = {}  #: what makes one cursor of all rows: see `link`
        self.layout: dict[str, Any] = {
            "margin": {"l": 64, "r": 14, "t": 8, "b": 48},
            "paper_bgcolor": GROUND,
            "plot_bgcolor": GROUND,
            "font": {"family": FONT, "size": 12, "color": INK},
            "hovermode": "x unified",
            "hoverlabel": {"namelength": -1, "font": {"size": 11}},
            "dragmode": "zoom",
            "height": 60 + int(170 * sum(weights)),
        }
        total = sum(weights)
        top = 1.0
        room = 1.0 - self.GAP * (len(weights) - 1)
        for index, (title, weight) in enumerate(zip(titles, weights, strict=True), 1):
            bottom = top - room * weight / total
            key = str(index) if index > 1 else ""
            last = index == len(titles)
            self.layout[f"yaxis{key}"] = {
                "domain": [max(bottom, 0.0), top],
                "anchor": f"x{key}",
                "title": {"text": title, "font": {"size": 12}, "standoff": 8},
                "gridcolor": GRID,
                "zeroline": False,
                "automargin": False,
                "ticks": "outside",
                "tickcolor": GROUND,
                "exponentformat": "none",
                "separatethousands": True,
            }
            self.layout[f"xaxis{key}"] = {
                "anchor": f"y{key}",
                "gridcolor": GRID,
                "zeroline": False,
                "exponentformat": "none",
                "separatethousands": True,
                "showticklabels": last,
                **({"title": {"text": x_title, "standoff": 8}} if last else {}),
                **({} if index == 1 else {"matches": "x"}),
            }
            top = bottom - self.GAP
        self.rows = len(titles)

    def axis(self, row: int) -> dict[str, Any]:
        """Return the y axis of a row (from 1) for adjustment."""
        axis: dict[str, Any] = self.layout[f"yaxis{row if row > 1 else ''}"]
        return axis

    def line(
        self,
        row: int,
        x: list[float | None],
        y: list[float | None],
        name: str,
        stroke: Stroke,
        *,
        hover: str = "%{y}",
        legend: bool = True,
    ) -> None:
        """Draw a curve; those of one name are shown and hidden together."""
        self.traces.append({
            "type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "connectgaps": False,
            "line": {
                "color": stroke.colour, "width": stroke.width, "dash": stroke.dash, "shape": stroke.shape,
            },
            "hovertemplate": hover, "showlegend": legend, "legendgroup": name, **self._at(row),
        })  # fmt: skip

    def band(
        self,
        row: int,
        x: list[float | None],
        low: list[float | None],
        high: list[float | None],
        colour: str,
        group: str,
    ) -> None:
        """Shade between two curves (no hover, no legend of its own)."""
        common = {
            "type": "scatter", "mode": "lines", "x": x, "hoverinfo": "skip", "showlegend": False,
            "legendgroup": group, "line": {"width": 0, "color": colour}, **self._at(row),
        }  # fmt: skip
        self.traces.append({**common, "y": low})
        self.traces.append({**common, "y": high, "fill": "tonexty", "fillcolor": _pale(colour, 0.18)})

    def link(self, x: list[float | None], distance_km: Column, valid: Column, **more: Any) -> None:
        """Give all rows one cursor, y axes that follow a zoom, and distance as the other x axis.

        x: s, of the curves, (n,). distance_km, valid: at the same points. more: see ``assets/figure.js``.
        """
        known = np.where(np.isfinite(distance_km), np.asarray(distance_km, np.float64), 0.0)
        self.linked = {
            "x": x,
            "distance_km": numbers(np.maximum.accumulate(known), 4),
            "valid": "".join("1" if yes else "0" for yes in np.asarray(valid).tolist()),
            **more,
        }
        for row in range(1, self.rows + 1):
            self.axis(row)["fixedrange"] = True

    def follow(self, column: str, factor: float, times_std: float = 0.0, std: str = "") -> None:
        """State which column of the detail the last curve is: factor (column + times_std std)."""
        self.traces[-1]["meta"] = {"column": column, "factor": factor, "times": times_std, "std": std}

    def spans(self, spans: Sequence[tuple[float, float]], name: str, colour: str) -> None:
        """Shade stretches of time over all rows."""
        x: list[float | None] = []
        y: list[float | None] = []
        for first, end in spans:
            x += [first, first, end, end, None]
            y += [0, 1, 1, 0, None]
        for row in range(1, self.rows + 1):
            under = self._under(row)
            self.traces.insert(0, {
                "type": "scatter", "mode": "lines", "x": x, "y": y, **self._at(row), "yaxis": under,
                "fill": "toself", "fillcolor": _pale(colour, 0.20), "line": {"width": 0}, "name": name,
                "hoverinfo": "skip", "legendgroup": name, "showlegend": row == 1,
            })  # fmt: skip

    def _under(self, row: int) -> str:
        """Return the axis 0..1 that lies over a row for shading."""
        number = 50 + row
        self.layout.setdefault(f"yaxis{number}", {
            "overlaying": self._at(row)["yaxis"], "anchor": self._at(row)["xaxis"], "range": [0, 1],
            "visible": False, "fixedrange": True,
        })  # fmt: skip
        return f"y{number}"

    def _mark_empty_rows(self) -> None:
        """Write into rows without a single value that there is none; their scale would mean nothing."""
        filled = {trace["yaxis"] for trace in self.traces if any(y is not None for y in trace["y"])}
        notes: list[dict[str, Any]] = []
        self.layout["annotations"] = notes
        for row in range(1, self.rows + 1):
            if self._at(row)["yaxis"] in filled:
                continue
            axis = self.axis(row)
            axis["showticklabels"] = axis["showgrid"] = False
            notes.append({
                "text": "no values", "showarrow": False, "font": {"color": MUTED}, "xref": "paper", "x": 0.5,
                "yref": "paper", "y": sum(axis["domain"]) / 2, "yanchor": "middle",
            })  # fmt: skip

    def _at(self, row: int) -> dict[str, str]:
        key = str(row) if row > 1 else ""
        return {"xaxis": f"x{key}", "yaxis": f"y{key}"}

    def to_json(self) -> str:
        """Return the figure as JSON that may stand inside a script element (see `page.html.j2`)."""
        # curves over one time axis share it: written once, named by its place in `shared`
        self._mark_empty_rows()
        shared: list[Any] = []
        places: dict[int, int] = {}
        data = []
        for trace in self.traces:
            x = trace["x"]
            if id(x) not in places:
                places[id(x)] = len(shared)
                shared.append(x)
            data.append({**trace, "x": places[id(x)]})
        figure: dict[str, Any] = {"data": data, "layout": self.layout, "shared": shared}
        if self.linked:
            figure["linked"] = {**self.linked, "x": places[id(self.linked["x"])]}
        text = json.dumps(figure, separators=(",", ":"), allow_nan=False)
        return text.replace("</", "<\\/")


def _pale(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
