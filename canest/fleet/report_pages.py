"""The pages about a fleet: what stands on them."""

from __future__ import annotations

import math
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

#: a trend of fewer trips or days says nothing; one within so many standard deviations may be chance
TREND_TRIPS, TREND_DAYS, TREND_STDS = 10, 14, 4.0
#: vehicles that are named first, at most
NAMED_FIRST = 20

_FLEET_COLUMNS: tuple[Column, ...] = (
    Column("logs", "logs", ",.0f"),
    Column("trips", "trips", ",.0f"),
    Column("km", "km", ",.0f"),
    Column("hours", "hours driven", ",.1f"),
    Column("valid_share", "mass valid, % of time", ".0f"),
    Column("light_kg", "lightest 5 %, t", ".1f"),
    Column("mass_kg", "median mass, t", ".1f"),
    Column("heavy_kg", "heaviest 5 %, t", ".1f"),
    Column("residual_pct", "residual, %", "+.1f"),
    Column("trend_text", "its change in 100 days, %"),
    Column("first", "first trip, UTC"),
    Column("last", "last trip, UTC"),
)
_TRIP_COLUMNS: tuple[Column, ...] = (
    Column("start", "start, UTC"),
    Column("distance_m", "km", ",.1f"),
    Column("duration_s", "minutes", ",.0f"),
    Column("climb_m", "climb, m", ",.0f"),
    Column("stops", "stops", ",.0f"),
    Column("mass_kg", "mass, kg", ",.0f"),
    Column("mass_std_kg", "std, kg", ",.0f"),
    Column("reported_mass_kg", "reported by the vehicle, kg", ",.0f"),
    Column("valid_share", "mass valid, %", ".0f"),
    Column("torque_residual_pct", "residual, %", "+.1f"),
    Column("reason", "why not valid"),
)
_FACTORS = {"distance_m": 1e-3, "duration_s": 1 / 60, "valid_share": 100.0}
_FLEET_FACTORS = {"valid_share": 100.0, "light_kg": 1e-3, "mass_kg": 1e-3, "heavy_kg": 1e-3}
_RESIDUAL = (
    "The residual is by how much the motion shows more traction than was reported, or less, with the mass "
    "and the grade that were estimated, in percent. Where it changes, the vehicle has changed: tyres, "
    "brakes, engine, or how it is configured."
)


def trend_std(vehicle: Mapping[str, Any]) -> dict[str, Any]:
    """Return the standard deviation of a vehicle's trend, the trend as text, and whether it is no chance."""
    n, slope = vehicle["n"] or 0, vehicle["trend_pct"]
    short = n < TREND_TRIPS or (vehicle["last"] - vehicle["first"]).days < TREND_DAYS
    if short or slope is None or not vehicle["sxx"]:
        return {"trend_std_pct": None, "trend_text": "-", "drifts": False}
    rest = max(vehicle["syy"] - slope * slope * vehicle["sxx"], 0.0)
    std = math.sqrt(rest / (n - 2) / vehicle["sxx"])
    return {
        "trend_std_pct": std,
        "trend_text": f"{slope:+.1f} ± {std:.1f}",
        "drifts": abs(slope) > TREND_STDS * std,
    }


def fleet_page(
    lake: str,
    vehicles: Sequence[Mapping[str, Any]],
    masses: Sequence[tuple[int, int]],
    links: dict[str, str],
) -> Page:
    """Return the index. masses: (t, trips) of 5 t each. links: vehicle -> its page."""
    driven_h = sum(row["hours"] for row in vehicles)
    valid = sum(row["valid_share"] * row["hours"] for row in vehicles) / driven_h if driven_h else 0.0
    days = [row[end] for row in vehicles for end in ("first", "last") if row[end] is not None]
    page = Page(
        title=f"canest fleet · {lake}",
        headline=f"{len(vehicles):,} vehicles, {sum(row['trips'] for row in vehicles):,} trips",
        facts=[("from", min(days).date().isoformat()), ("to", max(days).date().isoformat())] if days else [],
        cards=[
            Card("Logs", f"{sum(row['logs'] for row in vehicles):,}"),
            Card("Distance", f"{sum(row['km'] for row in vehicles):,.0f} km"),
            Card("Driving", f"{driven_h:,.0f} h"),
            Card("Mass valid", f"{100 * valid:.0f} %", "of the driving time"),
        ],
    )
    named = _named_first(vehicles)
    if named:
        more = f" The first {NAMED_FIRST} of {len(named):,}." if len(named) > NAMED_FIRST else ""
        rows = [[str(row["vehicle"]), text] for row, text in named[:NAMED_FIRST]]
        table = Table(["vehicle", "why"], rows, left=(0, 1), links=[links.get(row[0], "") for row in rows])
        text = f"Vehicles that have changed, or whose mass was never valid.{more}"
        page.sections.append(Section("Look at these first", text=text, table=table))
    header = ["vehicle", *titles(_FLEET_COLUMNS)]
    rows = [[str(row["vehicle"]), *cells(row, _FLEET_COLUMNS, _FLEET_FACTORS)] for row in vehicles]
    links_ = [links.get(row[0], "") for row in rows]
    text = f"A click on a title sorts. Masses are of trips with a valid mass. {_RESIDUAL}"
    table = Table(header, rows, links=links_, sortable=True)
    page.sections.append(Section("Vehicles", text=text, table=table))
    if masses:
        trips = sum(count for _, count in masses)
        bars = [Bar(f"{t} to {t + 5} t", count / trips, look.BLUE) for t, count in masses]
        text = "Share of the trips with a valid mass."
        page.sections.append(Section("Masses of the fleet", text=text, bars=bars))
    return page


