"""A fleet on this machine: what is in the lake, what is named, what goes on."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

from canest.fleet.child_main import write_message
from canest.fleet.work_folder import PREFIX
from tests.fleet.conftest import KENWORTH, ROOT, candump, command, files_of, hanging_log, run, wait_for


def rows(lake: Path, sql: str) -> list[str]:
    done = command("query", lake, sql)
    assert done.code == 0, done.err
    return done.out.splitlines()


def test_the_lake_has_a_row_per_leg_and_two_logs_of_equal_content_are_two(lake):
    found = rows(lake, "select log, vehicle, date, status from trips order by log")
    assert found[0] == "log,vehicle,date,status"
    assert [row.split(",")[:3] for row in found[1:]] == [
        ["t1/copy.log.xz", "truck-1", "2023-11-20"],
        ["t1/day0.log", "truck-1", "2023-11-14"],
        ["t1/day1.log", "truck-1", "2023-11-15"],
        ["t1/day2.log", "truck-1", "2023-11-16"],
        ["t2/copy.log.xz", "truck-2", "2023-11-20"],
        ["t2/day0.log", "truck-2", "2023-11-14"],
        ["t2/day1.log", "truck-2", "2023-11-15"],
        ["t2/day2.log", "truck-2", "2023-11-16"],
    ]
    assert rows(lake, "select max(n) from (select count(*) n from samples group by log)")[1] == "13"


def test_every_file_names_the_version_of_its_schema(lake):
    for path in [*lake.glob("trips/*/*/*.parquet"), *lake.glob("samples/*/*/*.parquet")]:
        assert pq.read_metadata(path).metadata[b"canest.schema"] == b"3"


def test_what_is_there_is_not_done_again_and_what_changed_is(lake, logs, manifest, tmp_path):
    copy, source = tmp_path / "lake", tmp_path / "logs"
    shutil.copytree(lake, copy)
    shutil.copytree(logs, source)
    done = run(source, copy, manifest, "--resume")
    assert (done.tally["done"], done.tally["present"]) == (0, 8), done.err
    assert files_of(copy) == files_of(lake)
    (source / "t1/day0.log").write_bytes(candump(16, 1_700_000_000))
    done = run(source, copy, manifest, "--resume")
    assert (done.tally["done"], done.tally["present"]) == (1, 7), done.err
    assert len(files_of(copy)) == len(files_of(lake))
    assert rows(copy, "select count(*) from samples where log = 't1/day0.log'")[1] == "15"


def test_what_fits_no_rule_or_cannot_be_read_is_named_and_the_rest_is_done(logs, lake, tmp_path):
    source = tmp_path / "logs"
    shutil.copytree(logs / "t1", source / "t1")
    (source / "t1/empty.log").write_bytes(b"")
    (source / "t1/bad.log").write_bytes(b"nonsense\n")
    (source / "t1/bomb.log.zst").write_bytes(zstandard.compress(b"0" * 300_000_000))
    (source / "stray.log").write_bytes(candump(5))
    (source / "read me.md").write_text("no log")
    rules = tmp_path / "fleet.csv"
    rules.write_text("pattern,vehicle,config\nt1/*,truck-1,kenworth\n")
    done = run(source, tmp_path / "lake", rules)
    assert done.code == 1
    assert [log["log"] for log in done.tally["failed"]] == ["t1/bad.log", "t1/bomb.log.zst"]
    assert done.tally["unmatched"] == [
        {"log": "stray.log", "reason": "no rule of the manifest fits its path"}
    ]
    assert done.tally["passed_over"] == ["read me.md"]
    assert done.tally["done"] == 5
    assert "error: t1/bad.log: nothing to read" in done.err
    assert "error: t1/bomb.log.zst: unpacks to more than 200 times its size" in done.err
    assert rows(tmp_path / "lake", "select status, reason from trips where log = 't1/empty.log'")[1] == (
        "unestimated,the log is empty: it holds no frames"
    )


def test_an_empty_log_and_one_that_is_cut_short_are_named(manifest, tmp_path):
    source = tmp_path / "logs/t1"
    source.mkdir(parents=True)
    (source / "whole.log").write_bytes(candump(5))
    (source / "empty.log").write_bytes(b"")
    (source / "cut.log.xz").write_bytes(KENWORTH.read_bytes()[:4000])
    (source / "strange.log").write_bytes(b"(1.000000) can0 7FF#00\n")
    done = run(tmp_path / "logs", tmp_path / "lake", manifest)
    assert (done.code, done.tally["done"]) == (0, 4), done.err
    reasons = {log["log"]: log["reason"] for log in done.tally["lacking"]}
    assert list(reasons) == ["t1/cut.log.xz", "t1/empty.log", "t1/strange.log"]
    assert reasons["t1/cut.log.xz"] == "the log ends before it should: the xz archive ends early"
    assert reasons["t1/empty.log"] == "the log is empty: it holds no frames"
    assert reasons["t1/strange.log"].endswith("was never seen in 1 frames")
    assert done.err.splitlines() == [f"note: {log}: {reason}" for log, reason in reasons.items()]
    shown = command("run", tmp_path / "logs", "-o", tmp_path / "again", "--manifest", manifest)
    assert "3 logs are empty, cut short or lack the needed signals" in shown.out


def test_a_pipe_is_named_and_not_waited_for(manifest, tmp_path):
    pipe = tmp_path / "logs/t1/pipe.log"
    pipe.parent.mkdir(parents=True)
    os.mkfifo(pipe)
    done = run(tmp_path / "logs", tmp_path / "lake", manifest, timeout_s=60)
    assert done.code == 1
    assert done.err == ("error: t1/pipe.log: is a pipe, expected a file: canest replay reads a pipe\n")


def test_a_mistake_in_the_manifest_leaves_no_lake_behind(logs, tmp_path):
    rules = tmp_path / "fleet.csv"
    rules.write_text("pattern,vehicle,config\nt1/*,truck-1,nowhere.yaml\n")
    done = run(logs, tmp_path / "lake", rules)
    assert done.code == 2
    assert done.err.startswith(f"error: {rules}:2: nowhere.yaml: no such config file")
    assert len(done.err.splitlines()) == 1
    assert not (tmp_path / "lake").exists()


VIN = "1FUJGLDR0CSBM1234"


def vin_lines(t_s: float) -> bytes:
    """Return the engine's VIN as it sends it: a broadcast of three packets."""
    payload = (VIN + "*").encode().ljust(21, b"\xff")
    frames = [(0x1CECFF00, bytes([32, 18, 0, 3, 0xFF, 0xEC, 0xFE, 0]))]
    frames += [(0x1CEBFF00, bytes([n + 1]) + payload[7 * n : 7 * n + 7]) for n in range(3)]
    text = "".join(
        f"({t_s + 0.06 * n:.6f}) can0 {can_id:08X}#{data.hex().upper()}\n"
        for n, (can_id, data) in enumerate(frames)
    )
    return text.encode()


