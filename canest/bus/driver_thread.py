"""A thread for what a driver may take its time for: to open, to send, to close. It never reads.

A reader thread that dies of an unplugged adapter leaves a daemon that looks healthy and receives nothing.
Whatever goes wrong in this one is seen by the loop: what was asked for is not done.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue


class Job:
    """One call into a driver.

    run: must not raise.
    """

    def __init__(self, run: Callable[[], None]) -> None:
        self._run = run
        self._done = threading.Event()

    def done(self, wait_s: float = 0.0) -> bool:
        """Return whether it is over, after ``wait_s`` at most."""
        return self._done.wait(wait_s)

    def work(self) -> None:
        """Do it, in the thread."""
        try:
            self._run()
        finally:
            self._done.set()


class DriverThread:
    """Does one job after the other. It starts with the first, and does not keep the process from ending."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._runs = False

    def do(self, run: Callable[[], None]) -> Job:
        """Do a job after those before it; returns at once."""
        if not self._runs:
            self._runs = True
            threading.Thread(target=_work, args=(self._jobs,), name=self._name, daemon=True).start()
        job = Job(run)
        self._jobs.put(job)
        return job

    @property
    def waiting(self) -> int:
        """Return how many jobs have not begun yet."""
        return self._jobs.qsize()

    def end(self) -> None:
        """End the thread after the jobs that wait; the next job starts another."""
        if self._runs:
            self._jobs.put(None)
            self._jobs, self._runs = SimpleQueue(), False


def _work(jobs: SimpleQueue[Job | None]) -> None:
    while (job := jobs.get()) is not None:
        job.work()
        del job  # else it, and the bus it refers to, would live until the next one comes
