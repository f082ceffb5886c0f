"""`canest check`: the doctor."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from canest.cli.options import config_option, load, override_options

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.text import Text

    from canest.config import Config
    from canest.core.frames import FrameBlock
    from canest.doctor.check import Report
    from canest.doctor.signal_report import Finding

EPILOG = """\b
Examples:
  canest check -c my-truck.yaml               is the config right, does every DBC signal exist?
  canest check -c my-truck.yaml drive.log     and does this log have the signals?
  canest check -c my-truck.yaml --live        and does the bus of the config have them, now?
  canest check -c class8 drive.log --json -   for a program

Nothing is ever sent. With --strict the exit code is 1 when something stops the estimator.
"""

#: columns of a table that goes to a file or a pipe
_FILE_WIDTH = 180
#: narrower terminals do without the columns that say least
_WIDE = 140
COLUMNS = ("role", "need", "expected as", "verdict", "from", "rate Hz", "values", "n/a", "error", "range")


@click.command(epilog=EPILOG)
@click.argument("log", required=False, metavar="[LOG]")
@config_option()
@click.option("--live", is_flag=True, help="Listen to the bus that the config names.")
@click.option(
    "--seconds", type=click.FloatRange(0.1), default=10.0, show_default=True, help="How long to listen."
)
@click.option("--json", "json_path", metavar="PATH", help="Write the findings as JSON ('-': to stdout).")
@click.option("--strict", is_flag=True, help="Exit with 1 when something stops the estimator.")
@click.option("--channel", metavar="NAME", help="Use this interface of the log only.")
@override_options
def command(
    log: str | None,
    config_name: str,
    live: bool,
    seconds: float,
    json_path: str | None,
    strict: bool,
    channel: str | None,
    overrides: tuple[str, ...],
    estimator: str | None,
    initial_mass: float | None,
) -> int:
    """Say whether a config fits a log or a bus: every signal, found or not, from where, how often."""
    context = click.get_current_context()
    if log is not None and live:
        raise click.UsageError("give a LOG or --live, not both", context)
    if log is None and channel is not None:
        raise click.UsageError("--channel chooses one interface of a LOG: give the log too", context)
    if not live and context.get_parameter_source("seconds") is not ParameterSource.DEFAULT:
        raise click.UsageError("--seconds is how long to listen: give --live too", context)
    config = load(config_name, overrides, estimator, initial_mass)
    from canest.bus.link import require_interface
    from canest.cli.keep import config_files, keep_apart
    from canest.doctor.check import Doctor

    keep_apart([*config_files(config_name, config), ("the log", log)], [("--json", json_path)])
    require_interface(config.bus, config.at)
    doctor = Doctor(config)
    if log is None and not live:
        if json_path is not None:
            from canest.cli.summary import write_json

            write_json({"config": config_name, "verdict": "ok", "signals": len(config.signals)}, json_path)
        if json_path != "-":
            print(_config_line(config_name, config))
        return 0
    reader = None
    if log is not None:
        from canest.cli.progress import Bar
        from canest.pipeline.tables import open_whatever

        reader = open_whatever(config, log, channel)
        with Bar(Path(log).name) as bar:
            for block in reader:
                doctor.push(block)
                bar.update(reader.bytes_done, reader.bytes_total)
    else:
        for frames in _listen(config, seconds):
            doctor.push(frames)
    report = doctor.report(reader)
    if json_path is not None:
        from canest.cli.summary import write_json

        write_json({"config": config_name, "verdict": "ok", **report.to_json()}, json_path)
    if json_path != "-":
        where = log or f"{config.bus.interface}:{config.bus.channel}"
        _show(report, f"{_config_line(config_name, config)}\n{where}: {_heard(report)}")
    return 1 if strict and report.stops else 0


def _config_line(name: str, config: Config) -> str:
    columns = sum(source.column is not None for source in config.signals.values())
    signals, databases = len(config.signals), ", ".join(config.dbc)
    if not columns:
        where = f"{signals} signals all in {databases}"
    elif columns == signals:
        where = f"{signals} signals all columns of a table"
    else:
        where = f"{signals} signals, {signals - columns} in {databases} and {columns} columns of a table"
    count = len(config.effects)
    effects = f"{count} effect{'' if count == 1 else 's'}"
    return f"{name}: config is right: {where}, estimator {config.estimator.name}, {effects}"


def _heard(report: Report) -> str:
    rate = report.frames / report.duration_s if report.duration_s > 0 else 0.0
    return f"{report.frames:,} frames in {report.duration_s:,.1f} s ({rate:,.0f}/s)"


def _listen(config: Config, seconds: float) -> Iterator[FrameBlock]:
    """Yield what the bus carries; nothing is sent. Errors: ConfigError, BusError (never there)."""
    import time

    from canest.bus.link import open_link, require_frames
    from canest.cli.progress import Share
    from canest.core.errors import BusError
    from canest.core.frames import EXTENDED

    require_frames(config)
    everything = [(0, 0), (EXTENDED, EXTENDED)]
    receiver, _ = open_link(config.bus, everything, transmit=False)
    begin = time.monotonic()
    try:
        with Share(f"listening on {config.bus.channel}") as share:
            while (passed := time.monotonic() - begin) < seconds:
                time.sleep(0.02)
                yield receiver.drain().frames
                share.update(passed / seconds)
        if not receiver.opened:
            bus = f"{config.bus.interface}:{config.bus.channel}"
            raise BusError(f"could not be opened in {seconds:g} s ({receiver.reason})", where=bus)
    finally:
        receiver.close()


def _show(report: Report, title: str) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)
    console.print(title, soft_wrap=True, markup=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    columns = [c for c in COLUMNS if console.width >= _WIDE or c not in ("need", "error")]
    for name in columns:
        words = name in ("role", "need", "expected as", "verdict", "range")
        table.add_column(
            name,
            justify="left" if words else "right",
            no_wrap=name in ("role", "verdict"),
            overflow="fold",
        )
    for finding in report.roles:
        for row in _rows(finding):
            # names are the user's: as text, since a bracket in one is no markup
            table.add_row(*(Text.assemble(row.get(name, "")) for name in columns))
    console.print(table)
    if report.samples:
        share = 100 * report.updated / report.samples
        from canest.doctor.reasons import gate_shares

        shares = gate_shares(report.gates, report.samples)
        console.print(
            f"{report.samples:,} samples at 50 Hz, {share:.0f} % open"
            + (f"; closed: {shares}" if shares else "")
        )
    for note in report.notes:
        console.print(f"[dim]note[/]  {escape(note)}", soft_wrap=True)
    for hint in report.hints:
        console.print(f"[yellow]hint[/]  {escape(hint)}", soft_wrap=True)
    if report.stops:
        console.print(f"[bold red]stops[/] {escape(report.stops)}", soft_wrap=True)
    else:
        console.print(
            f"[bold green]ready[/] nothing stops the estimator (at the end: {report.status})", soft_wrap=True
        )


def _rows(finding: Finding) -> Iterator[dict[str, str | Text]]:
    """Yield the rows of one role: as the config expects it, then whoever else sends it."""
    from rich.text import Text

    mild = finding.need in ("optional", "ratio")  # there may be another way to the ratio
    colour = "green" if finding.verdict == "ok" else "yellow" if mild else "red"
    expected = finding.expected + (f" @0x{finding.source:02X}" if finding.source is not None else "")
    unit = f" {finding.unit}" if finding.unit else ""
    head: dict[str, str | Text] = {
        "role": finding.role,
        "need": finding.need,
        "expected as": expected,
        "verdict": Text(finding.verdict, colour),
        "range": "" if finding.low is None else f"{finding.low:.4g} .. {finding.high:.4g}{unit}",
    }
    # an 11-bit identifier has no address, nor has a column of a table
    without_address = "table" if finding.from_table else "its id"
    mine = [s for s in finding.senders if finding.source in (None, s.address)]
    if not mine:
        yield head | {"from": "-"}
    for index, sender in enumerate([*mine, *(s for s in finding.senders if s not in mine)]):
        first = bool(mine) and index == 0
        yield (head if first else {"verdict": Text("also", "dim")}) | {
            "from": f"0x{sender.address:02X}" if sender.address is not None else without_address,
            "rate Hz": "" if sender.rate_hz is None else f"{sender.rate_hz:.1f}",
            "values": f"{sender.valid:,}" if sender.valid else "",
            "n/a": f"{sender.not_available:,}" if sender.not_available else "",
            "error": f"{sender.error_value:,}" if sender.error_value else "",
        }
