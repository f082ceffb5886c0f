"""Roads with known grade, and drives over them as a lake would hold them."""

from __future__ import annotations

import numpy as np

from canest.road.sphere import EARTH_RADIUS_M
from canest.road.tracks import Drive

#: the road: a hill of 3 % and a valley, bending slowly
LENGTH_M = 6000.0


def grade_at(way_m: np.ndarray) -> np.ndarray:
    """Return the grade of the road (n,)."""
    return 0.03 * np.sin(2 * np.pi * np.asarray(way_m) / 1500.0)


def altitude_at(way_m: np.ndarray) -> np.ndarray:
    """Return the altitude of the road (n,), m."""
    s = np.arange(0.0, LENGTH_M + 2000.0)
    return 400.0 + np.interp(way_m, s, np.cumsum(np.sin(np.arctan(grade_at(s)))))


def place_at(way_m: np.ndarray, side_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return latitude and longitude (n,), ``side_m`` to the right of the road."""
    s = np.arange(0.0, LENGTH_M + 2000.0)
    heading = 0.6 * np.sin(2 * np.pi * s / 4000.0)
    north, east = np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))
    north, east = north - side_m * np.sin(heading), east + side_m * np.cos(heading)
    latitude = 47.0 + np.degrees(np.interp(way_m, s, north) / EARTH_RADIUS_M)
    parallel_m = EARTH_RADIUS_M * np.cos(np.radians(47.0))
    return latitude, 8.0 + np.degrees(np.interp(way_m, s, east) / parallel_m)


def drive(
    seed: int = 0,
    vehicle: str = "a",
    *,
    offset: float = 0.0,
    noise_m: float = 2.0,
    grade_noise: float = 0.001,
    side_m: float = 0.0,
    backwards: bool = False,
    higher_m: float = 0.0,
    speed_mps: float = 20.0,
) -> Drive:
    """Return one drive over the road, a row per second; its grade is wrong by an offset and by noise."""
    rng = np.random.default_rng(seed)
    way = np.arange(rng.uniform(0.0, speed_mps), LENGTH_M, speed_mps)
    n = len(way)
    at = LENGTH_M - way if backwards else way
    latitude, longitude = place_at(at, side_m)
    drift = np.cumsum(rng.normal(0.0, 0.1 * noise_m, n)) * 0.3
    latitude = latitude + np.degrees((rng.normal(0.0, 0.2 * noise_m, n) + drift) / EARTH_RADIUS_M)
    sign = -1.0 if backwards else 1.0
    return Drive(
        log=f"{vehicle}-{seed}.log",
        vehicle=vehicle,
        day=20_000.0 + seed,
        distance_m=way,
        speed_mps=np.full(n, speed_mps),
        grade=sign * grade_at(at) + offset + rng.normal(0.0, grade_noise, n),
        grade_std=np.full(n, max(grade_noise, 1e-4)),
        altitude_m=altitude_at(at) + higher_m + rng.normal(0.0, 1.0, n),
        latitude_deg=latitude,
        longitude_deg=longitude,
        position_m=way,
    )


def true_grade(road, *, backwards: bool = False) -> np.ndarray:
    """Return the grade where the cells of a map are, by the nearest place of the road (cells,)."""
    s = np.arange(0.0, LENGTH_M + 500.0, 0.5)
    latitude, longitude = place_at(s)
    narrow = np.cos(np.radians(47.0))
    found = [
        s[np.argmin((latitude - a) ** 2 + (narrow * (longitude - b)) ** 2)]
        for a, b in zip(road.latitude_deg, road.longitude_deg, strict=True)
    ]
    return (-1.0 if backwards else 1.0) * grade_at(np.array(found))
