"""Drives become a map: offsets are separated from the road, and what is no road is left out and counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.road.build import CELLS, PASSES, SELDOM, STACKED, build_map
from canest.road.geojson import geojson
from canest.road.tracks import JUMPS, LOST, NO_POSITIONS, Drive

from .conftest import drive, true_grade


def rms_deg(road) -> float:
    return float(np.degrees(np.sqrt(np.mean((road.grade - true_grade(road)) ** 2))))


def test_offsets_of_vehicles_do_not_reach_the_road():
    offsets = {"a": 0.002, "b": -0.0015, "c": -0.0005}
    drives = [drive(k, v, offset=offsets[v]) for k, v in enumerate("abcabcabc")]
    road = build_map(drives)
    assert rms_deg(road) < 0.03
    error = (road.grade - true_grade(road)) / road.grade_std
    assert 0.4 < np.sqrt(np.mean(error**2)) < 1.3
    assert np.median(road.passes) == 9
    assert road.vehicles.max() == 3
    assert road.first_day.min() == 20_000 and road.last_day.max() == 20_008


def test_one_offset_alone_is_found_by_the_altitudes():
    """All drives are wrong alike: no comparison shows it, but the road does not climb so far."""
    road = build_map([drive(k, "a", offset=0.004) for k in range(6)])
    assert abs(np.mean(road.grade - true_grade(road))) < 0.0015
    without = build_map(
        [replace(drive(k, "a", offset=0.004), altitude_m=np.full(300, np.nan)) for k in range(6)]
    )
    assert np.mean(without.grade - true_grade(without)) > 0.003


def test_cells_lie_25_m_apart_and_lead_to_the_next():
    road = build_map([drive(k) for k in range(3)])
    assert 230 <= len(road) <= 245
    assert (road.next == np.append(np.arange(1, len(road)), -1)).mean() > 0.97
    assert road.counts[PASSES] == 3 and road.counts[CELLS] == len(road)


def test_the_two_directions_of_a_road_are_two_roads():
    road = build_map([drive(0), drive(1), drive(2, backwards=True), drive(3, backwards=True)])
    south = (road.heading_deg > 90) & (road.heading_deg < 270)
    assert 0.4 < south.mean() < 0.6
    assert (road.passes <= 2).all()
    truth = np.where(south, true_grade(road, backwards=True), true_grade(road))
    assert np.degrees(np.sqrt(np.mean((road.grade - truth) ** 2))) < 0.1


def test_a_carriageway_beside_the_road_is_a_road_of_its_own():
    road = build_map([drive(0), drive(1), drive(2, side_m=40.0), drive(3, side_m=40.0)])
    assert 460 <= len(road) <= 490
    assert (road.passes == 2).mean() > 0.9


def test_stacked_roads_are_left_out_and_counted():
    road = build_map([*(drive(k) for k in range(3)), *(drive(k, higher_m=25.0) for k in range(3, 6))])
    assert road.counts[STACKED] > 200
    assert len(road) < 30


def test_a_ramp_beside_the_road_is_left_out_where_its_grade_differs():
    drives = [drive(k) for k in range(6)]
    for k in range(3, 6):
        grade = drives[k].grade.copy()
        grade[100:130] += 0.03  # 600 m
        drives[k] = replace(drives[k], grade=grade)
    road = build_map(drives)
    assert 15 <= road.counts[STACKED] <= 30
    assert rms_deg(road) < 0.12  # a cell at either end of the ramp holds some of it


def test_satellite_jumps_are_left_out_and_counted():
    jumped = drive(0)
    latitude = jumped.latitude_deg.copy()
    latitude[100:104] += 0.002  # 220 m
    latitude[200:225] -= 0.003
    road = build_map([replace(jumped, latitude_deg=latitude), drive(1), drive(2)])
    assert road.counts[JUMPS] == 29
    assert len(road) <= 245
    assert rms_deg(road) < 0.1


def test_passes_without_positions_and_tunnels_are_counted():
    nowhere = np.full(300, np.nan)
    tunnel = drive(1)
    latitude = tunnel.latitude_deg.copy()
    latitude[100:140] = np.nan
    road = build_map([replace(drive(0), latitude_deg=nowhere), replace(tunnel, latitude_deg=latitude)])
    assert road.counts[NO_POSITIONS] == 1
    assert road.counts[LOST] == 1
    assert len(road) < 215
    assert build_map([replace(drive(0), latitude_deg=nowhere)]).counts[CELLS] == 0


def test_one_drive_that_is_wrong_is_outvoted():
    wrong = drive(9)
    hit = slice(100, 130)
    grade = wrong.grade.copy()
    grade[hit] += 0.01
    road = build_map([*(drive(k) for k in range(6)), replace(wrong, grade=grade)])
    assert rms_deg(road) < 0.05


def test_cells_of_few_drives_can_be_left_out():
    short = drive(1)
    columns = {
        name: getattr(short, name)[:150] for name in Drive.__slots__ if name not in ("log", "vehicle", "day")
    }
    half = replace(short, **columns)
    road = build_map([drive(0), half], least_passes=2)
    assert 100 < len(road) < 130
    assert road.counts[SELDOM] > 100


def test_geojson_has_a_line_per_cell():
    import json

    road = build_map([drive(0), drive(1)])
    features = json.loads(geojson(road))["features"]
    assert len(features) == len(road)
    longitude, latitude, altitude = features[10]["geometry"]["coordinates"][0]
    assert (round(longitude, 1), round(latitude, 1)) == (8.0, 47.0) and 350 < altitude < 450
    assert features[10]["properties"]["grade_pct"] == pytest.approx(100 * road.grade[10], abs=1e-3)
