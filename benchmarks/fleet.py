"""Measures the fleet: many logs on all cores, a killed run, a scheduler's load, a lake of a million rows.

``python benchmarks/fleet.py logs --count 2000`` makes logs by copying and shifting simulated and measured
ones, in five formats and of 40 vehicles, and compares a run with single replays. ``lake --rows 1000000``
reports on a synthetic lake. ``tasks --count 1000000`` gives a real Dask scheduler that many logs' worth of
batches that do nothing. Each prints its figures; docs/measured/fleet.md has them.
"""

from __future__ import annotations

import argparse
import gzip
import lzma
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import canest as api
from canest.core.frames import FrameBlock, IntColumn
from canest.logs.candump_writer import candump_text
from canest.logs.format_detection import open_log

ROOT = Path(__file__).resolve().parent.parent
VEHICLES = 40
FORMATS = (".log", ".log.gz", ".log.xz", ".blf", ".asc")
DAY_S = 86_400


def canest(*arguments: object) -> list[str]:
    """Return the command line of a canest command."""
    return [sys.executable, "-m", "canest", *map(str, arguments)]


def ten_minutes(frames: FrameBlock, minutes: float) -> FrameBlock:
    """Return a drive, repeated until it lasts so many minutes."""
    length_us = int(frames.t_us[-1] - frames.t_us[0])
    times = [frames.t_us + n * (length_us + 20_000) for n in range(math.ceil(minutes * 60e6 / length_us))]
    whole = FrameBlock.concatenate([FrameBlock(t_us, *_payload(frames)) for t_us in times])
    return whole[: int(np.searchsorted(whole.t_us, whole.t_us[0] + minutes * 60e6))]


def make_logs(folder: Path, count: int, minutes: float) -> tuple[Path, Path]:
    """Write logs of so many minutes, each at another time; return their folder and the manifest."""
    simulated = api.simulate(str(ROOT / "canest/simulation/scenarios/pulse-21t.yaml")).frames
    measured = FrameBlock.concatenate(list(open_log(ROOT / "tests/data/kenworth/normal.log.xz")))
    drives = {"class8": ten_minutes(simulated, minutes), "kenworth": ten_minutes(measured, minutes)}
    source = folder / "logs"
    made: dict[str, Path] = {}
    for number in range(count):
        ending, vehicle = FORMATS[number % len(FORMATS)], number % VEHICLES
        path = source / f"truck-{vehicle}" / f"{number}{ending}"
        path.parent.mkdir(parents=True, exist_ok=True)
        # a few of each format are made, with a time of their own; the others are copies of these
        kind = f"{config_of(vehicle)}{ending}{number // len(FORMATS) % 4}"
        if kind in made:
            shutil.copyfile(made[kind], path)
            continue
        made[kind] = path
        frames = drives[config_of(vehicle)]
        shifted = FrameBlock(frames.t_us + number * DAY_S * 1_000_000, *_payload(frames))
        _write(path, ending, shifted)
    manifest = folder / "fleet.csv"
    rows = [f"truck-{v}/*,truck-{v},{config_of(v)}" for v in range(VEHICLES)]
    manifest.write_text("\n".join(["pattern,vehicle,config", *rows]) + "\n")
    return source, manifest


def config_of(vehicle: int) -> str:
    """Return the config of a truck: one of eight drives what was measured."""
    return "kenworth" if vehicle % 8 == 7 else "class8"


def _payload(frames: FrameBlock) -> tuple[IntColumn, ...]:
    return frames.can_id, frames.length, frames.data


def _write(path: Path, ending: str, frames: FrameBlock) -> None:
    text = candump_text(frames)
    if ending in (".log", ".log.gz", ".log.xz"):
        pack = {".log": bytes, ".log.gz": gzip.compress, ".log.xz": lambda t: lzma.compress(t, preset=1)}[
            ending
        ]
        path.write_bytes(pack(text))
        return
    import can

    plain = path.with_name("plain.log")
    plain.write_bytes(text)
    with can.Logger(path) as writer, can.LogReader(plain) as reader:
        for message in reader:
            writer(message)
    plain.unlink()


