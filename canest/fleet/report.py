"""`canest fleet report`: an index of the fleet, and a page for each vehicle."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from canest.core.errors import OutputError
from canest.fleet.query import connect
from canest.fleet.report_pages import fleet_page, trend_std, vehicle_page
from canest.report.page import require_packages, write_scripts

_FOLDER, _PREFIX = "vehicles", "vehicle-"
_BATCH_ROWS = 100_000

#: one row per vehicle; the trend is the slope of a straight line over time, per 100 days
_VEHICLES = """
SELECT vehicle, count(DISTINCT log) AS logs, count(*) FILTER (leg > 0) AS trips,
    coalesce(sum(distance_m), 0) / 1e3 AS km, coalesce(sum(driving_s), 0) / 3600 AS hours,
    coalesce(sum(valid_share * driving_s) / nullif(sum(driving_s), 0), 0) AS valid_share,
    quantile_cont(mass_kg, 0.05) FILTER (status = 'valid') AS light_kg,
    median(mass_kg) FILTER (status = 'valid') AS mass_kg,
    quantile_cont(mass_kg, 0.95) FILTER (status = 'valid') AS heavy_kg,
    median(torque_residual_pct) FILTER (status = 'valid') AS residual_pct,
    regr_count(torque_residual_pct, hundred_days) FILTER (status = 'valid') AS n,
    regr_slope(torque_residual_pct, hundred_days) FILTER (status = 'valid') AS trend_pct,
    regr_sxx(torque_residual_pct, hundred_days) FILTER (status = 'valid') AS sxx,
    regr_syy(torque_residual_pct, hundred_days) FILTER (status = 'valid') AS syy,
    min(start) AS first, max(start) AS last,
    mode(reason) FILTER (status <> 'valid' AND reason <> '') AS reason
FROM (SELECT *, epoch(start) / 8640000 AS hundred_days FROM trips) GROUP BY vehicle ORDER BY vehicle
"""
_MASSES = """
SELECT 5 * floor(mass_kg / 5000)::INT AS from_t, count(*) AS trips
FROM trips WHERE status = 'valid' GROUP BY from_t ORDER BY from_t
"""
_TRIPS = "SELECT * FROM trips WHERE leg > 0 ORDER BY vehicle, start NULLS LAST, log, leg"
#: what the queries above take of the lake, read once: opening its files costs more than all of them
_READ = """
CREATE TEMP TABLE trips AS
SELECT vehicle, log, leg, start, distance_m, climb_m, duration_s, driving_s, stops, mass_kg, mass_std_kg,
    valid_share, status, reason, torque_residual_pct, reported_mass_kg
FROM memory.main.trips
"""


def write_report(lake: str, folder: str, progress: Callable[[float], None]) -> tuple[Path, int]:
    """Write the pages of a lake; return the index and how many vehicles there are.

    Pages of vehicles that the lake has no more are removed. Errors: UsageError, OutputError.
    """
    require_packages(folder)
    connection, out = connect(lake, ["trips"]), Path(folder)
    pages = out / _FOLDER
    try:
        pages.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the directory: {error.strerror}", where=str(pages)) from None
    connection.execute("SET preserve_insertion_order = false")  # slower of many small files
    connection.execute(_READ)
    vehicles = [vehicle | trend_std(vehicle) for vehicle in _records(connection.execute(_VEHICLES))]
    masses = connection.execute(_MASSES).fetchall()
    files = {str(row["vehicle"]): f"{_PREFIX}{_slug(str(row['vehicle']))}.html" for row in vehicles}
    script = write_scripts(out)
    of_vehicle = {str(row["vehicle"]): row for row in vehicles}
    for done, (vehicle, trips) in enumerate(_trips(connection), 1):
        page = vehicle_page(of_vehicle[vehicle], trips)
        page.home, page.home_text = "../index.html", "All vehicles"
        page.write(pages / files.pop(vehicle), f"../{script}")
        progress(done / len(vehicles))
    # what is left in `files` has no driving at all: a row of the index alone
    links = {name: f"{_FOLDER}/{_PREFIX}{_slug(name)}.html" for name in of_vehicle if name not in files}
    index = fleet_page(lake, vehicles, masses, links)
    index.write(out / "index.html", script)
    kept = {Path(link).name for link in links.values()}
    for path in pages.glob(f"{_PREFIX}*.html"):
        if path.name not in kept:
            path.unlink()
    return out / "index.html", len(vehicles)


def _trips(connection: Any) -> Iterator[tuple[str, Any]]:
    """Yield vehicles with their trips, an Arrow table each."""
    import pyarrow as pa

    parts: list[Any] = []
    vehicle: str | None = None
    for batch in connection.execute(_TRIPS).to_arrow_reader(_BATCH_ROWS):
        table = pa.Table.from_batches([batch])
        for first, length, name in _runs(table["vehicle"].combine_chunks()):
            if name != vehicle and parts:
                yield str(vehicle), pa.concat_tables(parts)
                parts = []
            vehicle = name
            parts.append(table.slice(first, length))
    if parts:
        yield str(vehicle), pa.concat_tables(parts)


def _runs(names: Any) -> Iterator[tuple[int, int, str]]:
    """Yield the stretches of equal values: first row, length, value."""
    import pyarrow.compute as pc

    encoded = pc.run_end_encode(names)
    first = 0
    for end, name in zip(encoded.run_ends.to_pylist(), encoded.values.to_pylist(), strict=True):
        yield first, end - first, name
        first = end


def _records(result: Any) -> list[dict[str, Any]]:
    names = [column[0] for column in result.description]
    return [dict(zip(names, row, strict=True)) for row in result.fetchall()]


def _slug(vehicle: str) -> str:
    """Return a name for a file: letters, digits and dashes, with a digest where that was not all."""
    slug = re.sub(r"[^A-Za-z0-9-]+", "-", vehicle)[:80]
    digest = hashlib.blake2b(vehicle.encode(), digest_size=3).hexdigest()
    return slug if slug == vehicle else f"{slug}-{digest}"
