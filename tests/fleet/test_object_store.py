"""Logs in a store with the real S3 API, the lake there too, and a store that fails in the middle."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest

from canest.fleet.work_folder import PREFIX
from tests.fleet.conftest import ROOT, command, files_of, run, wait_for

UPLOAD = """
import sys
from pathlib import Path
import s3fs
fs = s3fs.S3FileSystem()
fs.mkdir("fleet")
for path in sorted(Path(sys.argv[1]).rglob("*")):
    if path.is_file():
        fs.pipe_file("fleet/" + path.relative_to(sys.argv[1]).as_posix(), path.read_bytes())
"""
FETCH = """
import sys
import s3fs
s3fs.S3FileSystem().get("fleet-lake/lake/", sys.argv[1] + "/", recursive=True)
"""
MAKE = "import s3fs; s3fs.S3FileSystem().mkdir('fleet-lake')"


def python(script: str, environment: dict[str, str], *arguments: object) -> None:
    subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        env=os.environ | environment, cwd=ROOT, check=True, timeout=120,
    )  # fmt: skip


@pytest.mark.slow
def test_from_a_store_into_a_store_with_resume_query_and_forget(s3, logs, manifest, lake, tmp_path):
    python(UPLOAD, s3, logs)
    python(MAKE, s3)
    done = run("s3://fleet", "s3://fleet-lake/lake", manifest, environment=s3)
    assert (done.code, done.tally["done"]) == (0, 8), done.err
    again = run("s3://fleet", "s3://fleet-lake/lake", manifest, "--resume", environment=s3)
    assert (again.code, again.tally["present"]) == (0, 8), again.err
    sql = "select log, mass_kg, distance_m from trips order by log"
    there, here = command("query", "s3://fleet-lake/lake", sql, environment=s3), command("query", lake, sql)
    assert there.out == here.out
    python(FETCH, s3, tmp_path / "copy")
    assert len(files_of(tmp_path / "copy")) == len(files_of(lake))
    done = command("compact", "s3://fleet-lake/lake", environment=s3)
    assert (done.code, done.out) == (0, "nothing to join\n"), done.err
    gone = command("forget", "s3://fleet-lake/lake", "truck-1", environment=s3)
    assert gone.out == "8 files removed\n", gone.err
    left = command("query", "s3://fleet-lake/lake", "select distinct vehicle from trips", environment=s3)
    assert left.out == "vehicle\ntruck-2\n"


JOIN = """
import sys
from threading import Thread
import s3fs
from canest.fleet import vehicle_lock
from canest.fleet.compact import compact
from canest.fleet.lake import Lake
from tests.fleet.test_compact import content, outcome
s3fs.S3FileSystem().mkdir("fleet-lake")
url = "s3://fleet-lake/lake"
lake = Lake.create(url)
for number in range(4):
    lake.commit(outcome(f"{number}.log"))
before = content(url)
with vehicle_lock.vehicle_lock(lake.storage, "vehicle=t1"):
    joining = Thread(target=compact, args=(url,))
    joining.start()
    joining.join(2)
    assert joining.is_alive()  # it waits for the lock
joining.join()
assert len(lake.storage.names("")) == 3, lake.storage.names("")
assert content(url) == before
lake = Lake.create(url)
assert lake.keys("3.log") == {"0000000000000001"}
lake.commit(outcome("3.log", "0000000000000002"))
lake.commit(outcome("4.log"))
vehicle_lock.LEASE_S = 0.0  # of a process that was killed
with vehicle_lock.vehicle_lock(lake.storage, "vehicle=t1"):
    compact(url)
