"""The pages about a fleet: what stands on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.report import figure as look
from canest.report.figure import Rows, numbers
from canest.report.page import Bar, Card, Column, Page, Section, Table, cells, titles, value_text

#: points of a figure at most; of more trips every second, third ... is drawn
POINTS_MAX = 2000
TRIPS_SHOWN = 50
_DAY_US = 86_400e6

_FLEET_COLUMNS: tuple[Column, ...] = (
    Column("logs", "logs", ",.0f"),
    Column("trips", "trips", ",.0f"),
    Column("km", "km", ",.0f"),
    Column("hours", "hours driven", ",.1f"),
    Column("valid_share", "valid %", ".0f"),
    Column("light_kg", "5 % lighter than, kg", ",.0f"),
    Column("mass_kg", "median mass kg", ",.0f"),
    Column("heavy_kg", "5 % heavier than, kg", ",.0f"),
    Column("residual_pct", "residual % of traction", "+.2f"),
    Column("trend_pct", "trend per 100 days", "+.2f"),
    Column("last", "last trip"),
)
_TRIP_COLUMNS: tuple[Column, ...] = (
    Column("start", "start UTC"),
    Column("distance_m", "km", ",.1f"),
    Column("duration_s", "minutes", ",.0f"),
    Column("climb_m", "climb m", ",.0f"),
    Column("stops", "stops", ",.0f"),
    Column("mass_kg", "mass kg", ",.0f"),
    Column("mass_std_kg", "std kg", ",.0f"),
    Column("reported_mass_kg", "reported kg", ",.0f"),
    Column("valid_share", "valid %", ".0f"),
    Column("torque_residual_pct", "residual %", "+.2f"),
    Column("reason", "why not valid"),
)
_FACTORS = {"distance_m": 1e-3, "duration_s": 1 / 60, "valid_share": 100.0}


def fleet_page(
    lake: str,
    vehicles: Sequence[Mapping[str, Any]],
    masses: Sequence[tuple[int, int]],
    links: dict[str, str],
) -> Page:
    """Return the index. masses: (t, trips) of 5 t each. links: vehicle -> its page."""
    driven_h = sum(row["hours"] for row in vehicles)
    valid = sum(row["valid_share"] * row["hours"] for row in vehicles) / driven_h if driven_h else 0.0
    page = Page(
        title=f"canest fleet · {lake}",
        headline=f"{len(vehicles):,} vehicles, {sum(row['trips'] for row in vehicles):,} trips",
        cards=[
            Card("Logs", f"{sum(row['logs'] for row in vehicles):,}"),
            Card("Distance", f"{sum(row['km'] for row in vehicles):,.0f} km"),
            Card("Driving", f"{driven_h:,.0f} h"),
            Card("Mass valid", f"{100 * valid:.0f} %", "of the driving time"),
        ],
    )
    if masses:
        trips = sum(count for _, count in masses)
        bars = [Bar(f"{t} to {t + 5} t", count / trips, look.BLUE) for t, count in masses]
        page.sections.append(Section("Masses", text="Share of the trips with a valid mass.", bars=bars))
    header = ["vehicle", *titles(_FLEET_COLUMNS)]
    rows = [[str(row["vehicle"]), *cells(row, _FLEET_COLUMNS, _FACTORS)] for row in vehicles]
    text = (
        "The residual is the part of the traction that the acceleration does not show, with the mass and the "
        "grade that were estimated. A vehicle whose residual drifts has changed: tyres, brakes, injectors."
    )
    page.sections.append(
        Section(
            "Vehicles", text=text, table=Table(header, rows, links=[links.get(row[0], "") for row in rows])
        )
    )
    return page


def vehicle_page(vehicle: Mapping[str, Any], trips: Any) -> Page:
    """Return the page of a vehicle. trips: Arrow table of its legs, in order of time."""
    page = Page(
        title=f"fleet · {vehicle['vehicle']}",
        headline=f"{vehicle['trips']:,} trips, {vehicle['km']:,.0f} km",
        cards=[
            Card("Mass valid", f"{100 * vehicle['valid_share']:.0f} %", "of the driving time"),
            Card("Median mass", value_text(vehicle["mass_kg"], ",.0f", " kg"), "of trips with a valid mass"),
            Card("Residual", value_text(vehicle["residual_pct"], "+.2f", " %"), "of the traction, median"),
            Card("Trend", value_text(vehicle["trend_pct"], "+.2f", " %"), "of the traction per 100 days"),
        ],
    )
    every = max(1, -(-len(trips) // POINTS_MAX))
    shown = trips if every == 1 else trips.take(np.arange(0, len(trips), every))
    dropped = f" Every {every}th trip is shown." if every > 1 else ""
    page.sections.append(
        Section(
            "Masses and residuals",
            text="Bars are two standard deviations. Hollow: a mass that was not valid." + dropped,
            figure=_figure(shown).to_json(),
        )
    )
    last = trips.slice(max(0, len(trips) - TRIPS_SHOWN)).to_pylist()[::-1]
    rows = [[f"{row['log']} · {row['leg']}", *cells(row, _TRIP_COLUMNS, _FACTORS)] for row in last]
    header = ["log · leg", *titles(_TRIP_COLUMNS)]
    text = f"The last {len(rows):,} trips. `canest fleet query` has them all."
    page.sections.append(Section("Trips", text=text, table=Table(header, rows, left=(0, 11))))
    return page


def _figure(trips: Any) -> Rows:
    """Draw masses and residuals over time; over the number of the trip where no trip has a date."""
    import pyarrow.compute as pc  # only a lake has such tables

    start = trips["start"].to_numpy()
    known = ~np.isnat(start)
    dated = bool(known.any())
    x: list[Any] = [*range(len(start))]
    if dated:
        x = np.datetime_as_string(start, "s").tolist()
        for at in np.flatnonzero(~known).tolist():
            x[at] = None
    rows = Rows(["mass, t", "residual, % of traction"], [1.3, 1.0], "UTC" if dated else "trip")
    valid = pc.equal(trips["status"], "valid").to_numpy()
    mass, std = _floats(trips, "mass_kg") / 1e3, _floats(trips, "mass_std_kg") / 1e3
    reported = _floats(trips, "reported_mass_kg") / 1e3
    for chosen, name, symbol in ((valid, "valid", "circle"), (~valid, "not valid", "circle-open")):
        rows.traces.append({
            "type": "scatter", "mode": "markers", "name": name, "x": x, "yaxis": "y", "xaxis": "x",
            "y": numbers(np.where(chosen, mass, np.nan), 3), "marker": {"symbol": symbol, "color": look.BLUE},
            "error_y": {"array": numbers(2 * std, 3), "thickness": 1, "width": 0,
                        "visible": name == "valid"},
            "hovertemplate": "%{y:.2f} t",
        })  # fmt: skip
    if np.isfinite(reported).any():
        rows.traces.append({
            "type": "scatter", "mode": "markers", "name": "reported by the vehicle", "x": x, "yaxis": "y",
            "xaxis": "x", "y": numbers(reported, 3), "marker": {"symbol": "x", "color": look.ORANGE},
            "hovertemplate": "%{y:.2f} t",
        })  # fmt: skip
    residual = np.where(valid, _floats(trips, "torque_residual_pct"), np.nan)
    rows.traces.append({
        "type": "scatter", "mode": "markers", "name": "residual", "x": x, "yaxis": "y2", "xaxis": "x2",
        "y": numbers(residual, 3), "marker": {"color": look.RED, "size": 5}, "hovertemplate": "%{y:.2f} %",
    })  # fmt: skip
    days = np.where(known, start.astype(np.int64) / _DAY_US, np.nan) if dated else np.arange(float(len(x)))
    line = _trend(days, residual)
    if line is not None:
        rows.line(2, x, numbers(line, 3), "trend", look.Stroke(look.INK, dash="dash"), hover="%{y:.2f} %")
    return rows


def _trend(x: FloatColumn, y: FloatColumn) -> FloatColumn | None:
    """Return a straight line through points (n,), None where there are too few."""
    known = np.isfinite(x) & np.isfinite(y)
    if np.count_nonzero(known) < 3 or np.ptp(x[known]) <= 0.0:
        return None
    middle = x[known].mean()
    slope, offset = np.polyfit(x[known] - middle, y[known], 1)
    return np.asarray(offset + slope * (x - middle))


def _floats(trips: Any, name: str) -> FloatColumn:
    return np.asarray(trips[name].to_numpy(), np.float64)