@pytest.mark.slow
def test_vehicles_are_told_by_their_vin_which_no_file_of_the_lake_has_unless_asked(tmp_path):
    source, home = tmp_path / "logs", {"HOME": str(tmp_path)}
    source.mkdir()
    (source / "a.log").write_bytes(vin_lines(1_699_999_999) + candump(10, 1_700_000_000))
    (source / "b.log").write_bytes(candump(10, 1_700_000_000))
    asked = ("-c", "kenworth", "--json", "-")
    done = command("run", source, "-o", tmp_path / "hashed", *asked, environment=home)
    assert (done.tally["done"], done.code) == (1, 1), done.err
    assert "no rule: b.log: the log carries no VIN: name its vehicle in the column vehicle" in done.err
    files = files_of(tmp_path / "hashed")
    assert not any(VIN.encode() in content or VIN in name for name, content in files.items())
    assert rows(tmp_path / "hashed", "select vehicle from trips")[1].startswith("vin-")
    done = command("run", source, "-o", tmp_path / "kept", *asked, "--keep-vin", environment=home)
    assert rows(tmp_path / "kept", "select distinct vehicle from trips")[1:] == [VIN]
    for lake in ("hashed", "kept"):
        done = command("forget", tmp_path / lake, VIN, environment=home)
        assert done.out == "2 files removed\n", done.err


