"""Copies of logs from a store: they go with their log, and also where the process was killed over it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from canest.fleet.work_folder import PREFIX, work_folder
from tests.fleet.conftest import ROOT, wait_for

HOLDS = """
import time
from canest.fleet.work_folder import work_folder
with work_folder() as folder:
    (folder / "copy.log").write_text("x")
    print(folder, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def age(folder: Path) -> None:
    hour_ago = time.time() - 3600
    os.utime(folder, (hour_ago, hour_ago))


def test_what_a_killed_process_left_is_removed_by_the_next_and_what_one_uses_is_not(temporary):
    environment = os.environ | {"TMPDIR": str(temporary)}
    processes = [
        subprocess.Popen([sys.executable, "-c", HOLDS], cwd=ROOT, env=environment, stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    try:
        wait_for(lambda: len(list(temporary.glob(f"{PREFIX}*/copy.log"))) == 2)
        killed, lives = (Path(process.stdout.readline().decode().strip()) for process in processes)
        processes[0].send_signal(signal.SIGKILL)
        processes[0].wait(10)
        (temporary / f"{PREFIX}new").mkdir()  # made just now, not yet locked
        for folder in (killed, lives):
            age(folder)
        with work_folder() as own:
            assert set(temporary.iterdir()) == {lives, own, temporary / f"{PREFIX}new"}
            assert (lives / "copy.log").exists()
        assert not own.exists()
    finally:
        for process in processes:
            process.kill()
            process.wait(10)
            process.stdout.close()
