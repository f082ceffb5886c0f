"""`canest run`: the daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from canest.cli.options import ConfigChoice, config_option, grouped, override_options

if TYPE_CHECKING:
    from canest.config import Config

EPILOG = """\b
Examples:
  canest run -c vcan                                     the demonstration truck on vcan0
  canest run -c my-truck.yaml --listen-only              never sends anything
  canest run -c my-truck.yaml --set bus.channel=can1
  canest run -c my-truck.yaml --record seen.log --log-estimates est.csv
  canest run -c my-truck.yaml --serve 8080               and a live page: http://127.0.0.1:8080/

\b
Signals: SIGTERM ends within a second (what was learned is saved), SIGHUP reads the config again,
SIGUSR1 writes all counters to the log. See also: canest status, canest monitor, canest install-service.
"""


@click.command(epilog=EPILOG)
@config_option()
@override_options
@click.option("--listen-only", is_flag=True, help="Send nothing at all, not even an address claim.")
@click.option("--record", metavar="LOG", help="Write the received frames as a candump log.")
@click.option("--log-estimates", metavar="CSV", help="Write every estimate (50 Hz) as est.csv.")
@click.option(
    "--serve",
    "port",
    type=click.IntRange(1, 65535),
    metavar="PORT",
    help="Start `canest serve` on this port of 127.0.0.1 beside it: a live page.",
)
@grouped(chosen=ConfigChoice)
def command(
    chosen: ConfigChoice, listen_only: bool, record: str | None, log_estimates: str | None, port: int | None
) -> None:
    """Estimate mass and grade live on a CAN bus and broadcast them there."""
    changes = []
    if listen_only:
        changes.append("broadcast.listen_only=true")
    if record is not None:
        changes.append(f"service.record={_quoted(record)}")
    if log_estimates is not None:
        changes.append(f"service.log_estimates={_quoted(log_estimates)}")

    from canest.config.database_files import config_files
    from canest.live.daemon import Daemon
    from canest.live.mass_store import place
    from canest.system.output_conflicts import keep_apart, require_files, require_writable

    def read_config() -> Config:
        return chosen.load(*changes)

    config = read_config()
    service = config.service
    written = [
        ("service.record", service.record, "STATE_DIRECTORY"),
        ("service.log_estimates", service.log_estimates, "STATE_DIRECTORY"),
        ("service.metrics_file", service.metrics_file, "RUNTIME_DIRECTORY"),
    ]
    files = [(key, place(name, folder)) for key, name, folder in written if name is not None]
    keep_apart(config_files(config), files)
    require_files(files)
    require_writable((key, path) for key, path in files if key != "service.metrics_file")
    daemon = Daemon(config, config_name=chosen.name, reload=read_config)
    if port is None:
        daemon.run()
        return

    from canest.live.page_process import PageProcess
    from canest.telemetry.status_socket import socket_path

    page = PageProcess(port, socket_path(config), daemon.journal)
    try:
        daemon.run()
    finally:
        page.close()


def _quoted(text: str) -> str:
    """Return a YAML string, whatever the text looks like."""
    return "'" + text.replace("'", "''") + "'"
