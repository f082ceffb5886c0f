"""What runs inside a Dask worker: a batch of logs, each in a process of its own."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from canest.fleet.bundle import Bundle, code_version
from canest.fleet.child import Children
from canest.fleet.compiling import compile_kernels
from canest.fleet.job import FleetJob, Outcome, Settings

_children = Children()
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Batch:
    """Logs with all that a machine needs which has nothing but canest. bundles: digest -> config."""

    jobs: tuple[FleetJob, ...]
    bundles: dict[str, Bundle]
    settings: Settings


@dataclass(frozen=True, slots=True)
class Refused:
    """The answer of a worker that runs other code. version: its own."""

    version: str


def run_batch(batch: Batch) -> list[Outcome] | Refused:
    """Return what became of the logs of a batch, in order."""
    if code_version() != batch.settings.version:
        return Refused(code_version())
    if batch.settings.compiled:
        compile_kernels(batch.bundles, lambda: _log.info("compiles the kernels, once after an installation"))
    with _children.one() as child:
        return [child.run(job, batch.bundles, batch.settings) for job in batch.jobs]


def batches_of(
    jobs: Sequence[FleetJob], bundles: dict[str, Bundle], settings: Settings, size: int
) -> list[Batch]:
    """Return the jobs in batches of a size with the configs that they need, logs of one config together."""
    ordered = sorted(jobs, key=lambda job: (job.rules[0][1], job.log.name))
    found = []
    for first in range(0, len(ordered), size):
        part = tuple(ordered[first : first + size])
        needed = {digest for job in part for _, digest in job.rules}
        found.append(Batch(part, {digest: bundles[digest] for digest in sorted(needed)}, settings))
    return found