def _named_first(vehicles: Sequence[Mapping[str, Any]]) -> list[tuple[Mapping[str, Any], str]]:
    """Return vehicles with a reason to look at them, the surest change first."""
    drifting = [row for row in vehicles if row["drifts"]]
    drifting.sort(key=lambda row: -abs(row["trend_pct"] / max(row["trend_std_pct"], 1e-9)))
    silent = [row for row in vehicles if row["mass_kg"] is None and row["trips"]]
    silent.sort(key=lambda row: -row["hours"])
    found = [(row, f"the residual changes by {row['trend_text']} % in 100 days") for row in drifting]
    return found + [(row, f"no valid mass: {row['reason'] or 'no reason known'}") for row in silent]


def vehicle_page(vehicle: Mapping[str, Any], trips: Any) -> Page:
    """Return the page of a vehicle. trips: Arrow table of its legs, in order of time."""
    trend = "of the traction in 100 days" + ("" if vehicle["n"] else "; no dates")
    page = Page(
        title=str(vehicle["vehicle"]),
        headline=f"{vehicle['vehicle']}: {vehicle['trips']:,} trips, {vehicle['km']:,.0f} km",
        cards=[
            Card("Mass valid", f"{100 * vehicle['valid_share']:.0f} %", "of the driving time"),
            Card("Median mass", value_text(vehicle["mass_kg"], ",.0f", " kg"), "of trips with a valid mass"),
            Card("Residual", value_text(vehicle["residual_pct"], "+.1f", " %"), "of the traction, median"),
            Card("Its change", f"{vehicle['trend_text']} %", trend, "warn" if vehicle["drifts"] else ""),
        ],
    )
    every = max(1, -(-len(trips) // POINTS_MAX))
    shown = trips if every == 1 else trips.take(np.arange(0, len(trips), every))
    dropped = f" Every {every}th trip is shown." if every > 1 else ""
    figure = _figure(shown, has_trend=vehicle["trend_std_pct"] is not None)
    text = f"Bars are two standard deviations. Hollow: a mass that was not valid.{dropped} {_RESIDUAL}"
    page.sections.append(Section("Masses and residuals", text=text, figure=figure.to_json()))
    last = trips.slice(max(0, len(trips) - TRIPS_SHOWN)).to_pylist()[::-1]
    rows = [[f"{row['log']} · {row['leg']}", *cells(row, _TRIP_COLUMNS, _FACTORS)] for row in last]
    header = ["log · leg", *titles(_TRIP_COLUMNS)]
    total = f"The last {len(rows):,} of {len(trips):,} trips" if len(rows) < len(trips) else "All trips"
    text = f"{total}, the newest first. A leg is the driving between two stops at which the load may change."
    page.sections.append(Section("Trips", text=text, table=Table(header, rows, left=(0, 11), sortable=True)))
    return page


def _figure(trips: Any, *, has_trend: bool) -> Rows:
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
    if has_trend:
        line = _line(np.where(known, start.astype(np.int64) / _DAY_US, np.nan), residual)
        rows.line(2, x, numbers(line, 3), "trend", look.Stroke(look.INK, dash="dash"), hover="%{y:.2f} %")
    return rows


def _line(x: FloatColumn, y: FloatColumn) -> FloatColumn:
    """Return a straight line through points (n,)."""
    known = np.isfinite(x) & np.isfinite(y)
    middle = x[known].mean()
    slope, offset = np.polyfit(x[known] - middle, y[known], 1)
    return np.asarray(offset + slope * (x - middle))


def _floats(trips: Any, name: str) -> FloatColumn:
    return np.asarray(trips[name].to_numpy(), np.float64)
