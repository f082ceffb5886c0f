"""A replay of many logs whose process is killed: its workers end with it, and its temporaries do not stay."""

from __future__ import annotations

import lzma
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from canest.logs.estimate_writer import open_writer

KENWORTH = Path(__file__).parents[1] / "data" / "kenworth" / "normal.log.xz"


def session_of(pid: int) -> list[int]:
    """Return the processes of a session that run."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                state, _, _, session = folder.joinpath("stat").read_text().rpartition(")")[2].split()[:4]
                if int(session) == pid and state != "Z":
                    found.append(int(folder.name))
    return found


def all_stopped(pid: int) -> bool:
    """Return whether every thread of a process is stopped, or the process is gone."""
    states = set()
    for task in Path(f"/proc/{pid}/task").glob("*"):
        with suppress(OSError):
            states.add(task.joinpath("stat").read_text().rpartition(")")[2].split()[0])
    return states <= {"T", "Z", "X"}


def kill_all(pid: int) -> None:
    """Kill every process of a session at once: stopped first, none can tidy up after another's death."""
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for member in session_of(pid):
            with suppress(ProcessLookupError):
                os.kill(member, number)
        if number == signal.SIGSTOP:  # comes to a thread when that thread runs again, on a busy machine late
            wait_for(lambda: all(all_stopped(member) for member in session_of(pid)))


def names_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []


def wait_for(condition: Callable[[], object], timeout_s: float = 60.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "not within its time"
        time.sleep(0.05)


@pytest.fixture
def fleet(tmp_path):
    """Start a replay of logs that never end; return it and its directory when its workers write there."""
    logs = [tmp_path / f"{i}.log" for i in range(3)]
    out = tmp_path / "out"
    text, over = lzma.decompress(KENWORTH.read_bytes())[:200_000], threading.Event()

    def feed(log):
        with suppress(OSError), log.open("wb", buffering=0) as pipe:
            pipe.write(text)
            over.wait(120)

    for log in logs:
        os.mkfifo(log)
        threading.Thread(target=feed, args=(log,), daemon=True).start()
    process = subprocess.Popen(
        [sys.executable, "-m", "canest", "replay", *map(str, logs), "-c", "kenworth", "-j", "2", "-o", out],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: {name.partition(".canest-")[0] for name in names_in(out)} == {".0.csv", ".1.csv"})
    yield process, out
    over.set()
    kill_all(process.pid)
    process.wait(10)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_gave_them_work(fleet, number):
    process, out = fleet
    assert len(session_of(process.pid)) > 2
    process.send_signal(number)
    process.wait(10)
    wait_for(lambda: not session_of(process.pid), 30)
    assert list(out.iterdir()) == []


def test_what_killed_workers_left_is_removed_by_the_next_run_and_nothing_else(fleet):
    process, out = fleet
    kill_all(process.pid)
    process.wait(10)
    wait_for(lambda: not session_of(process.pid), 30)
    left = list(out.iterdir())
    assert len(left) == 2
    (out / "mine.part").touch()
    with open_writer(out / "other.csv"):  # of a writer that lives
        (living,) = set(out.iterdir()) - {*left, out / "mine.part"}
        done = subprocess.run(
            [sys.executable, "-m", "canest", "replay", KENWORTH, "-c", "kenworth", "-o", out / "est.csv"],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert {p.name for p in out.iterdir()} == {"mine.part", "est.csv", living.name}
