"""Measures the road map: ten simulated passes, a motorway cruise that uses their map, and a real trolleybus.

    python benchmarks/road_map.py passes
    python benchmarks/road_map.py cruise
    python benchmarks/road_map.py trolleybus B183_2021-07-26.csv.xz

Each goes the way of a user: logs, `canest fleet run --positions`, `canest map build`, and `road_map:` in a
config. docs/measured/road-map.md has the figures.
"""

from __future__ import annotations

import argparse
import lzma
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial import cKDTree

import canest
from canest.core.samples import Status
from canest.road.sphere import EARTH_RADIUS_M, directions_of, points_of
from canest.road.table import RoadMap, read_map
from canest.simulation.files import write_drive
from canest.simulation.roads import Highway, lay
from canest.simulation.run import simulate

PASSES = 10
MASSES_KG = (18_000, 28_000, 38_000)
LENGTH_M, SECONDS = 11_000.0, 620
START = {"latitude_deg": 47.0, "longitude_deg": 8.0, "heading_deg": 40.0}
DAY_S = 86_400
SKIPPED_M = 200.0  #: at the begin of the road, where no vehicle knows anything yet
SIDE_M, SAME_DIRECTION = 15.0, math.cos(math.radians(30.0))
#: a HESS lighTram 19 DC; columns of the published table
BUS = {
    "vehicle": {
        "name": "bus", "mass_min_kg": 18_000, "mass_max_kg": 33_000, "wheel_radius_m": 0.48,
        "wheel_inertia_kgm2": 0, "gear_ratios": {1: 1.0}, "final_drive": 1.0, "driveline_efficiency": 1.0,
        "engine_inertia_kgm2": 0, "drag_area_m2": 5.5, "rolling_resistance": 0.008,
    },
    "dbc": [],
    "sampling": {"time_column": "time_unix"},
    "signals": {
        "wheel_force": {"column": "traction_tractionForce", "unit": "N", "stale_s": 1.5},
        "vehicle_speed": {"column": "odometry_vehicleSpeed", "unit": "m/s", "stale_s": 1.5},
        "brake_pedal": {"column": "traction_brakePressure", "unit": "%", "scale": 1e-4, "stale_s": 1.5},
        "latitude": {"column": "gnss_latitude", "unit": "rad", "optional": True},
        "longitude": {"column": "gnss_longitude", "unit": "rad", "optional": True},
        "altitude": {"column": "gnss_altitude", "unit": "m", "optional": True},
    },
}  # fmt: skip


def the_road(seed: int) -> dict[str, Any]:
    """Return a road of stretches of up to 4 % with bends, the same for every pass."""
    table = lay(Highway(kind="highway", grade_max=0.04, stretch_m=(400.0, 1400.0), bends=True),
                LENGTH_M + 4000.0, np.random.default_rng(seed))  # fmt: skip
    at = np.arange(0, len(table.grade), 5)
    return {
        "kind": "points", "at_m": at.astype(float).tolist(), "grade": table.grade[at].tolist(),
        "curvature_1pm": table.curvature_1pm[at].tolist(),
    }  # fmt: skip


