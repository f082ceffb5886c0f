"""`canest check`: the doctor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from canest.cli.options import (
    ConfigChoice,
    Number,
    config_option,
    grouped,
    log_budget_option,
    override_options,
)

if TYPE_CHECKING:
    from canest.config import Config
    from canest.doctor.check import Doctor, Report
    from canest.logs.base import LogReader

EPILOG = """\b
Examples:
  canest check -c my-truck.yaml               is the config right, does every DBC signal exist?
  canest check -c my-truck.yaml drive.log     and does this log have the signals?
  canest check -c my-truck.yaml --live        and does the bus of the config have them, now?
  canest check -c class8 drive.log --json -   for a program

Nothing is ever sent. With --strict the exit code is 1 when something stops the estimator.
"""


@click.command(epilog=EPILOG)
@click.argument("log", required=False, metavar="[LOG]")
@config_option()
@click.option("--live", is_flag=True, help="Listen to the bus that the config names.")
@click.option("--seconds", type=Number(0.1), default=10.0, show_default=True, help="How long to listen.")
@click.option("--json", "json_path", metavar="PATH", help="Write the findings as JSON ('-': to stdout).")
@click.option("--strict", is_flag=True, help="Exit with 1 when something stops the estimator.")
@click.option("--channel", metavar="NAME", help="Use this interface of the log only.")
@log_budget_option
@click.option("-v", "--verbose", is_flag=True, help="Show every role, every sender and every label.")
@override_options
@grouped(chosen=ConfigChoice)
def command(
    log: str | None,
    chosen: ConfigChoice,
    live: bool,
    seconds: float,
    json_path: str | None,
    strict: bool,
    channel: str | None,
    verbose: bool,
) -> int:
    """Check whether a config fits a log or a bus: every signal, found or not, from where, how often."""
    _refuse_combinations(log, live, channel)
    config = chosen.load()
    from canest.bus.link import require_interface
    from canest.config.database_files import config_files
    from canest.doctor.check import Doctor
    from canest.system.output_conflicts import keep_apart

    keep_apart([*config_files(config), ("the log", log)], [("--json", json_path)])
    require_interface(config.bus, config.at)
    doctor = Doctor(config, log or "")
    title = _config_line(chosen.name, config)
    if log is None and not live:
        from canest.doctor.config_warnings import config_warnings

        notes = config_warnings(config)
        _write_json(json_path, chosen.name, {"signals": len(config.signals), "notes": notes})
        if json_path != "-":
            print("\n".join([title, *(f"note  {note}" for note in notes)]))
        return 0
    reader = None
    if log is not None:
        reader = _read(doctor, config, log, channel)
    else:
        _listen(doctor, config, seconds)
    report = doctor.report(reader)
    _write_json(json_path, chosen.name, report.to_json())
    if json_path != "-":
        from canest.cli.check_view import show

        where = log or f"{config.bus.interface}:{config.bus.channel}"
        show(report, f"{title}\n{where}: {_received(report)}", verbose)
    return 1 if strict and not report.ready else 0


def _refuse_combinations(log: str | None, live: bool, channel: str | None) -> None:
    """Refuse options that do not go together. Errors: a usage error."""
    context = click.get_current_context()
    if log is not None and live:
        raise click.UsageError("give a LOG or --live, not both", context)
    if log is None and channel is not None:
        raise click.UsageError("--channel chooses one interface of a LOG: give the log too", context)
    if not live and context.get_parameter_source("seconds") is not ParameterSource.DEFAULT:
        raise click.UsageError("--seconds is how long to listen: give --live too", context)


def _write_json(json_path: str | None, config_name: str, content: dict[str, Any]) -> None:
    if json_path is not None:
        from canest.cli.summary import write_json

        write_json({"config": config_name, "verdict": "ok", **content}, json_path)


def _read(doctor: Doctor, config: Config, log: str, channel: str | None) -> LogReader:
    """Give the doctor a log, and return its reader. Errors: LogError, ConfigError."""
    from canest.cli.progress import Bar
    from canest.pipeline.table_map import open_whatever

    reader = open_whatever(config, log, channel)
    with Bar(Path(log).name) as bar:
        for block in reader:
            doctor.push(block)
            bar.update(reader.bytes_done, reader.bytes_total)
    return reader


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
    return f"{name}: config is right: {where}, estimator {config.estimator.name}, {effects}{_gears(config)}"


def _gears(config: Config) -> str:
    """Return that a gearbox seems to lack its table of ratios, "" where it does not."""
    from canest.vehicle.driveline_state import CLUTCH_ROLES
    from canest.vehicle.role_sources import is_at_wheels, torque_role

    vehicle, roles = config.vehicle, tuple(config.signals)
    known = vehicle.gear_ratios or "gear_ratio" in roles or is_at_wheels(torque_role(roles, vehicle), roles)
    shifts = [role for role in ("gear", "shift_in_process", *CLUTCH_ROLES) if role in roles]
    if known or not shifts:
        return ""
    return f", one gear, though {shifts[0]} is mapped: is vehicle.gear_ratios missing? A log shows the ratios"


def _received(report: Report) -> str:
    rate = report.frames / report.duration_s if report.duration_s > 0 else 0.0
    return f"{report.frames:,} frames in {report.duration_s:,.1f} s ({rate:,.0f}/s)"


def _listen(doctor: Doctor, config: Config, seconds: float) -> None:
    """Give the doctor what the bus carries; nothing is sent. Errors: ConfigError, BusError (never there)."""
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
                doctor.push(receiver.drain().frames)
                share.update(passed / seconds)
        if not receiver.opened:
            bus = f"{config.bus.interface}:{config.bus.channel}"
            raise BusError(f"could not be opened in {seconds:g} s ({receiver.reason})", where=bus)
    finally:
        receiver.close()
