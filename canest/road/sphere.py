"""Positions as points of a sphere, in metres: distances and directions without seams or projections."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn

EARTH_RADIUS_M = 6_371_008.8  #: mean (IUGG); a sphere is wrong by 0.3 % of a distance
Points = NDArray[np.float64]  #: (n, 3)


def points_of(latitude_deg: FloatColumn, longitude_deg: FloatColumn) -> Points:
    """Return the points of positions (n,): (n, 3) in metres from the centre of the earth."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    level = np.cos(latitude)
    unit = np.stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)], axis=-1)
    return np.asarray(EARTH_RADIUS_M * unit)


def positions_of(points: Points) -> tuple[FloatColumn, FloatColumn]:
    """Return latitude and longitude in degrees of points (n, 3)."""
    x, y, z = points.T
    return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))


def unit(vectors: Points) -> Points:
    """Return vectors (n, 3) of length one; zero where there is no direction."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0))


def headings_of(points: Points, directions: Points) -> FloatColumn:
    """Return headings of directions (n, 3) at points: degrees from north, clockwise, 0 to 360."""
    latitude, longitude = (np.radians(column) for column in positions_of(points))
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros(len(points))], axis=1)
    north = np.stack([-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude),
                      np.cos(latitude)], axis=1)  # fmt: skip
    angle = np.degrees(np.arctan2((directions * east).sum(axis=1), (directions * north).sum(axis=1)))
    return np.asarray(angle % 360.0)


def directions_of(points: Points, heading_deg: FloatColumn) -> Points:
    """Return directions (n, 3) of headings at points: what `headings_of` takes."""
    latitude, longitude = (np.radians(column) for column in positions_of(points))
    heading = np.radians(heading_deg)
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros(len(points))], axis=1)
    north = np.stack([-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude),
                      np.cos(latitude)], axis=1)  # fmt: skip
    return np.asarray(np.cos(heading)[:, None] * north + np.sin(heading)[:, None] * east)
