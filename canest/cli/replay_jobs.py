"""The jobs of `canest replay`: one per log, with its truth and the files that it writes.

Apart from the command, whose help needs neither paths nor logs.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from canest.batch.job import Job
from canest.config.database_files import config_files
from canest.core.errors import UsageError
from canest.logs.estimate_writer import ESTIMATE_ENDINGS, FRAME_ENDINGS, refuse_other_formats
from canest.logs.log_names import truth_beside, truth_file
from canest.system.output_conflicts import keep_apart

if TYPE_CHECKING:
    from canest.cli.options import Outputs, TruthChoice
    from canest.config import Config


def jobs_of(logs: Sequence[str], truth: TruthChoice, channel: str | None) -> list[Job]:
    """Return one job per log, each with its truth. Errors: UsageError where --truth fits none."""
    paths = [Path(log) for log in logs]
    for path in paths if sys.stderr.isatty() else ():
        if path.is_fifo() and path.parts[1:2] not in (("dev",), ("proc",)):  # those are the shell's own
            print(f"note: {path} is a pipe: waiting for what writes to it", file=sys.stderr, flush=True)
    if len(paths) == 1:
        truths = [truth_file(paths[0], truth.truth)]
    elif truth.truth is None:
        truths = [None for _ in paths]
    elif truth.truth == "auto":
        truths = [truth_beside(log) for log in paths]
        _report_missing_truths(paths, truths)
    else:
        raise click.UsageError(
            "one truth cannot fit several logs: use --truth auto", click.get_current_context()
        )
    return [
        Job(log, truth=found, mass_kg=truth.mass_kg, after_s=truth.after_s, channel=channel)
        for log, found in zip(paths, truths, strict=True)
    ]


def refuse_outputs(jobs: Sequence[Job], config: Config, json_path: str | None) -> None:
    """Refuse results that would overwrite an input, and tables of no known format. Errors: UsageError."""
    keep_apart(
        config_files(config)
        + [(f"the log {job.log}", job.log) for job in jobs]
        + [(f"the truth {job.truth}", job.truth) for job in jobs],
        [("-o", job.output) for job in jobs]
        + [("--report", job.report) for job in jobs]
        + [("--json", json_path)],
    )
    for job in jobs:
        if job.output is not None:
            refuse_other_formats(job.output, "-o")


def with_outputs(jobs: list[Job], outputs: Outputs, config: Config) -> list[Job]:
    """Return the jobs with the files that they are to write.

    Errors: UsageError for a file's name where several logs need a directory, and for an unknown column.
    """
    if outputs.columns is not None:
        from canest.offline.extra_columns import checked  # wanted for this option alone

        columns = checked([name.strip() for name in outputs.columns.split(",") if name.strip()])
        jobs = [replace(job, columns=columns) for job in jobs]
    if outputs.output is not None and outputs.output.lower().endswith(FRAME_ENDINGS):
        from canest.node.broadcast_log import RecordedLog, open_broadcast_log  # as above

        beside = [RecordedLog(job.log, job.channel) if outputs.with_frames else None for job in jobs]
        jobs = [
            replace(job, opened=partial(open_broadcast_log, config.broadcast, log))
            for job, log in zip(jobs, beside, strict=True)
        ]
    elif outputs.with_frames:
        raise click.UsageError(
            "--with-frames needs a log of frames: -o NAME.log or NAME.blf", click.get_current_context()
        )
    output, report = outputs.output, outputs.report
    if len(jobs) > 1:
        _refuse_a_file("-o", output, ESTIMATE_ENDINGS)
        _refuse_a_file("--report", report, (".html", ".htm"))
    # one log into one file, the usual case, does without the processes that `canest.batch.pool` brings
    if len(jobs) > 1 or (output is not None and (output.endswith("/") or Path(output).is_dir())):
        from canest.batch import pool

        reports = Path(report) if report and len(jobs) > 1 else None
        jobs = pool.with_outputs(jobs, Path(output) if output else None, reports)
        if reports is not None:
            jobs = _with_one_script(jobs, reports)
    elif output is not None:
        jobs = [replace(jobs[0], output=Path(output))]
    if report is not None and len(jobs) == 1:
        jobs = [replace(jobs[0], report=Path(report))]
    return jobs


def _with_one_script(jobs: list[Job], directory: Path) -> list[Job]:
    """Write plotly once, beside the reports that show it. Errors: OutputError, UsageError."""
    from canest.report.index_page import INDEX  # wanted for reports alone
    from canest.report.page import write_scripts  # as above

    for job in jobs:
        if job.report is not None and job.report.name == INDEX:
            raise UsageError(
                "the report of this log would replace the index of all", where="--report", found=str(job.log),
                expected="another name of the log",
            )  # fmt: skip
    script = write_scripts(directory)
    return [replace(job, report_script=script) for job in jobs]


def _report_missing_truths(logs: list[Path], truths: Sequence[Path | None]) -> None:
    """Print which logs have no truth beside them. Errors: UsageError when none has."""
    lacking = [log.name for log, found in zip(logs, truths, strict=True) if found is None]
    if len(lacking) == len(logs):
        raise click.UsageError("--truth auto: no log has its truth beside it", click.get_current_context())
    if lacking:
        shown = ", ".join(lacking[:3]) + (", ..." if len(lacking) > 3 else "")
        print(f"note: no truth beside {len(lacking)} of {len(logs)} logs: {shown}", file=sys.stderr)


def _refuse_a_file(option: str, name: str | None, endings: tuple[str, ...]) -> None:
    """Refuse a name that is a file's where several logs need a directory."""
    if name is None or name.endswith("/"):
        return
    path = Path(name)
    if path.is_file() or (path.name.lower().endswith(endings) and not path.is_dir()):
        context = click.get_current_context()
        raise click.UsageError(
            f"{option}: found the file {name}, expected a directory for several logs", context
        )
