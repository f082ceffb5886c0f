"""Thousands of logs: jobs run side by side on all cores; one bad log never stops the others."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import forkserver, get_context, parent_process, resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canest.batch.job import Job
from canest.config.database_files import read_databases
from canest.core.errors import CanestError, ConfigError, LogError, OutputError, UsageError
from canest.logs.log_names import log_name
from canest.offline.scoring import Score
from canest.system.atomic_file import remove_abandoned, unlink_unfinished

if TYPE_CHECKING:
    from canest.config import Config
    from canest.offline.replay import ReplayResult


@dataclass(slots=True)
class Outcome:
    """What became of a job: a result, or one line with the reason why there is none."""

    job: Job
    result: ReplayResult | None = None
    error: str = ""


def with_outputs(jobs: Sequence[Job], directory: Path | None, reports: Path | None) -> list[Job]:
    """Return the jobs with NAME.csv and NAME.html in the directories, which are made.

    Errors: OutputError; UsageError when two logs would write the same file.
    """
    for folder in (directory, reports):
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"cannot make the directory: {error.strerror}", where=str(folder)) from None
    names = unique_names([job.log for job in jobs]) if directory or reports else [job.name for job in jobs]
    return [
        replace(
            job,
            output=directory / f"{name}.csv" if directory else None,
            report=reports / f"{name}.html" if reports else None,
        )
        for job, name in zip(jobs, names, strict=True)
    ]


def unique_names(logs: Sequence[Path]) -> list[str]:
    """Return one name per log; logs of one name get their folder's name in front.

    Errors: UsageError when that does not make them differ.
    """
    plain = [log_name(log) for log in logs]
    names = [
        f"{log.resolve().parent.name}-{name}" if plain.count(name) > 1 else name
        for log, name in zip(logs, plain, strict=True)
    ] if len(set(plain)) < len(plain) else plain  # fmt: skip
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        alike = [str(log) for log, name in zip(logs, names, strict=True) if name == twice]
        raise UsageError(
            f"two logs would write the same file, {twice}.csv",
            where="-o",
            found=" and ".join(alike[:2]),
            expected="different names",
        )
    return names


def run_jobs(
    jobs: Sequence[Job],
    config: Config,
    workers: int | None = None,
    done: Callable[[Outcome], None] | None = None,
) -> list[Outcome]:
    """Run every job and return what became of each, in their order; `done` is called as each one ends.

    Errors: ConfigError, which ends them all.
    """
    workers = min(workers or len(os.sched_getaffinity(0)), len(jobs))
    outcomes: dict[Job, Outcome] = {}
    for outcome in _serial(jobs, config) if workers <= 1 else _parallel(list(jobs), config, workers):
        outcomes[outcome.job] = outcome
        if done is not None:
            done(outcome)
    return [outcomes[job] for job in jobs]


def _serial(jobs: Iterable[Job], config: Config) -> Iterator[Outcome]:
    for job in jobs:
        yield _attempt(job, config)


def _parallel(jobs: list[Job], config: Config, workers: int) -> Iterator[Outcome]:
    """Run in processes. Should one die (out of memory), the jobs it took along run again one by one."""
    unfinished: list[Job] = []
    with _pool(workers) as pool:
        futures: dict[Future[Outcome], Job] = {}
        try:
            for job in jobs:
                futures[pool.submit(_attempt_elsewhere, job, config)] = job
            for future in as_completed(futures):
                try:
                    yield future.result()
                except BrokenProcessPool:
                    unfinished.append(futures[future])
        except BaseException:  # interrupted: do not work off what is still waiting
            pool.shutdown(cancel_futures=True)
            _clear(jobs)
            raise
    for job in unfinished:
        with _pool(1) as pool:
            try:
                yield pool.submit(_attempt_elsewhere, job, config).result()
            except BrokenProcessPool:
                _clear([job])
                yield Outcome(job, error=f"{job.log}: the process that read it was killed (out of memory?)")


def _clear(jobs: Iterable[Job]) -> None:
    """Remove the half of their results that processes left which were killed over it."""
    for folder in {path.parent for job in jobs for path in (job.output, job.report) if path is not None}:
        remove_abandoned(folder)


def _pool(workers: int) -> ProcessPoolExecutor:
    # forked from a clean server: a fork of this process would inherit its threads' locks
    context = get_context("forkserver")
    context.set_forkserver_preload(["canest.offline.replay"])
    # it ignores interrupts once it has imported all of this, and must not fall over one before
    resource_tracker.ensure_running()  # which takes interrupts again when it starts
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    ignores = signal.getsignal(signal.SIGINT) == signal.SIG_IGN  # a background job of a shell does
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(ignores,))


def _begin_worker(ignores_interrupts: bool) -> None:
    # Ctrl-C ends a worker at once, in whatever it waits for, unless it does not end its parent
    signal.signal(signal.SIGINT, signal.SIG_IGN if ignores_interrupts else signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    threading.Thread(target=_end_with_parent, name="canest-parent", daemon=True).start()


def _end_with_parent() -> None:
    """End this worker when the process that gives it work is gone, in whatever way that ended.

    The kernel's own signal (PR_SET_PDEATHSIG) comes at the death of the server that forked the worker, and
    that one waits for its workers. The pipe that is waited for here is closed by the death of the right one.
    """
    parent = parent_process()
    assert parent is not None
    parent.join()
    unlink_unfinished()
    os._exit(1)


def _attempt_elsewhere(job: Job, config: Config) -> Outcome:
    """Run a job in a worker, to which a config comes without its databases. Errors: ConfigError."""
    return _attempt(job, read_databases(config))


def _attempt(job: Job, config: Config) -> Outcome:
    """Run a job; whatever goes wrong with this log stays with this log. Errors: ConfigError."""
    try:
        return Outcome(job, job.run(config))
    except ConfigError:  # of no log in particular
        raise
    except CanestError as error:
        text = str(error)
        return Outcome(job, error=text if str(job.log) in text else f"{job.log}: {text}")
    except Exception as error:
        return Outcome(
            job, error=str(LogError(f"unexpected {type(error).__name__}: {error}", where=str(job.log)))
        )


def pooled(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the summary of many logs: sums, pooled errors, and each log's own summary under `logs`."""
    results = [o.result for o in outcomes if o.result is not None]
    summary: dict[str, Any] = {
        key: sum(r.summary[key] for r in results) for key in ("frames", "skipped_lines", "samples", "updated")
    }
    gates: dict[str, int] = {}
    for result in results:
        for gate, count in result.summary["gates"].items():
            gates[gate] = gates.get(gate, 0) + count
    summary["gates"] = gates
    summary["estimator"] = results[0].summary["estimator"] if results else None
    summary["mass_kg"] = summary["mass_std_kg"] = None
    summary["wall_s"] = round(sum(r.summary["wall_s"] for r in results), 4)
    summary["driving_s"] = round(sum(r.summary["driving_s"] for r in results), 2)
    valid_s = sum(r.summary["valid_share"] * r.summary["driving_s"] for r in results)
    summary["valid_share"] = round(valid_s / summary["driving_s"], 4) if summary["driving_s"] else 0.0
    scores: list[Score] = [r.score for r in results if r.score is not None]
    if scores:
        total = Score(None, None, scores[0].after_s)
        for score in scores:
            total.merge(score)
        summary["errors"] = total.errors()
    summary["failed"] = sum(1 for o in outcomes if o.result is None)
    summary["logs"] = [
        {"log": str(o.job.log)} | ({"error": o.error} if o.result is None else o.result.summary)
        for o in outcomes
    ]
    return summary
