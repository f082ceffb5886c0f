"""All cores of this machine, without any server: a thread for each process that reads logs."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Iterator, Sequence

from canest.fleet.child import Child, Children
from canest.fleet.job import Bundles, FleetJob, Outcome, Settings


def run_local(
    jobs: Sequence[FleetJob], bundles: Bundles, settings: Settings, workers: int | None = None
) -> Iterator[Outcome]:
    """Yield what became of every job, as each one ends. workers: processes, None for one per core."""
    count = min(workers or len(os.sched_getaffinity(0)), len(jobs))
    waiting: queue.SimpleQueue[FleetJob] = queue.SimpleQueue()
    for job in sorted(
        jobs, key=lambda job: -job.log.text_bytes
    ):  # the longest first: none is left over at the end
        waiting.put(job)
    # bounded: results wait in the workers while the disk is slow, and not in memory
    done: queue.Queue[Outcome] = queue.Queue(2 * count)
    children, over = Children(), threading.Event()

    def work() -> None:
        with children.one() as child:
            while not over.is_set() and (job := _next(waiting)) is not None:
                outcome = _attempt(child, job, bundles, settings)
                while not over.is_set():
                    try:
                        done.put(outcome, timeout=0.2)
                        break
                    except queue.Full:
                        continue

    threads = [threading.Thread(target=work, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        for _ in jobs:
            yield done.get()
    finally:  # also where whoever takes them stops: Ctrl-C, a full disk
        over.set()
        children.close()
        for thread in threads:
            thread.join(5)


def _next(waiting: queue.SimpleQueue[FleetJob]) -> FleetJob | None:
    try:
        return waiting.get_nowait()
    except queue.Empty:
        return None


def _attempt(child: Child, job: FleetJob, bundles: Bundles, settings: Settings) -> Outcome:
    try:
        return child.run(job, bundles, settings)
    except Exception as error:
        return Outcome(job.log.name, error=f"unexpected {type(error).__name__}: {error}")
