"""A recorded log through the pipeline, streamed: memory does not grow with the log."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from canest.core import jit
from canest.core.samples import STATUS_LABELS
from canest.doctor.facts import FactsCheck
from canest.doctor.reasons import why_unestimated
from canest.logs.compression import ARCHIVE_SUFFIXES
from canest.logs.estimate_file import Decimals, EstimateWriter
from canest.logs.estimate_writer import open_writer
from canest.logs.memory import MemoryLog
from canest.offline.leg import Leg
from canest.offline.legs import Legs, Motion
from canest.offline.log_run import LogRun, Progress
from canest.offline.reported_masses import ReportedMasses
from canest.offline.run_warnings import run_warnings
from canest.pipeline.pipeline import Listener, TickListener

if TYPE_CHECKING:
    from canest.config import Config
    from canest.core.estimates import Estimates
    from canest.offline.extra_columns import ExtraColumns
    from canest.offline.scoring import Reference, Score

#: opens the file for estimates, with the decimals of its further columns
OpenWriter = Callable[[Path, Decimals], EstimateWriter]

#: a 1,000 frames/s bus as candump text, and how much smaller archives of it are
TEXT_BYTES_PER_S, ARCHIVE_RATIO = 50_000.0, 7.0
#: importing numba costs about this much; interpreted kernels cost this much per second of log
NUMBA_S, INTERPRETED_S_PER_S = 0.45, 0.45 / 2700


class Output(NamedTuple):
    """The file for the estimates of a log. columns: further ones in it. opened: how it is opened."""

    path: Path
    columns: tuple[str, ...] = ()
    opened: OpenWriter = open_writer


@dataclass(slots=True)
class ReplayResult:
    """What a replay found.

    summary: the content of summary.json. legs: the load legs in order of time, as in its "legs".
    warnings: what a user should know beside it, one sentence each.
    innovations: statistics of the estimator's own innovations (`nis`, `low_nis`, `runs_z`, `windows`), where
        it has any.
    """

    log: str
    summary: dict[str, Any]
    score: Score | None = None
    warnings: list[str] = field(default_factory=list)
    innovations: dict[str, float] = field(default_factory=dict)
    legs: list[Leg] = field(default_factory=list)

    @property
    def notes(self) -> list[str]:
        """Return `warnings` under its name of 0.1.0, with a DeprecationWarning."""
        import warnings  # wanted by the old name only

        warnings.warn("ReplayResult.notes is now ReplayResult.warnings", DeprecationWarning, stacklevel=2)
        return self.warnings


def replay(
    log: str | Path | MemoryLog,
    config: Config,
    *,
    output: str | Path | Output | None = None,
    reference: Reference | None = None,
    listener: Listener | None = None,
    tick_listener: TickListener | None = None,
    progress: Progress | None = None,
    channel: str | None = None,
) -> ReplayResult:
    """Estimate from one log.

    output: file for the estimates.
    reference: what they are compared with.
    listener: gets the model samples with their estimates. tick_listener: gets the roles before.
    channel: this interface of the log only.
    Errors: LogError, ConfigError, OutputError.
    """
    begin = time.perf_counter()
    jit.enable(compiling_pays([log]))
    if output is not None and not isinstance(output, Output):
        output = Output(Path(output))
    motion, driven, reported, facts = Motion(), Legs(), ReportedMasses(config), FactsCheck(config)
    more = _extra_columns(output)
    run = LogRun(
        log,
        config,
        listeners=[each for each in (motion, listener, more) if each is not None],
        tick_listener=tick_listener,
        channel=channel,
        reported=reported,
        facts=facts,
    )
    score = reference.score(settled=True) if reference is not None and reference.known else None
    last: Estimates | None = None
    with closing(run.reader), _opened(output, more) as writer:
        for estimates in run.estimates(progress):
            if writer is not None:
                writer.write(estimates, more.take() if more is not None else None)
            settled = driven.add(estimates, motion.taken())
            if score is not None:
                score.add(estimates, settled)
            last = estimates
    legs = driven.legs()
    if score is not None:
        legs = score.with_truth(legs)
    others, legs = reported.compared(legs)
    summary = _summary(run, last) | _legs_summary(driven, legs)
    summary["reported_masses"] = [mass.to_json() for mass in others]
    if score is not None:
        summary["errors"] = score.errors()
    notes = run_warnings(run, score) + facts.notes(run.pipeline.intake)
    summary["notes"] = notes
    summary["wall_s"] = round(time.perf_counter() - begin, 4)
    snapshot = run.pipeline.snapshot()
    innovations: dict[str, float] = {
        name: float(snapshot[name]) for name in ("nis", "low_nis", "runs_z", "windows") if name in snapshot
    }
    return ReplayResult(str(log), summary, score, notes, innovations, legs)


def _extra_columns(output: Output | None) -> ExtraColumns | None:
    """Return what takes the columns that are wanted beside those of est.csv, None for none."""
    if output is None or not output.columns:
        return None
    from canest.offline.extra_columns import ExtraColumns  # wanted for further columns alone

    return ExtraColumns(output.columns)


def _opened(
    output: Output | None, more: ExtraColumns | None
) -> AbstractContextManager[EstimateWriter | None]:
    if output is None:
        return nullcontext()
    return output.opened(output.path, more.decimals if more is not None else {})


def compiling_pays(logs: Sequence[str | Path | MemoryLog], passes: int = 1) -> bool:
    """Return whether logs are so long that compiled kernels win back what importing numba costs.

    passes: how often the kernels go over each.
    """
    size = sum(map(_text_bytes, logs))
    return jit.available() and passes * size / TEXT_BYTES_PER_S * INTERPRETED_S_PER_S > NUMBA_S


def _text_bytes(log: str | Path | MemoryLog) -> float:
    """Return about how long a log is as candump text."""
    if isinstance(log, MemoryLog):
        return log.text_bytes
    path = Path(log)
    packed = ARCHIVE_RATIO if path.suffix.lower() in ARCHIVE_SUFFIXES else 1.0
    with suppress(OSError):
        return packed * path.stat().st_size
    return 0.0


def _summary(run: LogRun, last: Estimates | None) -> dict[str, Any]:
    pipeline = run.pipeline
    status = STATUS_LABELS[int(last.status[-1])] if last is not None else STATUS_LABELS[0]
    summary: dict[str, Any] = {
        "frames": run.reader.frames,
        "skipped_lines": run.reader.skipped_lines,
        "not_decoded": pipeline.decoder.counters.lost(),
        "samples": pipeline.samples,
        "updated": pipeline.updated,
        "gates": pipeline.gate_counts,
        "stale_roles": pipeline.stale_ticks,
        "estimator": run.config.estimator.name,
        "mass_kg": _number(last.mass_kg[-1]) if last is not None else None,
        "mass_std_kg": _number(last.mass_std_kg[-1]) if last is not None else None,
        "status": status,
    }
    if status == STATUS_LABELS[0]:
        summary["reason"] = why_unestimated(run)
    return summary


def _legs_summary(driven: Legs, legs: Sequence[Leg]) -> dict[str, Any]:
    """Return what summary.json has of the load legs."""
    last = driven.last_valid
    return {
        "last_valid": None if last is None else {n: round(v, 3) for n, v in last._asdict().items()},
        "valid_share": round(driven.valid_share, 4),
        "driving_s": round(driven.driving_s, 2),
        "legs": [leg.to_json() for leg in legs],
    }


def _number(value: float) -> float | None:
    return None if value != value else round(float(value), 3)  # noqa: PLR0124 - NaN
