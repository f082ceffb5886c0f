"""`canest replay`: estimates from recorded logs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from canest.cli.options import config_option, load, log_budget_option, override_options, truth_options

if TYPE_CHECKING:
    from canest.batch.job import Job
    from canest.config import Config

EPILOG = """\b
Examples:
  canest replay drive.log.xz -c class8                     what does this log say?
  canest replay drive.log -c my.yaml -o est.csv --report est.html
  canest replay drive.log -c my.yaml --truth drive.truth.csv --json -
  canest replay fleet/*.log.gz -c my.yaml -o results/ --truth auto
  canest replay trip.csv -c bmw-i3 --mass 1520             a table of decoded signals
  canest replay drive.log --to socketcan:vcan0             onto a bus, as it was driven

\b
Logs: candump text in both its forms, .asc .blf .trc .mf4 .csv .db, and tables (.csv .parquet),
plain or compressed (.gz .xz .zst .bz2).
"""

#: of files that hold estimates; what says another format (.xlsx, .csv.gz) would hold csv all the same
_TABLE_ENDINGS = (".csv", ".parquet", ".txt", "")


@click.command(epilog=EPILOG)
@click.argument("logs", nargs=-1, required=True, metavar="LOG...")
@config_option(required=False)
@click.option(
    "-o", "--output", metavar="PATH", help="Estimates as .csv or .parquet; a directory for several logs."
)
@click.option("--json", "json_path", metavar="PATH", help="Write the summary as JSON ('-': to stdout).")
@click.option("--report", metavar="HTML", help="Write an HTML report; a directory for several logs.")
@truth_options
@override_options
@click.option("--channel", metavar="NAME", help="Use this interface of the log only (can0, can1, ...).")
@log_budget_option
@click.option(
    "--to",
    "bus",
    metavar="INTERFACE:CHANNEL",
    help="Send the log onto a bus; estimate from it only where -o, --json or --report ask for it.",
)
@click.option(
    "--speed",
    type=float,
    metavar="FACTOR",
    help="With --to: times real time "
    "(default 1; a daemon that listens takes frames as they come: at any other its mass is wrong).",
)
@click.option(
    "-j", "--jobs", "workers", type=click.IntRange(1), metavar="N", help="Logs at a time (default: cores)."
)
def command(
    logs: tuple[str, ...],
    config_name: str | None,
    output: str | None,
    json_path: str | None,
    report: str | None,
    truth: str | None,
    mass_kg: float | None,
    after_s: float,
    estimator: str | None,
    initial_mass: float | None,
    overrides: tuple[str, ...],
    channel: str | None,
    bus: str | None,
    speed: float | None,
    workers: int | None,
) -> int:
    """Estimate mass and grade from recorded logs, as fast as they can be read."""
    playing = bus is not None or speed is not None
    if playing and output is None and json_path is None and report is None:
        if config_name is not None:
            # of no use here, but no reason to be wrong
            load(config_name, overrides, estimator, initial_mass, databases=False)
        _play(logs, bus, speed, channel)
        return 0
    if output == "-":
        raise click.UsageError("-o needs the name of a file or directory", click.get_current_context())
    if config_name is None:
        raise click.UsageError("missing option -c CONFIG", click.get_current_context())
    config = load(config_name, overrides, estimator, initial_mass)
    from canest.batch.job import Job
    from canest.logs.log_names import truth_beside, truth_file

    paths = [Path(log) for log in logs]
    if len(paths) == 1:
        truths = [truth_file(paths[0], truth)]
    elif truth in (None, "auto"):
        truths = [truth_beside(log) if truth else None for log in paths]
        if truth:
            _tell_missing(paths, truths)
    else:
        raise click.UsageError(
            "one truth cannot fit several logs: use --truth auto", click.get_current_context()
        )
    jobs = [
        Job(log, truth=found, mass_kg=mass_kg, after_s=after_s, channel=channel)
        for log, found in zip(paths, truths, strict=True)
    ]
    if len(jobs) > 1:
        _refuse_a_file("-o", output, (".csv", ".parquet"))
        _refuse_a_file("--report", report, (".html", ".htm"))
    jobs = _with_outputs(jobs, output, report)
    from canest.cli.keep import config_files, keep_apart

    keep_apart(
        config_files(config_name, config)
        + [(f"the log {job.log}", job.log) for job in jobs]
        + [(f"the truth {job.truth}", job.truth) for job in jobs],
        [("-o", job.output) for job in jobs]
        + [("--report", job.report) for job in jobs]
        + [("--json", json_path)],
    )
    for job in jobs:
        if job.output is not None and job.output.suffix.lower() not in _TABLE_ENDINGS:
            raise click.UsageError(
                f"-o: found the file {job.output}, expected one that ends in .csv or .parquet",
                click.get_current_context(),
            )
    if playing:  # after all that can be refused has been: a bus cannot take back what it carried
        _play(logs, bus, speed, channel, quiet=json_path == "-")
    if len(jobs) == 1:
        return _one(jobs[0], config, json_path)
    return _many(jobs, config, json_path, workers)


def _with_outputs(jobs: list[Job], output: str | None, report: str | None) -> list[Job]:
    """Return the jobs with the files that they are to write."""
    from dataclasses import replace

    # one log into one file, the usual case, does without the processes that `fleet` brings
    if len(jobs) > 1 or (output is not None and (output.endswith("/") or Path(output).is_dir())):
        from canest.batch.pool import with_outputs

        reports = Path(report) if report and len(jobs) > 1 else None
        jobs = with_outputs(jobs, Path(output) if output else None, reports)
    elif output is not None:
        jobs = [replace(jobs[0], output=Path(output))]
    if report is not None and len(jobs) == 1:
        jobs = [replace(jobs[0], report=Path(report))]
    return jobs


def _tell_missing(logs: list[Path], truths: Sequence[Path | None]) -> None:
    """Say which logs have no truth beside them. Errors: UsageError when none has."""
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
    if path.is_file() or (path.suffix.lower() in endings and not path.is_dir()):
        context = click.get_current_context()
        raise click.UsageError(
            f"{option}: found the file {name}, expected a directory for several logs", context
        )


def _one(job: Job, config: Config, json_path: str | None) -> int:
    from canest.cli.progress import Bar
    from canest.cli.summary import result_lines, write_json

    with Bar(job.name) as bar:
        result = job.run(config, bar.update)
    if json_path is not None:
        write_json(result.summary, json_path)
    if json_path != "-" and str(job.output) != "/dev/stdout":
        print("\n".join(result_lines(result, [p for p in (job.output, job.report) if p is not None])))
    return 0


def _many(jobs: list[Job], config: Config, json_path: str | None, workers: int | None) -> int:
    from canest.batch.pool import pooled, run_jobs
    from canest.cli.progress import Count
    from canest.cli.summary import many_lines, write_json

    with Count("replay", len(jobs)) as count:
        outcomes = run_jobs(jobs, config, workers, lambda outcome: count.step(outcome.job.name))
    summary = pooled(outcomes)
    if json_path is not None:
        write_json(summary, json_path)
    if json_path != "-":
        print("\n".join(many_lines(summary)))
    for outcome in outcomes:
        if outcome.error:
            print(f"error: {outcome.error}", file=sys.stderr)
    return 1 if summary["failed"] else 0


def _play(
    logs: tuple[str, ...], bus: str | None, speed: float | None, channel: str | None, quiet: bool = False
) -> None:
    context = click.get_current_context()
    if bus is None:
        raise click.UsageError("--speed needs a bus to play to: --to INTERFACE:CHANNEL", context)
    if speed is not None and not 0 < speed < float("inf"):
        raise click.UsageError(f"--speed must be above 0, found {speed:g}", context)
    from canest.bus.playback import play
    from canest.cli.progress import Bar

    for log in logs:
        with Bar(f"playing {Path(log).name}") as shown:
            told = play(log, bus, 1.0 if speed is None else speed, channel=channel, progress=shown.update)
        if not quiet:
            print(told)
