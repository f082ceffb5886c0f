"""Many logs in processes: when one takes its process along, or a person stops it all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from canest.batch.job import Job
from canest.batch.pool import pooled, run_jobs, unique_names
from canest.cli.summary import many_lines, short_names
from canest.config import load_config
from canest.core.errors import UsageError
from canest.logs.log_names import log_name, truth_beside
from canest.system.result_files import open_result

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"


class Killer(Job):
    """A log whose reading kills the process, when some estimates are written."""

    def run(self, config, progress=None):
        open_result(self.output).file.write(b"half")
        os.kill(os.getpid(), signal.SIGKILL)


def test_a_process_that_dies_takes_only_its_own_log_along(tmp_path):
    killer = Killer(DATA / "a.log", tmp_path / "a.csv")
    jobs = [Job(KENWORTH), killer, Job(KENWORTH, after_s=1.0), Job(KENWORTH, after_s=2.0)]
    lines = []
    outcomes = run_jobs(jobs, load_config("kenworth"), 2, lines.append)
    assert [o.result is not None for o in outcomes] == [True, False, True, True]
    assert "killed" in outcomes[1].error
    assert len(lines) == 4
    assert not list(tmp_path.iterdir())  # half a file is none


@pytest.mark.parametrize(
    ("log", "name"),
    [("a.log", "a"), ("b/a.log.xz", "a"), ("a.b.csv.gz", "a.b"), ("trip.parquet", "trip"), ("a", "a")],
)
def test_names_of_logs(log, name):
    assert log_name(Path(log)) == name


def test_names_that_are_equal(tmp_path):
    logs = [tmp_path / "x" / "a.log", tmp_path / "y" / "x" / "a.log"]
    with pytest.raises(UsageError, match="same file"):
        unique_names(logs)


def test_logs_are_shown_by_the_shortest_unique_path():
    paths = ["/d/a/x.log", "/d/b/x.log", "/e/b/x.log", "y.log", "/d/b/y.log", "z.log", "./z.log"]
    shown = ["a/x.log", "d/b/x.log", "e/b/x.log", "y.log", "b/y.log", "z.log", "z.log"]
    assert short_names(paths) == shown


def test_a_name_with_a_line_break_is_one_line():
    assert short_names(["/d/new\nline.log", "x.log"]) == [r"new\nline.log", "x.log"]


def test_a_log_among_many_without_an_estimate_has_a_reason(tmp_path):
    empty = tmp_path / "empty.log"
    empty.touch()
    message = "\n".join(many_lines(pooled(run_jobs([Job(KENWORTH), Job(empty)], load_config("kenworth"), 1))))
    assert "note: empty.log: no estimate: the log is empty" in message


def test_truth_beside_a_log(tmp_path):
    log = tmp_path / "a.log.xz"
    assert truth_beside(log) is None
    (tmp_path / "a.truth.csv").touch()
    assert truth_beside(log) == tmp_path / "a.truth.csv"


def opened_by_a_reader(fifo: Path, timeout_s: float = 60.0) -> int:
    """Wait until somebody reads a FIFO; return our end of it."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        try:
            return os.open(fifo, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:
            time.sleep(0.05)
    raise TimeoutError(fifo)


def test_interrupt_ends_it_soon_and_quietly(tmp_path):
    logs = [tmp_path / f"{i}.log" for i in range(4)]
    for log in logs:  # logs that never come: reading them takes forever
        os.mkfifo(log)
    process = subprocess.Popen(
        [sys.executable, "-m", "canest", "replay", *map(str, logs), "-c", "kenworth", "-j", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 - a background job ignores it
    )  # fmt: skip
    ends = [opened_by_a_reader(log) for log in logs[:2]]
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30)
    for end in ends:
        os.close(end)
    assert process.returncode == 1, err
    assert err.split() == ["interrupted"]


def test_an_interrupt_does_not_fall_on_a_server_that_is_still_importing():
    """It reaches the whole group at once. The server holds it back, and its workers take it again."""
    code = (
        "import signal, subprocess, sys\n"
        "from multiprocessing import forkserver\n"
        "from canest.batch import pool\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    workers = pool._pool(1)\n"
        "    server = forkserver._forkserver._forkserver_pid\n"
        "    held = [l for l in open(f'/proc/{server}/status') if l.startswith('SigBlk')][0].split()[1]\n"
        "    ours = signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
        "    theirs = workers.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()\n"
        "    held = bool(int(held, 16) & 1 << signal.SIGINT - 1)\n"
        "    print(held, signal.SIGINT in ours, signal.SIGINT in theirs)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.split() == ["True", "False", "False"], done.stderr
