"""A Dask cluster: batches of logs as tasks, a bounded number of them at a time.

The scheduler holds some tasks per thread of its workers, however many logs there are: a million tasks at once
would take it gigabytes. What a worker takes along when it dies is tried again log by log; a log that does
this each time is named and left out.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from canest.core.errors import CanestError, UsageError
from canest.fleet.batch_task import Batch, Refused, batches_of, run_batch
from canest.fleet.bundle import Bundle, code_version
from canest.fleet.job import FleetJob, Outcome, Settings
from canest.fleet.packages import require

#: tasks with the scheduler at most, and per thread of the workers
MOST_TASKS, TASKS_PER_THREAD = 10_000, 3
LARGEST_BATCH = 50
#: how often logs are tried that workers die over
ATTEMPTS = 3
_CONNECT_S, _LOOK_S = 10.0, 2.0
#: with workers that stopped answering the scheduler deals itself (worker-ttl); this is for when it does not
_OVERDUE_FACTOR, _OVERDUE_S = 3.0, 600.0


@dataclass(slots=True)
class _Task:
    """A batch with the scheduler. attempts: before this one."""

    batch: Batch
    attempts: int
    end_s: float = field(default=0.0)


def run_on_dask(
    address: str, jobs: Sequence[FleetJob], bundles: dict[str, Bundle], settings: Settings
) -> Iterator[Outcome]:
    """Yield what became of every job, as its batch ends.

    Errors: UsageError where no scheduler answers, or where a worker runs another canest.
    """
    (distributed,) = require("distributed", why="--dask")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UsageError(
            "no Dask scheduler answers", where=f"--dask {address}", found=str(error),
            expected="the address that `dask scheduler` shows, like tcp://10.0.0.1:8786",
        ) from None  # fmt: skip
    with contextlib.closing(client):
        cluster = _Cluster(client)
        cluster.require_equal_versions()
        size = max(1, min(LARGEST_BATCH, len(jobs) // (4 * cluster.threads)))
        yield from _run(cluster, deque(batches_of(jobs, bundles, settings, size)))


class _Cluster:
    """The workers that take part. threads: of all of them."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self._looked_s = 0.0
        self._refused: set[str] = set()
        self.threads = 1
        self.look()

    @property
    def workers(self) -> list[str] | None:
        """Return the workers that may be used; None for all."""
        if not self._refused:
            return None
        return [address for address in self._addresses() if address not in self._refused]

    def refuse(self, address: str) -> None:
        """Give no more work to a worker."""
        self._refused.add(address)

    def look(self) -> None:
        """Count the threads of the workers, not too often."""
        if time.monotonic() - self._looked_s > _LOOK_S:
            self._looked_s = time.monotonic()
            self.threads = max(1, sum(self.client.nthreads().values()))

    def require_equal_versions(self) -> None:
        """Ask all workers what canest they run. Errors: UsageError that names those of another."""
        try:
            self.client.wait_for_workers(1, timeout=_CONNECT_S)
        except (TimeoutError, OSError):
            raise UsageError(
                "the Dask cluster has no workers", where="--dask", expected="`dask worker ADDRESS`, started"
            ) from None
        own = code_version()
        found = self.client.run(code_version, on_error="return")
        others = {address: version for address, version in found.items() if version != own}
        if others:
            address, version = next(iter(others.items()))
            raise UsageError(
                f"{len(others)} of {len(found)} workers run another canest", where=f"worker {address}",
                found=str(version), expected=f"{own}, installed in the worker's environment",
            )  # fmt: skip

    def _addresses(self) -> list[str]:
        return list(self.client.nthreads())


def _run(cluster: _Cluster, waiting: deque[Batch]) -> Iterator[Outcome]:
    again: deque[_Task] = deque()
    running: dict[Any, _Task] = {}
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def submit() -> None:
        cluster.look()
        room = min(MOST_TASKS, TASKS_PER_THREAD * cluster.threads) - len(running)
        while room > 0 and (again or waiting):
            task = again.popleft() if again else _Task(waiting.popleft(), 0)
            limit_s = sum(job.timeout_s(task.batch.settings) for job in task.batch.jobs)
            task.end_s = time.monotonic() + _OVERDUE_FACTOR * limit_s + _OVERDUE_S
            future = cluster.client.submit(run_batch, task.batch, pure=False, workers=cluster.workers)
            running[future] = task
            future.add_done_callback(finished.put)
            room -= 1

    try:
        submit()
        while running:
            with contextlib.suppress(queue.Empty):
                future = finished.get(timeout=_LOOK_S)
                task = running.pop(future, None)
                if task is not None:  # it may be overdue, and given up
                    yield from _taken(cluster, future, task, again)
                    future.release()
            for future in [f for f, task in running.items() if time.monotonic() > task.end_s]:
                yield from _retried(running.pop(future), "its worker does not answer", again)
                future.cancel(force=True)
            submit()
    finally:
        cluster.client.cancel(list(running), force=True)


def _taken(cluster: _Cluster, future: Any, task: _Task, again: deque[_Task]) -> Iterator[Outcome]:
    """Take the result of a task that ended, in whatever way."""
    try:
        result = future.result()
    except CanestError:
        raise
    except Exception as error:
        kind = type(error).__name__
        dead = "its worker died" if kind in ("KilledWorker", "CancelledError", "FutureCancelledError") else ""
        yield from _retried(task, dead or f"{kind}: {' '.join(str(error).split())[:200]}", again)
        return
    if isinstance(result, Refused):
        yield from _retried(task, f"its worker runs canest {result.version}", again)
        for address, version in cluster.client.run(code_version, on_error="return").items():
            if version != task.batch.settings.version:
                cluster.refuse(address)
        return
    yield from result


def _retried(task: _Task, error: str, again: deque[_Task]) -> Iterator[Outcome]:
    """Try the logs of a task again, one by one; yield those that have been tried enough."""
    attempts = task.attempts + 1
    for job in task.batch.jobs:
        if attempts >= ATTEMPTS:
            yield Outcome(job.log.name, error=f"{error}, {attempts} times")
        else:
            single = Batch((job,), task.batch.bundles, task.batch.settings)
            again.append(_Task(single, attempts))
