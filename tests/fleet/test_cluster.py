"""A real Dask cluster of separate processes: what it does with a fleet, and what becomes of it in trouble."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from tests.fleet.conftest import ROOT, candump, end, files_of, hanging_log, run, start_worker, wait_for
from tests.fleet.test_run import hungry_log

pytestmark = pytest.mark.slow


def test_the_lake_of_a_cluster_is_that_of_one_machine(cluster, lake, logs, manifest, tmp_path):
    done = run(logs, tmp_path / "lake", manifest, "--dask", cluster.address)
    assert done.code == 0, done.err
    assert files_of(tmp_path / "lake") == files_of(lake)


def test_a_killed_worker_a_hungry_log_and_a_hanging_one_are_named_and_the_rest_is_complete(
    cluster, lake, logs, tmp_path
):
    source, folder = tmp_path / "logs", tmp_path / "lake"
    shutil.copytree(logs, source)
    hanging_log(source / "hangs.log")
    hungry_log(source / "hungry.parquet")
    for number in range(6):
        (source / "t1" / f"more{number}.log").write_bytes(candump(25, 1_700_600_000 + 60 * number))
    rules = tmp_path / "fleet.csv"
    rules.write_text(
        "pattern,vehicle,config\nhungry.*,truck-1,bmw-i3\nt2/*,truck-2,kenworth\n*,truck-1,kenworth\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "canest", "fleet", "run", source, "-o", folder, "--manifest", rules,
         "--dask", cluster.address, "--timeout", "20", "--memory", "500", "--log-budget", "none"],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    wait_for(lambda: list(folder.glob("trips/*/*/*.parquet")))
    end(cluster.workers[0])
    out, err = process.communicate(timeout=200)
    assert process.returncode == 1
    # after a minute there are lines of progress too
    assert [line for line in err.splitlines() if line.startswith("error")] == [
        "error: hangs.log: takes more than 20 s, 2 times",
        "error: hungry.parquet: takes more than 500 MB of memory, 2 times",
    ]
    assert "16 logs: 14 done, 0 there before, 2 failed, 0 without a rule" in out
    found, undisturbed = files_of(folder), files_of(lake)
    assert {name: found[name] for name in undisturbed} == undisturbed


def test_a_worker_of_another_version_is_refused(cluster, logs, manifest, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(ROOT / "canest", other / "canest", ignore=shutil.ignore_patterns("__pycache__"))
    version = other / "canest/__init__.py"
    version.write_text(version.read_text().replace('__version__ = "', '__version__ = "9.'))
    worker = start_worker(cluster.address, tmp_path, {"PYTHONPATH": str(other)})
    try:
        wait_for(lambda: _workers(cluster.address) == 4)
        done = run(logs, tmp_path / "lake", manifest, "--dask", cluster.address)
    finally:
        end(worker)
    assert done.code == 2
    assert "1 of 4 workers run another canest" in done.err
    assert "found '9." in done.err


def test_where_no_scheduler_answers_it_is_refused_in_one_line(logs, manifest, tmp_path):
    done = run(logs, tmp_path / "lake", manifest, "--dask", "tcp://127.0.0.1:9")
    assert done.code == 2
    assert done.err.startswith("error: --dask tcp://127.0.0.1:9: no Dask scheduler answers")
    assert len(done.err.splitlines()) == 1


def _workers(address: str) -> int:
    script = "import sys; from distributed import Client; print(len(Client(sys.argv[1]).nthreads()))"
    done = subprocess.run(
        [sys.executable, "-c", script, address], capture_output=True, text=True, check=False, timeout=60
    )
    return int(done.stdout or 0)
