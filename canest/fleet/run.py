"""`canest fleet run`: plan, engine, lake, and what came of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

from canest.fleet.bundle import code_version
from canest.fleet.compiling import compile_kernels
from canest.fleet.job import Outcome, Settings
from canest.fleet.lake import Lake
from canest.fleet.local_engine import run_local
from canest.fleet.manifest import Manifest
from canest.fleet.packages import require
from canest.fleet.plan import Plan, bundles_of_rules, make_plan
from canest.fleet.source import find_logs
from canest.fleet.storage import StoreError
from canest.offline.replay import TEXT_BYTES_PER_S

#: loading compiled kernels costs a process about 3.5 s, and saves it 0.2 s for each 300 s of log
COMPILED_FROM_S = 5000.0
#: logs in a row that cannot be fetched, after which the rest is not tried: the store is gone
UNREACHABLE_MOST = 20


@dataclass(frozen=True, slots=True)
class Request:
    """What a run is asked for. source, lake: paths or URLs. workers, dask: the engine."""

    source: str
    lake: str
    manifest: Manifest
    settings: Settings
    workers: int | None = None
    dask: str | None = None
    resume: bool = False


@dataclass(slots=True)
class Tally:
    """What came of a run so far.

    failed, unmatched, lacking: log -> why. damaged: files of the lake, removed.
    """

    logs: int = 0
    done: int = 0
    present: int = 0
    trips: int = 0
    samples: int = 0
    failed: dict[str, str] = field(default_factory=dict)
    unmatched: dict[str, str] = field(default_factory=dict)
    lacking: dict[str, str] = field(default_factory=dict)
    passed_over: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    begin_s: float = field(default_factory=time.monotonic)

    def add(self, outcome: Outcome) -> None:
        """Count a log."""
        self.logs += 1
        if outcome.unmatched:
            self.unmatched[outcome.name] = outcome.unmatched
        elif outcome.error:
            self.failed[outcome.name] = outcome.error
        else:
            self.done += not outcome.present
            self.present += outcome.present
            self.trips += outcome.trips
            self.samples += outcome.samples or 0
            if outcome.lacks:
                self.lacking[outcome.name] = outcome.lacks

    @property
    def is_complete(self) -> bool:
        """Return whether the lake has the result of every log."""
        return not self.failed and not self.unmatched

    def to_json(self) -> dict[str, Any]:
        """Return all of it as JSON types, in an order that does not depend on who was first."""
        return {
            "logs": self.logs,
            "done": self.done,
            "present": self.present,
            "trips": self.trips,
            "samples": self.samples,
            "failed": [{"log": log, "error": self.failed[log]} for log in sorted(self.failed)],
            "unmatched": [{"log": log, "reason": self.unmatched[log]} for log in sorted(self.unmatched)],
            "lacking": [{"log": log, "reason": self.lacking[log]} for log in sorted(self.lacking)],
            "passed_over": sorted(self.passed_over),
            "damaged": sorted(self.damaged),
            "wall_s": round(time.monotonic() - self.begin_s, 3),
        }


def run_fleet(
    request: Request,
    begun: Callable[[Mapping[str, float]], None],
    step: Callable[[Outcome], None],
    compiling: Callable[[], None],
) -> Tally:
    """Run all logs and return what came of them; whatever is done stays done, however the run ends.

    begun: called with the logs and how much work each is. step: called as each log ends. compiling: called
    where the kernels must be compiled first.
    Errors: CanestError, where the run as a whole cannot go on (a full disk, a config that is wrong).
    """
    require("pyarrow", "fsspec", why="canest fleet run")
    listing = find_logs(request.source)
    bundles = bundles_of_rules(request.manifest)
    lake = Lake.create(request.lake)  # last: a config that is wrong leaves nothing behind
    with_samples = request.settings.samples_hz > 0
    plan = make_plan(
        listing, request.manifest, bundles, lake, resume=request.resume, with_samples=with_samples
    )
    tally = Tally(passed_over=listing.passed_over, damaged=lake.removed)
    begun({log.name: log.text_bytes for log in listing.logs})
    for outcome in plan.unmatched:
        tally.add(outcome)
        step(outcome)
    with closing(_outcomes(request, plan, lake, compiling)) as outcomes:
        unreachable = 0
        for outcome in outcomes:
            if outcome.key:  # of a log that cannot be read any more, too: its old result goes
                lake.commit(outcome)
            tally.add(outcome)
            step(outcome)
            unreachable = unreachable + 1 if outcome.unreachable else 0
            if unreachable == UNREACHABLE_MOST:
                kept = tally.done + tally.present
                raise StoreError(
                    f"does not answer for {unreachable} logs in a row", where=request.source,
                    found=outcome.error, expected=f"--resume when it does: {kept:,} logs are done and kept",
                )  # fmt: skip
    return tally


def _compiling_pays(plan: Plan) -> bool:
    """Return whether the kernels win back in each process of this machine what loading them costs it."""
    text_bytes = sum(job.log.text_bytes for job in plan.jobs)
    return text_bytes / TEXT_BYTES_PER_S > COMPILED_FROM_S * (os.cpu_count() or 1)


def _outcomes(
    request: Request, plan: Plan, lake: Lake, compiling: Callable[[], None]
) -> Generator[Outcome, None, None]:
    # through a store everybody can write to, results need not pass here
    where = "" if lake.storage.is_local else lake.storage.url()
    settings = replace(request.settings, version=code_version(), lake=where, compiled=_compiling_pays(plan))
    if not plan.jobs:
        return
    if request.dask is None:
        if settings.compiled:
            compile_kernels(plan.bundles, compiling)
        yield from run_local(plan.jobs, plan.bundles, settings, request.workers)
        return
    from canest.fleet.dask_engine import run_on_dask  # dask is wanted for a cluster alone

    yield from run_on_dask(request.dask, plan.jobs, plan.bundles, settings)
