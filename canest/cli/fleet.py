"""`canest fleet`: many vehicles, many logs, one lake of tables."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NamedTuple

import click

from canest.cli.options import CONFIG_HELP, Number, grouped, log_budget_option
from canest.cli.repeated_options import Group

if TYPE_CHECKING:
    from canest.fleet.job import Settings
    from canest.fleet.manifest import Manifest
    from canest.fleet.run import Tally

EPILOG = """\b
Examples (they need the extra fleet: docs/install.md):
  canest fleet run logs/ -o lake/ --manifest fleet.csv
  canest fleet report lake/ -o report/
  canest fleet query lake/ "select vehicle, avg(mass_kg) from trips group by vehicle"
"""

RUN_EPILOG = """\b
Examples:
  canest fleet run logs/ -o lake/ --manifest fleet.csv           all cores of this machine
  canest fleet run logs/ -o lake/ --manifest fleet.csv --resume  only what is missing
  canest fleet run 'logs/**/*.mf4' -o lake/ -c class8            one config, vehicles by their VIN
  canest fleet run s3://bucket/logs -o s3://bucket/lake --manifest fleet.csv --dask tcp://10.0.0.1:8786

\b
The manifest is CSV (the first rule that fits counts; without vehicle: the VIN in the log):
  pattern,vehicle,config
  truck-7/*,truck-7,class8.yaml
  vin:1FUJ*,,cascadia.yaml
"""

REPORT_EPILOG = """\b
Example:
  canest fleet report lake/ -o report/      then open report/index.html
"""

COMPACT_EPILOG = """\b
Example, after the run of each night:
  canest fleet compact lake/
"""

QUERY_EPILOG = """\b
Examples:
  canest fleet query lake/ "select vehicle, count(*) from trips where status = 'valid' group by vehicle"
  canest fleet query lake/ "from trips" > trips.csv
  canest fleet query lake/ "describe samples"

\b
The views are trips (a row per load leg) and samples (a row per second). docs/fleet.md has their columns.
"""

_FAILURES_SHOWN = 20
_HZ = ("0", "1", "2", "5", "10", "25", "50")


class Rules(NamedTuple):
    """Which vehicle and config a log has: --manifest, or -c for all."""

    manifest: str | None
    config_name: str | None


class Limits(NamedTuple):
    """What a log may cost: --memory, --timeout."""

    memory_mb: float
    timeout_s: float | None


class Engine(NamedTuple):
    """Where the logs are read: --workers, --dask."""

    workers: int | None
    dask: str | None


class Kept(NamedTuple):
    """What the lake keeps: --samples-hz, --positions, --keep-vin, --vin-key."""

    samples_hz: str
    positions: bool
    keep_vin: bool
    vin_key: str | None


@click.group(cls=Group, epilog=EPILOG)
def command() -> None:
    """Replay the logs of many vehicles into tables (Parquet) that any tool reads, and report on them."""


@command.command(epilog=RUN_EPILOG)
@click.argument("source", metavar="SOURCE")
@click.option("-o", "--output", "lake", required=True, metavar="LAKE", help="Folder or URL of the tables.")
@click.option("--manifest", metavar="FILE", help="Which vehicle and config a log has: CSV or YAML.")
@click.option("-c", "--config", "config_name", metavar="CONFIG", help=f"{CONFIG_HELP} For all logs.")
@click.option("--workers", type=click.IntRange(1), metavar="N", help="Processes here (default: cores).")
@click.option("--dask", metavar="ADDRESS", help="Use the Dask cluster of this scheduler, tcp://HOST:PORT.")
@click.option("--resume", is_flag=True, help="Do only what the lake lacks or has of other content.")
@click.option(
    "--samples-hz",
    type=click.Choice(_HZ),
    default="1",
    show_default=True,
    metavar="N",
    help="Rows per second of the table of samples: 50, 25, 10, 5, 2, 1, or 0 for none.",
)
@click.option("--positions", is_flag=True, help="Keep latitude and longitude (personal data).")
@click.option("--keep-vin", is_flag=True, help="Keep VINs as they are, not as keyed hashes.")
@click.option(
    "--vin-key",
    metavar="FILE",
    help="Secret key of the hashes (default: made once, in ~/.local/state/canest/fleet-vin.key).",
)
@click.option(
    "--memory",
    "memory_mb",
    type=Number(100),
    metavar="MB",
    default=1000,
    show_default=True,
    help="End the process of a log that takes more.",
)
@click.option(
    "--timeout",
    "timeout_s",
    type=Number(1),
    metavar="S",
    help="End the process of a log that takes longer (default: 300, and 60 more per 25 MB).",
)
@log_budget_option
@click.option("--json", "json_path", metavar="PATH", help="Write what was done as JSON ('-': to stdout).")
@grouped(rules=Rules, engine=Engine, kept=Kept, limits=Limits)
def run(
    source: str,
    lake: str,
    rules: Rules,
    engine: Engine,
    kept: Kept,
    limits: Limits,
    resume: bool,
    json_path: str | None,
) -> int:  # fmt: skip
    """Replay all logs below SOURCE, a folder, a pattern or a URL, into the tables of LAKE.

    A log that cannot be read, hangs or takes too much memory is named and costs itself alone. Each result is
    in the lake as soon as it is there: Ctrl-C loses nothing, --resume goes on.
    """
    if engine.workers is not None and engine.dask is not None:
        raise click.UsageError("--workers is for this machine, --dask for a cluster: give one of them",
                               click.get_current_context())  # fmt: skip
    manifest = _manifest(rules)
    settings = _settings(kept, limits)
    from canest.cli.fleet_progress import FleetProgress
    from canest.cli.summary import write_json
    from canest.fleet.run import Request, run_fleet

    request = Request(source, lake, manifest, settings, engine.workers, engine.dask, resume)
    with FleetProgress() as progress:
        tally = run_fleet(request, progress.begin, progress.step, progress.compiling)
    if json_path is not None:
        write_json(tally.to_json(), json_path)
    if json_path != "-":
        print("\n".join(_tally_lines(tally, lake)))
    _print_problems(tally)
    return 0 if tally.is_complete else 1


@command.command(epilog=REPORT_EPILOG)
@click.argument("lake", metavar="LAKE")
@click.option("-o", "--output", "folder", required=True, metavar="DIR", help="Folder of the pages.")
def report(lake: str, folder: str) -> None:
    """Write pages about a lake: the fleet, and each vehicle with its masses and residuals over time."""
    from canest.cli.progress import Share
    from canest.fleet.report import write_report

    with Share("fleet report") as shown:
        index, vehicles = write_report(lake, folder, shown.update)
    print(f"{vehicles:,} vehicles\nwritten {index}")


@command.command(epilog=QUERY_EPILOG)
@click.argument("lake", metavar="LAKE")
@click.argument("sql", metavar="SQL")
def query(lake: str, sql: str) -> None:
    """Ask a lake in SQL (DuckDB): a table on a terminal, CSV with a header anywhere else."""
    from canest.fleet.query import Answer, ask

    answer: Answer = ask(lake, sql)
    if not sys.stdout.isatty():
        answer.write_csv(sys.stdout)
        return
    from rich import box
    from rich.table import Table

    from canest.system import terminal

    table = Table(*answer.columns, box=box.SIMPLE_HEAD, pad_edge=False)
    for row in answer.rows():
        table.add_row(*row)
    terminal.console(highlight=False, markup=False).print(table)


@command.command(epilog=COMPACT_EPILOG)
@click.argument("lake", metavar="LAKE")
def compact(lake: str) -> None:
    """Join the small files of each vehicle and day. Runs may go on meanwhile; --resume knows what is done."""
    from canest.cli.progress import Share
    from canest.fleet.compact import compact as compact_lake

    with Share("fleet compact") as shown:
        done = compact_lake(lake, shown.update)
    joined = f"{done.before:,} files of {done.folders:,} vehicles and days became {done.after:,}"
    print(joined if done.folders else "nothing to join")
    if done.logs_left:
        left = f"{done.logs_left:,} logs have an old and a new result: left until the next run with --resume"
        print(f"note: {left}", file=sys.stderr)


@command.command()
@click.argument("lake", metavar="LAKE")
@click.argument("vehicle", metavar="VEHICLE")
@click.option("--vin-key", metavar="FILE", help="Secret key of the hashes, if it is not the default one.")
def forget(lake: str, vehicle: str, vin_key: str | None) -> None:
    """Delete all data of VEHICLE, as the lake names it or by its VIN."""
    from canest.fleet.forget import forget_vehicle

    print(f"{forget_vehicle(lake, vehicle, vin_key):,} files removed")


def _manifest(rules: Rules) -> Manifest:
    """Return the rules. Errors: ConfigError, a usage error where there are none or both kinds."""
    if (rules.manifest is None) == (rules.config_name is None):
        raise click.UsageError(
            "which config has which log? Give --manifest FILE (pattern,vehicle,config), or -c CONFIG for all",
            click.get_current_context(),
        )
    from canest.fleet.manifest import Manifest, Rule, read_manifest

    if rules.manifest is not None:
        return read_manifest(rules.manifest)
    assert rules.config_name is not None
    return Manifest((Rule("*", "", rules.config_name),))


def _settings(kept: Kept, limits: Limits) -> Settings:
    from canest.fleet.job import Settings
    from canest.fleet.vehicle_names import read_key
    from canest.logs.budget import current_budget

    key = None if kept.keep_vin else read_key(kept.vin_key)
    return Settings(
        samples_hz=int(kept.samples_hz),
        positions=kept.positions,
        vin_key=key,
        memory_mb=limits.memory_mb,
        timeout_s=limits.timeout_s,
        budget=current_budget(),
    )


def _tally_lines(tally: Tally, lake: str) -> list[str]:
    lines = [
        f"{tally.logs:,} logs: {tally.done:,} done, {tally.present:,} there before, "
        f"{len(tally.failed):,} failed, {len(tally.unmatched):,} without a rule",
        f"{tally.trips:,} trips, {tally.samples:,} samples",
    ]
    if tally.lacking:
        lines.append(f"{len(tally.lacking):,} logs are empty, cut short or lack the needed signals")
    if tally.passed_over:
        shown = ", ".join(tally.passed_over[:3]) + (", ..." if len(tally.passed_over) > 3 else "")
        lines.append(f"{len(tally.passed_over):,} files passed over that are no logs: {shown}")
    return [*lines, f"written {lake}"]


def _print_problems(tally: Tally) -> None:
    problems = [f"error: {log}: {why}" for log, why in sorted(tally.failed.items())]
    problems += [f"no rule: {log}: {why}" for log, why in sorted(tally.unmatched.items())]
    damaged = "was damaged and is removed; its logs below SOURCE are done again"
    problems += [f"note: {name}: {damaged}" for name in sorted(tally.damaged)]
    problems += [f"note: {log}: {why}" for log, why in sorted(tally.lacking.items())]
    for line in problems[:_FAILURES_SHOWN]:
        print(line, file=sys.stderr)
    if len(problems) > _FAILURES_SHOWN:
        print(f"and {len(problems) - _FAILURES_SHOWN:,} more (--json has them all)", file=sys.stderr)