def measure_logs(count: int, minutes: float, singles: int) -> None:
    """Print what a run costs beside single replays, its memory, and whether a killed one is completed."""
    with tempfile.TemporaryDirectory(prefix="canest-bench-") as folder:
        source, manifest = make_logs(Path(folder), count, minutes)
        paths = sorted(p for p in source.rglob("*") if p.is_file())
        print(f"{len(paths)} logs, {sum(p.stat().st_size for p in paths) / 1e6:,.0f} MB")
        chosen = [paths[i] for i in np.linspace(0, len(paths) - 1, singles).astype(int)]
        cpu_s, single_s = _children_s(), time.perf_counter()
        for path in chosen:
            config = config_of(int(path.parent.name.split("-")[1]))
            subprocess.run(canest("replay", path, "-c", config), check=True, stdout=subprocess.DEVNULL)
        cpu_single = (_children_s() - cpu_s) / singles * len(paths)
        wall_single = (time.perf_counter() - single_s) / singles * len(paths)
        whole, broken = Path(folder, "whole"), Path(folder, "broken")
        cpu_s, begin_s = _children_s(), time.perf_counter()
        peak_mb = _run_watched(canest("fleet", "run", source, "-o", whole, "--manifest", manifest))
        wall_s, cpu_run = time.perf_counter() - begin_s, _children_s() - cpu_s
        cores = os.cpu_count() or 1
        print(f"single replays: {wall_single:,.0f} s, CPU {cpu_single:,.0f} s")
        print(f"fleet run: {wall_s:,.0f} s, CPU {cpu_run:,.0f} s, worker peak {peak_mb:,.0f} MB")
        print(f"wall / (singles / {cores}) = {wall_s / (wall_single / cores):.2f}; "
              f"CPU / CPU of singles = {cpu_run / cpu_single:.2f}")  # fmt: skip
        arguments = canest("fleet", "run", source, "-o", broken, "--manifest", manifest, "--resume")
        process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL)
        while len(list(broken.glob("trips/*/*/*"))) < len(paths) // 2:
            time.sleep(0.1)
        process.send_signal(signal.SIGKILL)
        process.wait()
        kept = len(list(broken.glob("trips/*/*/*.parquet")))
        subprocess.run(arguments, check=True, stdout=subprocess.DEVNULL)
        equal = _files(whole) == _files(broken)
        print(f"killed with {kept} logs done, resumed: {'equal file by file' if equal else 'DIFFERENT'}")


def _run_watched(arguments: list[str]) -> float:
    """Run a command; return the most memory in MB that one of its workers took."""
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL)
    peak = 0
    while process.poll() is None:
        for task in Path(f"/proc/{process.pid}/task").glob("*/children"):
            for child in task.read_text().split():
                try:
                    if b"compiling_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                        continue  # it reads no fleet's log, and ends before the workers start
                    peak = max(peak, int(Path(f"/proc/{child}/statm").read_text().split()[1]))
                except (OSError, IndexError):
                    continue
        time.sleep(0.2)
    if process.returncode:
        raise SystemExit(process.returncode)
    return peak * resource.getpagesize() / 1e6


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def measure_lake(rows: int, vehicles: int) -> None:
    """Print how long a report of a synthetic lake takes: one file per vehicle and month."""
    from canest.fleet.lake import Lake
    from canest.fleet.tables import TRIPS, TableWriter

    random = np.random.default_rng(1)
    with tempfile.TemporaryDirectory(prefix="canest-bench-") as folder:
        lake = Lake.create(f"{folder}/lake")
        months, made = 12, 0
        each = rows // (vehicles * months)
        begin_s = time.perf_counter()
        for vehicle in range(vehicles):
            for month in range(months):
                start = np.datetime64(f"2026-{month + 1:02d}-01T06:00:00", "us") + np.sort(
                    random.integers(0, 27 * DAY_S, each)
                ) * np.timedelta64(1_000_000, "us")
                mass = random.choice([9e3, 21e3, 38e3], each)
                columns = {name: [None] * each for name in TRIPS} | {
                    "log": [f"truck-{vehicle}/{month}-{i}.log" for i in range(each)], "leg": [1] * each,
                    "start": start, "distance_m": random.random(each) * 1e5, "duration_s": [3600.0] * each,
                    "driving_s": [3500.0] * each, "climb_m": [300.0] * each, "stops": [2] * each,
                    "mass_kg": mass, "mass_std_kg": 0.02 * mass, "valid_share": random.random(each),
                    "status": ["valid"] * each, "reason": [""] * each,
                    "torque_residual_pct": random.normal(0, 1, each),
                }  # fmt: skip
                writer = TableWriter(TRIPS, {})
                writer.write(columns)
                day = f"2026-{month + 1:02d}-01"
                lake.storage.write(f"trips/vehicle=truck-{vehicle}/date={day}/all.parquet", writer.content())
                made += each
        print(f"{made:,} rows of {vehicles} vehicles made in {time.perf_counter() - begin_s:,.0f} s")
        begin_s, cpu_s = time.perf_counter(), _children_s()
        subprocess.run(canest("fleet", "report", f"{folder}/lake", "-o", f"{folder}/report"), check=True)
        size = sum(p.stat().st_size for p in Path(folder, "report").rglob("*") if p.is_file())
        print(f"report: {time.perf_counter() - begin_s:.1f} s, CPU {_children_s() - cpu_s:.1f} s, "
              f"{size / 1e6:,.0f} MB")  # fmt: skip