def positions_of_road(road: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return where the road is every metre (n, 3), and its grade there (n,)."""
    s = np.arange(0.0, road["at_m"][-1])
    grade = np.interp(s, road["at_m"], road["grade"])
    curvature = np.interp(s, road["at_m"], road["curvature_1pm"])
    heading = math.radians(START["heading_deg"]) - np.cumsum(curvature)
    level = 1.0 / np.sqrt(1.0 + grade**2)
    north, east = np.cumsum(level * np.cos(heading)), np.cumsum(level * np.sin(heading))
    latitude = START["latitude_deg"] + np.degrees(north / EARTH_RADIUS_M)
    parallel_m = EARTH_RADIUS_M * math.cos(math.radians(START["latitude_deg"]))
    return points_of(latitude, START["longitude_deg"] + np.degrees(east / parallel_m)), grade


def scenario(road: dict[str, Any], mass_kg: float, seed: int, errors: dict[str, float]) -> dict[str, Any]:
    """Return a pass: an ordinary driver, a receiver with jumps and losses, and what nobody declares."""
    return {
        "seed": seed, "duration_s": SECONDS, "vehicle": "class8", "mass_kg": mass_kg, "road": road,
        "driver": {"kind": "mixed", "start_mps": 15.0, "retarder": True},
        "bus": {"start_s": 1_700_000_000 + seed * DAY_S},
        "positions": {**START, "noise_m": 2.5, "jumps_per_hour": 6.0, "lost_share": 0.02},
        "undeclared": [
            {"effect": "torque_gain", "gain": errors["gain"]},
            {"effect": "rolling_resistance", "crr_delta": errors["crr"]},
            {"effect": "wheel_slip", "slip_per_mps2": errors["slip"]},
            {"effect": "headwind", "wind_mps": errors["wind"]},
        ],
    }  # fmt: skip


def cruise(road: dict[str, Any], mass_kg: float, seed: int) -> dict[str, Any]:
    """Return a cruise of another vehicle, with small errors of its own."""
    return scenario(road, mass_kg, seed, {"gain": 1, "crr": 0, "slip": 0, "wind": 0}) | {
        "duration_s": 420, "undeclared": [], "small_errors": True,
        "driver": {"kind": "cruise", "speed_mps": 23.5, "start_mps": 20.0, "retarder": True},
    }  # fmt: skip


def write_pass(spec: dict[str, Any], folder: Path, name: str) -> Path:
    """Simulate a drive and write its log; return its config, which names the roles of a position."""
    made = simulate(spec)
    paths = write_drive(folder, name, made.frames, made.truth, made.config, force=True)
    return next(path for path in paths if path.suffix == ".yaml")


def make_passes(folder: Path, road: dict[str, Any], count: int, seed: int) -> None:
    """Write the logs of passes by three vehicles, each with errors of its own, and their manifest."""
    rng = np.random.default_rng(seed)
    own = [
        {"gain": 1 + rng.uniform(-0.02, 0.02), "crr": 0.006 * rng.uniform(-0.15, 0.15),
         "slip": rng.uniform(0.001, 0.006)}
        for _ in MASSES_KG
    ]  # fmt: skip
    rows = ["pattern,vehicle,config"]
    for number in range(count):
        vehicle = number % len(MASSES_KG)
        errors = own[vehicle] | {"wind": rng.uniform(-3.0, 3.0)}
        spec = scenario(road, MASSES_KG[vehicle], 100 * seed + number, errors)
        config = write_pass(spec, folder / "logs" / f"truck-{vehicle}", f"pass-{number}")
        config.rename(folder / f"truck-{vehicle}.yaml")
    rows += [f"truck-{v}/*,truck-{v},truck-{v}.yaml" for v in range(len(MASSES_KG))]
    (folder / "fleet.csv").write_text("\n".join(rows) + "\n")


def run(*arguments: object) -> str:
    """Run a canest command; return what it prints."""
    command = [sys.executable, "-m", "canest", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stderr)
    return done.stdout


def map_of(folder: Path, logs: str = "logs", name: str = "road") -> RoadMap:
    """Run the fleet over logs and build the map of its lake."""
    lake, path = folder / f"lake-{name}", folder / f"{name}.parquet"
    run(
        "fleet",
        "run",
        folder / logs,
        "-o",
        lake,
        "--manifest",
        folder / "fleet.csv",
        "--positions",
        "--resume",
    )
    print(run("map", "build", lake, "-o", path).rstrip())
    return read_map(path)


def error_deg(road: RoadMap, truth: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the error of each cell's grade and its claimed std, degrees, behind the begin of the road."""
    points, grade = positions_of_road(truth)
    _, nearest = cKDTree(points).query(points_of(road.latitude_deg, road.longitude_deg))
    behind = nearest > SKIPPED_M
    error = np.degrees(np.arctan(road.grade) - np.arctan(grade[nearest]))[behind]
    return error, np.degrees(road.grade_std)[behind]


def measure_passes(seeds: int, count: int) -> None:
    """Print the error of the map of ten passes, for several roads and fleets."""
    errors, stds = [], []
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory(prefix="canest-bench-") as name:
            folder, road = Path(name), the_road(seed)
            make_passes(folder, road, count, seed)
            error, std = error_deg(map_of(folder), road)
            errors.append(error)
            stds.append(std)
            print(f"road {seed}: {accuracy(error, std)}, mean {error.mean():+.3f}", flush=True)
    print(f"all: {accuracy(np.concatenate(errors), np.concatenate(stds))}")


def accuracy(error: np.ndarray, std: np.ndarray) -> str:
    """Return how large errors are, and whether their stds are honest."""
    within = 100 * np.mean(np.abs(error) < 2 * std)
    return (f"grade RMS {rms(error):.3f} degrees over {len(error):,} cells, "
            f"error over std {rms(error / std):.2f} RMS, {within:.0f} % within two stds")  # fmt: skip


def measure_cruise(seeds: int, count: int) -> None:
    """Print when a cruise on the mapped road becomes valid and how wrong it is, with and without the map."""
    with tempfile.TemporaryDirectory(prefix="canest-bench-") as name:
        folder, road = Path(name), the_road(1)
        make_passes(folder, road, count, 1)
        map_of(folder)
        for seed in range(seeds):
            mass_kg = (16_000, 28_000, 36_000)[seed % 3]
            config = write_pass(cruise(road, mass_kg, 900 + seed), folder / "cruise", f"cruise-{seed}")
            mapped = config.with_name(f"mapped-{seed}.yaml")
            mapped.write_text(f"{config.read_text()}\nroad_map: {folder / 'road.parquet'}\n")
            for path, what in ((config, "without"), (mapped, "with")):
                result = canest.replay(config.with_suffix(".log"), path)
                print(f"{mass_kg / 1e3:.0f} t, {what} map: {cruise_text(result, mass_kg)}", flush=True)


def cruise_text(result: canest.Replay, mass_kg: float) -> str:
    """Return when the mass became valid, and its errors from then on."""
    valid = np.flatnonzero(result.status == Status.VALID)
    if not len(valid):
        return "never valid"
    t_s = result.t_s - result.t_s[0]
    error = 100 * (result.mass_kg / mass_kg - 1)
    at_180_s = error[np.searchsorted(t_s, 180.0)]
    return (f"valid after {t_s[valid[0]]:.0f} s and {len(valid) / len(t_s):.0%} of the time; wrong by "
            f"{at_180_s:+.1f} % after 180 s, {error[-1]:+.1f} % in the end, "
            f"{np.abs(error[valid]).max():.1f} % at most while valid")  # fmt: skip


def measure_trolleybus(log: Path) -> None:
    """Print how well the maps of two halves of a day agree."""
    lines = lzma.decompress(log.read_bytes()).decode().splitlines()
    middle = 1 + (len(lines) - 1) // 2
    with tempfile.TemporaryDirectory(prefix="canest-bench-") as name:
        folder = Path(name)
        (folder / "bus.yaml").write_text(yaml.safe_dump(BUS))
        (folder / "fleet.csv").write_text("pattern,vehicle,config\n*,bus,bus.yaml\n")
        roads = []
        for half, rows in (("morning", lines[1:middle]), ("later", lines[middle:])):
            (folder / half).mkdir()
            (folder / half / "day.csv").write_text("\n".join([lines[0], *rows]) + "\n")
            roads.append(map_of(folder, half, half))
    first, second = roads
    points = points_of(first.latitude_deg, first.longitude_deg)
    other, std = grade_at(second, points, directions_of(points, first.heading_deg))
    following = np.maximum(first.next, 0)
    apart = np.degrees(first.grade - other)
    both = np.where(first.next >= 0, (apart + apart[following]) / 2, np.nan)
    both = both[np.isfinite(both)]
    claimed = np.degrees(np.hypot(first.grade_std, std))
    share = rms((apart / claimed)[np.isfinite(apart)])
    print(f"{len(both)} of {len(first)} stretches of 50 m are in both maps: they differ by {rms(both):.3f} "
          f"degrees RMS, {both.mean():+.3f} in the mean; difference over std {share:.2f} RMS")  # fmt: skip


def grade_at(road: RoadMap, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a map's grade and std at points (n, 3) that are passed in directions (n, 3), else NaN."""
    cells = points_of(road.latitude_deg, road.longitude_deg)
    ahead = directions_of(cells, road.heading_deg)
    tree = cKDTree(cells)
    grade, std = np.full(len(points), np.nan), np.full(len(points), np.nan)
    for number, (point, direction) in enumerate(zip(points, directions, strict=True)):
        nearest = SIDE_M
        for cell in tree.query_ball_point(point, 30.0):
            after = int(road.next[cell])
            if after < 0 or ahead[cell] @ direction < SAME_DIRECTION:
                continue
            step = cells[after] - cells[cell]
            share = float((point - cells[cell]) @ step / (step @ step))
            side = float(np.linalg.norm(point - cells[cell] - share * step))
            if 0.0 <= share <= 1.0 and side < nearest:
                nearest = side
                grade[number] = road.grade[cell] * (1 - share) + road.grade[after] * share
                std[number] = max(road.grade_std[cell], road.grade_std[after])
    return grade, std


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Run one of the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="what", required=True)
    for name in ("passes", "cruise"):
        command = commands.add_parser(name)
        command.add_argument("--seeds", type=int, default=3 if name == "passes" else 6)
        command.add_argument("--passes", type=int, default=PASSES)
    commands.add_parser("trolleybus").add_argument("log", type=Path)
    asked = parser.parse_args()
    if asked.what == "passes":
        measure_passes(asked.seeds, asked.passes)
    elif asked.what == "cruise":
        measure_cruise(asked.seeds, asked.passes)
    else:
        measure_trolleybus(asked.log)


if __name__ == "__main__":
    main()
