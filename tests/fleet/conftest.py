"""Small fleets of real logs, and the servers that a fleet meets: a Dask cluster, an S3 store."""

from __future__ import annotations

import json
import lzma
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Done:
    """What a command left behind. tally: its --json."""

    code: int
    out: str
    err: str
    tally: dict[str, object] = field(default_factory=dict)


def command(*arguments: object, environment: dict[str, str] | None = None, timeout_s: float = 240) -> Done:
    """Run `canest fleet ARGUMENTS` in a process, as a user would."""
    done = subprocess.run(
        [sys.executable, "-m", "canest", "fleet", *map(str, arguments)],
        capture_output=True, text=True, timeout=timeout_s, check=False, cwd=ROOT,
        env=os.environ | (environment or {}),
    )  # fmt: skip
    tally = json.loads(done.stdout) if done.stdout.startswith("{") else {}
    return Done(done.returncode, done.stdout, done.stderr, tally)


def run(source: object, lake: object, manifest: object, *more: object, **options: object) -> Done:
    """Run `canest fleet run` and take its tally."""
    return command("run", source, "-o", lake, "--manifest", manifest, "--json", "-", *more, **options)  # type: ignore[arg-type]


def files_of(lake: Path) -> dict[str, bytes]:
    """Return all files of a lake."""
    return {p.relative_to(lake).as_posix(): p.read_bytes() for p in sorted(lake.rglob("*")) if p.is_file()}


def candump(seconds: int = 20, shift_s: float = 0.0) -> bytes:
    """Return the first seconds of a Kenworth's log, at another time."""
    kept = []
    for line in lzma.decompress(KENWORTH.read_bytes()).splitlines():
        stamp, rest = line.strip()[1:].split(b")", 1)
        if float(stamp) > seconds:
            break
        kept.append(b"(%.6f)%s" % (float(stamp) + shift_s, rest))
    return b"\n".join(kept) + b"\n"


def hanging_log(path: Path) -> None:
    """Make a log whose reading never ends: a terminal at which nobody types."""
    _, terminal = pty.openpty()
    path.symlink_to(os.ttyname(terminal))


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight logs of two trucks in two folders, two of equal content; a manifest beside them."""
    folder = tmp_path_factory.mktemp("fleet")
    source = folder / "logs"
    day_s = 86_400
    for truck in ("t1", "t2"):
        (source / truck).mkdir(parents=True)
        for day in range(3):
            text = candump(12 + day, 1_700_000_000 + day * day_s + (truck == "t2") * 3600)
            (source / truck / f"day{day}.log").write_bytes(text)
    for truck in ("t1", "t2"):
        (source / truck / "copy.log.xz").write_bytes(lzma.compress(candump(12, 1_700_500_000)))
    (folder / "fleet.csv").write_text(
        "pattern,vehicle,config\nt1/*,truck-1,kenworth\nt2/*,truck-2,kenworth\n"
    )
    return source


@pytest.fixture(scope="session")
def manifest(logs: Path) -> Path:
    return logs.parent / "fleet.csv"


@pytest.fixture(scope="session")
def lake(logs: Path, manifest: Path) -> Path:
    """The lake of these logs, with nothing in the way."""
    folder = logs.parent / "lake"
    done = run(logs, folder, manifest, "--workers", 2, timeout_s=590)
    assert done.code == 0, done.err
    return folder


def wait_for(condition: Callable[[], object], timeout_s: float = 120.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "not within its time"
        time.sleep(0.05)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process that leads a session, with all that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(10)


@dataclass
class Cluster:
    """A Dask scheduler and its workers, each a process of its own."""

    address: str
    workers: list[subprocess.Popen[bytes]]


def start_worker(
    address: str, folder: Path, environment: dict[str, str] | None = None
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard",
         "--local-directory", str(folder)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | (environment or {}),
    )  # fmt: skip


def _scheduler_address(file: Path) -> str:
    """Return the address in a scheduler's file, or "": the file is there before all of its text is."""
    try:
        return str(json.loads(file.read_text())["address"])
    except (FileNotFoundError, json.JSONDecodeError):
        return ""


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler and three workers, in folders that hold nothing of canest's."""
    port_file = tmp_path / "scheduler.json"
    processes = [subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
         "--no-dashboard", "--scheduler-file", str(port_file)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, cwd=tmp_path,
        env=os.environ | {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s"},
    )]  # fmt: skip
    try:
        wait_for(lambda: _scheduler_address(port_file))
        address = _scheduler_address(port_file)
        workers = [start_worker(address, tmp_path) for _ in range(3)]
        processes += workers
        yield Cluster(address, workers)
    finally:
        for process in processes:
            end(process)


@pytest.fixture
def s3_server(tmp_path: Path) -> Path:
    """The file with the process group of the store of `s3`."""
    return tmp_path / "moto.pid"


@pytest.fixture
def s3(tmp_path: Path) -> Iterator[dict[str, str]]:
    """A store with the real S3 API (moto in a process), as the environment of whoever uses it."""
    log = tmp_path / "moto.txt"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", "0"],
            stdout=output, stderr=output, start_new_session=True,
        )  # fmt: skip
    try:
        wait_for(lambda: re.search(r"http://127\.0\.0\.1:\d+", log.read_text()))
        (tmp_path / "moto.pid").write_text(str(process.pid))
        address = re.search(r"http://127\.0\.0\.1:\d+", log.read_text())
        assert address is not None
        yield {
            "AWS_ENDPOINT_URL": address[0], "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_DEFAULT_REGION": "us-east-1",
        }  # fmt: skip
    finally:
        end(process)