@pytest.mark.slow
def test_a_log_that_hangs_and_one_that_eats_memory_cost_themselves_alone(lake, logs, tmp_path):
    source = tmp_path / "logs"
    shutil.copytree(logs / "t1", source)
    hanging_log(source / "hangs.log")
    hungry_log(source / "hungry.parquet")
    rules = tmp_path / "fleet.csv"
    rules.write_text("pattern,vehicle,config\nhungry.*,truck-1,bmw-i3\n*,truck-1,kenworth\n")
    done = run(source, tmp_path / "lake", rules, "--timeout", 20, "--memory", 500, "--log-budget", "none")
    assert done.tally["failed"] == [
        {"log": "hangs.log", "error": "takes more than 20 s, 2 times"},
        {"log": "hungry.parquet", "error": "takes more than 500 MB of memory, 2 times"},
    ]
    assert done.tally["done"] == 4
    good = {name.split("/")[-1] for name in files_of(tmp_path / "lake")}
    assert len(good) == 5  # names of results, equal in both tables, and the mark


def hungry_log(path: Path) -> None:
    """Write some kilobytes that take gigabytes to read: rows of one long text, which stands in it once."""
    rows = pa.array(np.zeros(200_000, np.int32))
    texts = pa.DictionaryArray.from_arrays(rows, pa.array(["0" * 20_000]))
    names = ("Time [s]", "t_s")
    pq.write_table(pa.table(dict.fromkeys(names, texts)), path, store_schema=False, row_group_size=200_000)


@pytest.mark.slow
def test_killed_in_the_middle_and_resumed_the_lake_is_that_of_an_undisturbed_run(
    lake, logs, manifest, tmp_path
):
    folder = tmp_path / "lake"
    arguments = [sys.executable, "-m", "canest", "fleet", "run", logs, "-o", folder, "--manifest", manifest]
    for number in (signal.SIGKILL, signal.SIGINT):
        before = len(list(folder.glob("trips/*/*/*.parquet")))
        process = subprocess.Popen(
            [*arguments, "--workers", "1", "--resume"], cwd=ROOT, stderr=subprocess.PIPE,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 - a background job ignores it
        )  # fmt: skip
        wait_for(lambda n=before: len(list(folder.glob("trips/*/*/*.parquet"))) > n)
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
        assert process.returncode, err.decode()
    assert b"logs are done and kept: the same command with --resume does the rest" in err
    done = run(logs, folder, manifest, "--resume")
    assert done.code == 0
    assert done.tally["present"] >= 2
    assert files_of(folder) == files_of(lake)


@pytest.mark.slow
def test_two_runs_at_once_give_the_lake_of_one(lake, logs, manifest, tmp_path):
    folder = tmp_path / "lake"
    arguments = [sys.executable, "-m", "canest", "fleet", "run", logs, "-o", folder, "--manifest", manifest]
    processes = [subprocess.Popen(arguments, cwd=ROOT) for _ in range(2)]
    assert [process.wait(120) for process in processes] == [0, 0]
    assert files_of(folder) == files_of(lake)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_and_their_folders_end_with_the_run(logs, manifest, tmp_path, how):
    folders = tmp_path / "temporary"
    folders.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-m", "canest", "fleet", "run", logs, "-o", tmp_path / "lake", "--manifest",
         manifest],
        cwd=ROOT, stdout=subprocess.DEVNULL, env=os.environ | {"TMPDIR": str(folders)},
    )  # fmt: skip
    wait_for(lambda: children_of(process.pid) and list(folders.glob(f"{PREFIX}*")))
    children = children_of(process.pid)
    process.send_signal(how)
    process.wait(30)
    wait_for(lambda: not any(Path(f"/proc/{child}").exists() for child in children), 20)
    assert list(folders.glob(f"{PREFIX}*")) == []


def children_of(pid: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        found += [int(child) for child in task.read_text().split()]
    return found


class Unpickled:
    """What says, as it is unpickled, in which thread that happens."""

    def __reduce__(self):
        return eval, ("__import__('os').write(2, __import__('threading').current_thread().name.encode())",)


def test_a_child_imports_in_one_thread_alone(tmp_path):
    """Two threads that import a package and a module of it at a time may each get the other's half."""
    with subprocess.Popen(
        [sys.executable, "-m", "canest.fleet.child_main", tmp_path / "temporary"],
        cwd=ROOT, stdin=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        write_message(process.stdin, Unpickled())
        assert process.stderr.read(10) == b"MainThread"