trips, samples = content(url)
assert {row[3] for row in trips if row[1] == "3.log"} == {"0000000000000002"}
assert (len(trips), len(samples)) == (10, 15)
"""


@pytest.mark.slow
def test_in_a_store_files_are_joined_under_a_lock_that_a_killed_process_does_not_keep(s3):
    python(JOIN, s3)


@pytest.mark.slow
def test_a_store_that_fails_in_the_middle_costs_those_logs(s3, logs, manifest, tmp_path):
    python(UPLOAD, s3, logs)
    # listed, and gone when it is fetched: a pattern of two logs of which one cannot be read any more
    (tmp_path / "lake").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", LATE, "s3://fleet", tmp_path / "lake", manifest], cwd=ROOT,
        env=os.environ | s3, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    out, err = process.communicate(timeout=240)
    assert process.returncode == 1, err
    assert "error: t1/day0.log: cannot be fetched: " in err
    assert "8 logs: 7 done, 0 there before, 1 failed, 0 without a rule" in out


#: removes a log after the listing, as whoever tidies up a bucket does
LATE = """
import sys
import s3fs
from canest.cli.main import run
from canest.fleet import run as fleet_run
list_logs = fleet_run.find_logs
def find_logs(source):
    listing = list_logs(source)
    s3fs.S3FileSystem().rm_file("fleet/t1/day0.log")
    return listing
fleet_run.find_logs = find_logs
source, lake, manifest = sys.argv[1:]
sys.exit(run(["fleet", "run", source, "-o", lake, "--manifest", manifest]))
"""


@pytest.mark.slow
def test_a_store_that_goes_away_in_the_middle_costs_the_logs_that_are_left(s3, s3_server, logs, tmp_path):
    python(UPLOAD, s3, logs)
    rules = tmp_path / "fleet.csv"
    rules.write_text("pattern,vehicle,config\n*,truck-1,kenworth\n")
    python(MAKE, s3)
    process = subprocess.Popen(
        [sys.executable, "-m", "canest", "fleet", "run", "s3://fleet/t1/*", "-o", "s3://fleet-lake/lake",
         "--manifest", rules, "--workers", "1", "--json", "-"],
        cwd=ROOT, env=os.environ | s3, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    requests = s3_server.with_name("moto.txt")
    wait_for(lambda: requests.read_text().count("GET /fleet/t") >= 2)
    os.killpg(int(s3_server.read_text()), signal.SIGKILL)
    out, err = process.communicate(timeout=500)
    assert process.returncode == 1, err
    tally = json.loads(out)
    assert tally["done"] >= 1
    assert tally["done"] + len(tally["failed"]) == 4
    assert len(tally["failed"]) >= 1
    assert all(line.startswith(("error: ", f"{line[0]} of 4 logs: ")) for line in err.splitlines())
    assert all(
        "cannot be fetched: " in log["error"] or "cannot write: " in log["error"] for log in tally["failed"]
    )


@pytest.mark.slow
def test_a_store_that_is_gone_ends_the_run_with_what_is_done_kept(s3, s3_server, logs, tmp_path):
    source = tmp_path / "logs"
    source.mkdir()
    for number in range(9):
        (source / f"{number}.log").write_bytes((logs / "t1/day0.log").read_bytes())
    python(UPLOAD, s3, source)
    script = GONE.replace("PID", s3_server.read_text())
    copies = tmp_path / "copies"
    copies.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", script, "s3://fleet", tmp_path / "lake"], cwd=ROOT, timeout=200,
        env=os.environ | s3 | {"TMPDIR": str(copies)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert list(copies.glob(f"{PREFIX}*")) == []
    assert "error: s3://fleet: does not answer for 4 logs in a row, found 'cannot be fetched: " in done.stderr
    assert "expected --resume when it does: 0 logs are done and kept" in done.stderr


#: the store goes after it was listed
GONE = """
import os, signal, sys
from canest.cli.main import run
from canest.fleet import run as fleet_run
list_logs = fleet_run.find_logs
def find_logs(source):
    listing = list_logs(source)
    os.killpg(PID, signal.SIGKILL)
    return listing
fleet_run.find_logs, fleet_run.UNREACHABLE_MOST = find_logs, 4
source, lake = sys.argv[1:]
sys.exit(run(["fleet", "run", source, "-o", lake, "-c", "kenworth"]))
"""
