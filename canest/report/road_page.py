"""The page of a road map: its cells on a plane, coloured by grade, with what each is known by."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.report.figure import Rows, numbers
from canest.report.page import Card, Page, Section, Table
from canest.road.sphere import EARTH_RADIUS_M
from canest.road.table import RoadMap

#: cells drawn at most: a browser slows down beyond
CELLS_MAX = 30_000
#: uphill red, downhill blue, level pale: a scale that colour-blind readers can read
_COLOURS = [[0.0, "#0b3c8c"], [0.25, "#4f8fd6"], [0.5, "#d9d9d4"], [0.75, "#e08a3c"], [1.0, "#9c1a1a"]]
_STEEP_PCT = 6.0


def road_page(road: RoadMap, name: str) -> Page:
    """Return the page of a map. name: shown in the title."""
    every = max(1, -(-len(road) // CELLS_MAX))
    thinned = f" Every {every}th cell is drawn." if every > 1 else ""
    std = np.degrees(np.median(road.grade_std)) if len(road) else float("nan")
    passes = np.median(road.passes) if len(road) else 0.0
    page = Page(
        title=f"canest map · {name}",
        headline=f"{len(road):,} cells, {len(road) * 0.025:,.1f} km by direction",
        cards=[
            Card("Grade", f"± {std:.3f}°", "one standard deviation, median"),
            Card("Passes per cell", f"{passes:,.0f}", "median"),
            Card("Vehicles", f"{road.vehicles.max() if len(road) else 0:,}", "at most per cell"),
            Card("Newest drive", _day(np.nanmax(road.last_day)) if np.isfinite(road.last_day).any() else "-"),
        ],
    )
    if len(road):
        text = (
            "Each dot is 25 m of road in one direction, red where it climbs and blue where it falls."
            + thinned
        )
        page.sections.append(Section("Grade", text=text, figure=_figure(road, every).to_json()))
    rows = [[what, f"{count:,}"] for what, count in road.counts.items()]
    page.sections.append(Section("What it was built from", table=Table(["what", "count"], rows)))
    return page


def _figure(road: RoadMap, every: int) -> Rows:
    """Draw cells by distance from their middle, east and north."""
    part = slice(None, None, every)
    latitude, longitude = road.latitude_deg[part], road.longitude_deg[part]
    middle_lat, middle_lon = float(np.median(latitude)), float(np.median(longitude))
    north_km = np.radians(latitude - middle_lat) * EARTH_RADIUS_M / 1e3
    turned = (longitude - middle_lon + 180.0) % 360.0 - 180.0
    east_km = np.radians(turned) * np.cos(np.radians(middle_lat)) * EARTH_RADIUS_M / 1e3
    rows = Rows([f"north of {middle_lat:.4f}°, km"], [3.6], f"east of {middle_lon:.4f}°, km")
    rows.layout["hovermode"] = "closest"
    rows.axis(1).update({"scaleanchor": "x", "scaleratio": 1})
    grade_pct = 100.0 * road.grade[part]
    rows.traces.append({
        "type": "scatter", "mode": "markers", "name": "grade", "x": numbers(east_km, 4), "xaxis": "x",
        "y": numbers(north_km, 4), "yaxis": "y", "showlegend": False,
        "marker": {
            "size": 6, "color": numbers(grade_pct, 3), "colorscale": _COLOURS, "cmin": -_STEEP_PCT,
            "cmax": _STEEP_PCT, "colorbar": {"title": {"text": "grade, %"}, "thickness": 14},
        },
        "text": _texts(road, part, grade_pct), "hovertemplate": "%{text}<extra></extra>",
    })  # fmt: skip
    return rows


def _texts(road: RoadMap, part: slice, grade_pct: FloatColumn) -> list[str]:
    columns = zip(
        grade_pct, 100.0 * road.grade_std[part], road.passes[part], road.vehicles[part],
        road.heading_deg[part], road.last_day[part], strict=True,
    )  # fmt: skip
    return [
        f"{grade:+.2f} ± {std:.2f} %<br>{passes} passes, {vehicles} vehicles<br>heading {heading:.0f}°, "
        f"newest {_day(day)}"
        for grade, std, passes, vehicles, heading, day in columns
    ]


def _day(day: Any) -> str:
    """Return a day since 1970 as a date, '-' for none."""
    if not np.isfinite(day):
        return "-"
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=float(day))).date().isoformat()
