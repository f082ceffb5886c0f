"""Figures side by side, each with its own axes: what a quantity depends on."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.report.figure import FONT, numbers
from canest.report.palette import GRID, GROUND, INK, MUTED

_ROW_PX, _GAP_X, _GAP_Y_PX = 250, 0.075, 78


class Panels:
    """A grid of small plots, filled row by row; `y_title` stands at the left ones."""

    def __init__(self, titles: list[str], y_title: str, columns: int = 3) -> None:
        self.traces: list[dict[str, Any]] = []
        columns = min(columns, len(titles))
        rows = math.ceil(len(titles) / columns)
        height = rows * _ROW_PX + (rows - 1) * _GAP_Y_PX
        self.layout: dict[str, Any] = {
            "margin": {"l": 74, "r": 24, "t": 40, "b": 56},
            "paper_bgcolor": GROUND, "plot_bgcolor": GROUND,
            "font": {"family": FONT, "size": 12, "color": INK},
            "hoverlabel": {"namelength": -1}, "height": height + 96,
        }  # fmt: skip
        width = (1.0 - _GAP_X * (columns - 1)) / columns
        tall, gap = _ROW_PX / height, _GAP_Y_PX / height
        for i, title in enumerate(titles):
            row, column = divmod(i, columns)
            key = self._key(i)
            left, top = column * (width + _GAP_X), 1.0 - row * (tall + gap)
            common = {"gridcolor": GRID, "zerolinecolor": MUTED, "separatethousands": True,
                      "exponentformat": "none"}  # fmt: skip
            self.layout[f"xaxis{key}"] = {
                "domain": [left, min(left + width, 1.0)], "anchor": f"y{key}", **common, "zeroline": False,
                "title": {"text": title, "standoff": 6},
            }  # fmt: skip
            self.layout[f"yaxis{key}"] = {
                "domain": [max(top - tall, 0.0), top], "anchor": f"x{key}", **common,
                **({"title": {"text": y_title, "standoff": 6}} if column == 0 else {}),
            }  # fmt: skip

    def points(
        self,
        panel: int,
        x: FloatColumn,
        y: FloatColumn,
        name: str,
        colour: str,
        *,
        spread: FloatColumn | None = None,
        cloud: bool = False,
    ) -> None:
        """Draw points in a panel (from 0): a pale cloud, or joined points with error bars of 2 `spread`."""
        trace: dict[str, Any] = {
            "type": "scatter", "x": numbers(x, 5), "y": numbers(y, 1), "name": name, "legendgroup": name,
            "mode": "markers" if cloud else "lines+markers", "xaxis": f"x{self._key(panel)}",
            "yaxis": f"y{self._key(panel)}", "showlegend": panel == 0 and not cloud,
            "marker": {"color": colour, "size": 3 if cloud else 7, "opacity": 0.25 if cloud else 1.0},
            "line": {"color": colour, "width": 1.6}, "hoverinfo": "skip" if cloud else "x+y+name",
        }  # fmt: skip
        if spread is not None:
            bars = numbers(2.0 * np.nan_to_num(spread), 1)
            trace["error_y"] = {"array": bars, "color": colour, "thickness": 1, "width": 2}
        self.traces.append(trace)

    def axis(self, panel: int, which: str) -> dict[str, Any]:
        """Return the `x` or `y` axis of a panel for adjustment."""
        axis: dict[str, Any] = self.layout[f"{which}axis{self._key(panel)}"]
        return axis

    def to_json(self) -> str:
        """Return the figure as JSON that may stand inside a script element."""
        figure = {"data": self.traces, "layout": self.layout}
        return json.dumps(figure, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")

    def _key(self, panel: int) -> str:
        return str(panel + 1) if panel else ""
