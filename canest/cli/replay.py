"""`canest replay`: estimates from recorded logs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import click

from canest.cli.options import (
    ConfigChoice,
    Outputs,
    TruthChoice,
    config_option,
    grouped,
    log_budget_option,
    override_options,
    truth_options,
)

if TYPE_CHECKING:
    from canest.batch.job import Job
    from canest.config import Config

EPILOG = """\b
Examples:
  canest replay drive.log.xz -c class8                     mass and grade of this log
  canest replay drive.log -c my.yaml -o est.csv --report est.html
  canest replay drive.log -c my.yaml --truth drive.truth.csv --json -
  canest replay fleet/*.log.gz -c my.yaml -o results/ --truth auto
  canest replay trip.csv -c bmw-i3 --mass 1520             a table of decoded signals
  canest replay drive.mf4 -c my.yaml -o est.mf4 --columns speed_mps,distance_m,residual_N
  canest replay drive.log -c my.yaml -o est.mcap           for Foxglove, Lichtblick, PlotJuggler
  canest replay drive.log -c my.yaml -o both.blf --with-frames    for CANalyzer, SavvyCAN, with dbc/canest.dbc
  canest replay drive.log --to socketcan:vcan0             onto a bus, as it was driven

\b
Logs: candump text in both its forms, .asc .blf .trc .mf4 .csv .db, and tables (.csv .parquet),
plain or compressed (.gz .xz .zst .bz2).
"""


class Playback(NamedTuple):
    """Onto which bus the logs go, and how many times as fast as real time: --to, --speed."""

    bus: str | None
    speed: float | None

    @property
    def asked(self) -> bool:
        """Return whether a bus is to carry the logs."""
        return self != Playback(None, None)


@click.command(epilog=EPILOG)
@click.argument("logs", nargs=-1, required=True, metavar="LOG...")
@config_option(required=False)
@click.option(
    "-o",
    "--output",
    metavar="PATH",
    help="Estimates as .csv, .csv.gz, .parquet, .mf4, .mcap, or the frames that a daemon would send as .log "
    "or .blf; a name without an ending holds csv. For several logs a directory (of one log: DIR/).",
)
@click.option(
    "--with-frames",
    is_flag=True,
    help="Into the .log or .blf of -o also the frames of the log itself: estimates beside the signals.",
)
@click.option(
    "--columns",
    metavar="NAME,...",
    help="More columns in the file of -o: speed_mps, distance_m, accel_mps2, torque_Nm, gear, traction_N, "
    "force_N, aero_N, residual_N, altitude_m, slope, accelerometer_mps2, yaw_rate_radps, stopped "
    "('list': what each is).",
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
@grouped(chosen=ConfigChoice, outputs=Outputs, truth=TruthChoice, playback=Playback)
def command(
    logs: tuple[str, ...],
    chosen: ConfigChoice,
    outputs: Outputs,
    truth: TruthChoice,
    playback: Playback,
    channel: str | None,
    workers: int | None,
) -> int:
    """Estimate mass and grade from recorded logs, as fast as they can be read."""
    if playback.asked and outputs == Outputs(None, None, None):
        if chosen.config_name is not None:
            chosen.load(databases=False)  # of no use here, but no reason to be wrong
        _play(logs, playback, channel)
        return 0
    if outputs.columns is not None and (outputs.columns == "list" or outputs.output is None):
        return _list_columns(outputs.columns)
    if outputs.output == "-":
        raise click.UsageError("-o needs the name of a file or directory", click.get_current_context())
    # the jobs bring numpy with them, and a config that is wrong needs none
    config = chosen.load()
    from canest.cli.replay_jobs import jobs_of, refuse_outputs, with_outputs

    jobs = with_outputs(jobs_of(logs, truth, channel), outputs, config)
    refuse_outputs(jobs, config, outputs.json_path)
    if playback.asked:  # after all that can be refused has been: a bus cannot take back what it carried
        _play(logs, playback, channel, quiet=outputs.json_path == "-")
    if len(jobs) == 1:
        return _one(jobs[0], config, outputs.json_path)
    return _many(jobs, config, outputs.json_path, workers)


def _list_columns(asked: str) -> int:
    """Print the columns that there are. Errors: a usage error where they were not asked for."""
    if asked != "list":
        raise click.UsageError("--columns needs a file: -o est.csv", click.get_current_context())
    from canest.offline.extra_columns import COLUMNS

    for name, column in COLUMNS.items():
        print(f"{name:<20} {column.meaning}")
    return 0


def _one(job: Job, config: Config, json_path: str | None) -> int:
    from canest.cli.progress import Bar
    from canest.cli.summary import result_lines, write_json
    from canest.system.output_conflicts import is_stdout

    with Bar(job.name) as bar:
        result = job.run(config, bar.update)
    if json_path is not None:
        write_json(result.summary, json_path)
    if not is_stdout(json_path) and not is_stdout(job.output):
        print("\n".join(result_lines(result, [p for p in (job.output, job.report) if p is not None])))
    return 0


def _many(jobs: list[Job], config: Config, json_path: str | None, workers: int | None) -> int:
    from canest.batch.pool import pooled, run_jobs
    from canest.cli.progress import Count
    from canest.cli.summary import many_lines, write_json

    with Count("replay", len(jobs)) as count:
        outcomes = run_jobs(jobs, config, workers, lambda outcome: count.step(outcome.job.name))
    summary = pooled(outcomes)
    if jobs[0].report is not None:
        from canest.report.index_page import Entry, write_index  # wanted for reports alone

        entries = [
            Entry(
                outcome.job.name,
                outcome.job.report.name if outcome.job.report else "",
                outcome.result.summary if outcome.result else None,
                outcome.error,
            )
            for outcome in outcomes
        ]
        write_index(jobs[0].report.parent, entries)
    if json_path is not None:
        write_json(summary, json_path)
    if json_path != "-":
        print("\n".join(many_lines(summary)))
    for outcome in outcomes:
        if outcome.error:
            print(f"error: {outcome.error}", file=sys.stderr)
    return 1 if summary["failed"] else 0


def _play(logs: Sequence[str], playback: Playback, channel: str | None, quiet: bool = False) -> None:
    """Send the logs onto the bus, one after the other. Errors: a usage error, BusError, LogError."""
    context = click.get_current_context()
    if playback.bus is None:
        raise click.UsageError("--speed needs a bus to play to: --to INTERFACE:CHANNEL", context)
    speed = 1.0 if playback.speed is None else playback.speed
    if not 0 < speed < float("inf"):
        raise click.UsageError(f"--speed must be above 0, found {speed:g}", context)
    from pathlib import Path

    from canest.bus.playback import play
    from canest.cli.progress import Bar

    for log in logs:
        with Bar(f"playing {Path(log).name}") as shown:
            result = play(log, playback.bus, speed, channel=channel, progress=shown.update)
        if not quiet:
            print(result)
