"""A road map as GeoJSON (RFC 7946), for QGIS, kepler.gl and others."""

from __future__ import annotations

import json
import math
from typing import Any

from canest.road.table import RoadMap


def geojson(road: RoadMap) -> bytes:
    """Return one line per cell, to the cell that follows; a point where none does."""
    rows = zip(
        road.longitude_deg.tolist(), road.latitude_deg.tolist(), road.altitude_m.tolist(), road.next.tolist(),
        road.heading_deg.tolist(), road.grade.tolist(), road.grade_std.tolist(), road.passes.tolist(),
        road.vehicles.tolist(), road.last_day.tolist(), strict=True,
    )  # fmt: skip
    places = [_place(*place) for place in zip(
        road.longitude_deg.tolist(), road.latitude_deg.tolist(), road.altitude_m.tolist(), strict=True
    )]  # fmt: skip
    features = []
    for cell, (*_, following, heading, grade, std, passes, vehicles, day) in enumerate(rows):
        line = following >= 0
        geometry: dict[str, Any] = {
            "type": "LineString" if line else "Point",
            "coordinates": [places[cell], places[following]] if line else places[cell],
        }
        properties = {
            "grade_pct": round(100 * grade, 3), "grade_std_pct": round(100 * std, 3), "passes": passes,
            "vehicles": vehicles, "heading_deg": round(heading, 1),
            "last_day": day if math.isfinite(day) else None,
        }  # fmt: skip
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


def _place(longitude: float, latitude: float, altitude: float) -> list[float]:
    place = [round(longitude, 7), round(latitude, 7)]
    return [*place, round(altitude, 1)] if math.isfinite(altitude) else place
