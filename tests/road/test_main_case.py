"""From logs to a map to a cruise that uses it: as a user does it, with the drives of the benchmark."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import canest
from canest.road.table import read_map

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def benchmark():
    """benchmarks/road_map.py, with shorter drives."""
    spec = importlib.util.spec_from_file_location("road_map_benchmark", ROOT / "benchmarks/road_map.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    module.SECONDS = 400
    return module


@pytest.fixture(scope="module")
def folder(benchmark, tmp_path_factory):
    """Five passes by three vehicles of different loads and errors, and their map."""
    folder = tmp_path_factory.mktemp("road")
    benchmark.make_passes(folder, benchmark.the_road(1), 5, 1)
    benchmark.map_of(folder)
    return folder


def test_five_passes_by_three_vehicles_give_a_road_that_is_right_and_knows_how_right(benchmark, folder):
    road = read_map(folder / "road.parquet")
    error, std = benchmark.error_deg(road, benchmark.the_road(1))
    assert len(error) > 220
    assert benchmark.rms(error) < 0.08
    assert 0.4 < benchmark.rms(error / std) < 1.6
    assert road.counts["satellite jumps"] > 0


def test_with_the_map_a_motorway_cruise_is_valid_within_three_minutes(benchmark, folder):
    road, mass_kg = benchmark.the_road(1), 16_000
    config = benchmark.write_pass(benchmark.cruise(road, mass_kg, 900), folder / "cruise", "cruise")
    mapped = config.with_name("mapped.yaml")
    mapped.write_text(f"{config.read_text()}\nroad_map: {folder / 'road.parquet'}\n")
    with_map, without = (canest.replay(config.with_suffix(".log"), path) for path in (mapped, config))
    assert first_valid_s(with_map) < min(180.0, 0.95 * first_valid_s(without))
    at = np.searchsorted(with_map.t_s - with_map.t_s[0], 180.0)
    assert with_map.mass_kg[at] == pytest.approx(mass_kg, rel=0.04)


def first_valid_s(result: canest.Replay) -> float:
    valid = result.t_s[result.status == canest.Status.VALID]
    return valid[0] - result.t_s[0] if len(valid) else np.inf


def test_a_page_and_geojson_show_the_map(benchmark, folder):
    out = benchmark.run("map", "build", folder / "lake-road", "-o", folder / "again.parquet",
                        "--geojson", folder / "road.geojson")  # fmt: skip
    assert "cells of 25 m" in out
    assert (folder / "again.parquet").read_bytes() == (folder / "road.parquet").read_bytes()
    features = json.loads((folder / "road.geojson").read_text())["features"]
    assert len(features) == len(read_map(folder / "road.parquet"))
    assert benchmark.run("map", "show", folder / "road.parquet") == f"written {folder / 'road.html'}\n"
    assert (folder / "road.html").stat().st_size > 1e6


def test_a_comparison_uses_the_map_too(folder):
    mapped = folder / "cruise" / "mapped.yaml"
    log = next(mapped.parent.glob("*.log"))
    found = canest.compare(log, mapped, estimators=["canest"]).estimates["canest"]
    replayed = canest.replay(log, mapped)
    np.testing.assert_array_equal(found.mass_kg, replayed.mass_kg)