def nothing(batch: object) -> list[object]:
    """Return an empty result for a batch: what a log costs the scheduler, without the log."""
    return []


def measure_tasks(count: int, batch: int) -> None:
    """Print what a million logs cost a scheduler that three real workers ask for work."""
    from distributed import Client, LocalCluster

    from canest.fleet import dask_engine
    from canest.fleet.job import FleetJob, Settings
    from canest.fleet.manifest import Rule
    from canest.fleet.source import FoundLog

    dask_engine.run_batch = nothing  # type: ignore[assignment]
    dask_engine.LARGEST_BATCH = batch
    rule = ((Rule("*", "truck", "class8"), "digest"),)
    with LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=None) as cluster:
        begin_s = time.perf_counter()
        logs = (FoundLog(f"t/{i}.log", f"s3://b/{i}", 1 << 22) for i in range(count))
        jobs = [FleetJob(log, rule) for log in logs]
        print(f"{count:,} jobs made in {time.perf_counter() - begin_s:.1f} s")
        begin_s = time.perf_counter()
        bundles = {"digest": None}
        done = sum(1 for _ in dask_engine.run_on_dask(
            cluster.scheduler_address, jobs, bundles, Settings(version=""),  # type: ignore[arg-type]
        ))  # fmt: skip
        wall_s = time.perf_counter() - begin_s
        with Client(cluster) as client:
            held = client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    batches = -(-count // batch)
    each_ms = wall_s / batches * 1e3
    print(f"{batches:,} tasks of {batch} logs in {wall_s:.0f} s, {each_ms:.1f} ms each, "
          f"{held} left with the scheduler, {done} outcomes; it took {peak_mb:,.0f} MB here")  # fmt: skip


def main() -> None:
    """Run one of the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="what", required=True)
    logs = commands.add_parser("logs")
    logs.add_argument("--count", type=int, default=2000)
    logs.add_argument("--minutes", type=float, default=10.0)
    logs.add_argument("--singles", type=int, default=20)
    lake = commands.add_parser("lake")
    lake.add_argument("--rows", type=int, default=1_000_000)
    lake.add_argument("--vehicles", type=int, default=1000)
    tasks = commands.add_parser("tasks")
    tasks.add_argument("--count", type=int, default=1_000_000)
    tasks.add_argument("--batch", type=int, default=50)
    asked = parser.parse_args()
    if asked.what == "logs":
        measure_logs(asked.count, asked.minutes, asked.singles)
    elif asked.what == "lake":
        measure_lake(asked.rows, asked.vehicles)
    else:
        measure_tasks(asked.count, asked.batch)


if __name__ == "__main__":
    main()
