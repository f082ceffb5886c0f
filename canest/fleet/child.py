"""Runs jobs in a process of their own: what hangs, eats memory or dies there costs its log alone.

A plain subprocess, since a Dask worker may have no children of multiprocessing.
"""

from __future__ import annotations

import os
import resource
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from canest.fleet.child_main import read_message, write_message
from canest.fleet.job import Bundles, FleetJob, Outcome, Settings
from canest.fleet.work_folder import work_folder

#: a log that takes its process along, or its time, gets so many tries
ATTEMPTS = 2
_LOOK_S = 0.05  #: how often a child's memory is looked at
_PAGE_BYTES = resource.getpagesize()


class Child:
    """A process that runs one job after another; it is started with the first, and anew where it had to end.

    Its temporary files are in a folder that ends with it, also where it is killed over them.
    peak_mb: the most memory that it was seen to take.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._folder = ExitStack()
        self._sent: set[str] = set()
        self._stopped = False
        self.peak_mb = 0.0

    def run(self, job: FleetJob, bundles: Bundles, settings: Settings) -> Outcome:
        """Run a job, twice if its process had to be ended over it."""
        outcome = Outcome(job.log.name)
        for _ in range(ATTEMPTS):
            if self._stopped:
                return outcome
            outcome = self._attempt(job, bundles, settings)
            if outcome.final or self._stopped:
                return outcome
        outcome.error += f", {ATTEMPTS} times"
        return outcome

    def stop(self) -> None:
        """End the process for good, whoever waits for it."""
        self._stopped = True
        self.close()

    def close(self) -> None:
        """End the process; the next job starts another."""
        process, self._process = self._process, None
        folder, self._folder = self._folder, ExitStack()
        self._sent.clear()
        with folder:
            if process is not None:
                self._end(process)

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        process.kill()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what it was sent does not reach it any more
                    pipe.close()
        process.wait()

    def _attempt(self, job: FleetJob, bundles: Bundles, settings: Settings) -> Outcome:
        if self._process is None:
            self._process = _start(self._folder.enter_context(work_folder()))
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        wanted = {digest for _, digest in job.rules}
        more = {digest: bundles[digest] for digest in wanted - self._sent}
        end_s = time.monotonic() + job.timeout_s(settings)
        try:
            write_message(process.stdin, (job, more, settings))
            while not select.select([process.stdout], [], [], _LOOK_S)[0]:
                memory_mb = _resident_mb(process.pid)
                self.peak_mb = max(self.peak_mb, memory_mb)
                if memory_mb > settings.memory_mb:
                    return self._ended(job, f"takes more than {settings.memory_mb:,.0f} MB of memory")
                if time.monotonic() > end_s:
                    return self._ended(job, f"takes more than {job.timeout_s(settings):,.0f} s")
            outcome: Outcome = read_message(process.stdout)
        except (EOFError, OSError):
            code = process.wait()
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            return self._ended(job, f"its process died ({how}; out of memory?)")
        self._sent |= wanted
        return outcome

    def _ended(self, job: FleetJob, error: str) -> Outcome:
        self.close()
        return Outcome(job.log.name, error=error, final=False)


class Children:
    """Children that wait for work: one for each thread that asks at a time."""

    def __init__(self) -> None:
        self._idle: list[Child] = []
        self._all: list[Child] = []
        self._lock = threading.Lock()

    @contextmanager
    def one(self) -> Iterator[Child]:
        """Lend a child."""
        with self._lock:
            child = self._idle.pop() if self._idle else Child()
            if child not in self._all:
                self._all.append(child)
        try:
            yield child
        finally:
            with self._lock:
                self._idle.append(child)

    def close(self) -> None:
        """End all of them, also those at work."""
        with self._lock:
            for child in self._all:
                child.stop()

    @property
    def peak_mb(self) -> float:
        """Return the most memory that any was seen to take."""
        return max((child.peak_mb for child in self._all), default=0.0)


def _start(folder: Path) -> subprocess.Popen[bytes]:
    single = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    return subprocess.Popen(
        [sys.executable, "-m", "canest.fleet.child_main", str(folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **single}, start_new_session=True,
    )  # fmt: skip


def _resident_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_BYTES / 1e6
    except (OSError, IndexError):
        return 0.0
