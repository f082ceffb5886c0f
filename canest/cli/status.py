"""`canest status`: what a person on call needs, from the daemon's local socket."""

from __future__ import annotations

from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any

import click

from canest.cli.options import config_option, load, started_with_option
from canest.core.errors import ConfigError

if TYPE_CHECKING:
    from canest.config.schema import Config

EPILOG = """\b
Examples:
  canest status                         every daemon of this machine
  canest status -c my-truck.yaml        the daemon of this config, also where the file is wrong by now
  canest status -c my-truck.yaml --set bus.channel=can1
                                        one that was started so (without -c it is found as well)
  canest status --json

Exits 1 when no daemon answers.
"""

#: `run --set bus.channel=...` puts the socket where the file alone does not lead
_WITHOUT_CONFIG = "a daemon started with --set is found with the same --set, or by canest status without -c"
_ELSEWHERE = "--socket PATH asks one in another place (status-CHANNEL.sock in its service.state_dir)"


@click.command(epilog=EPILOG)
@config_option(required=False)
@started_with_option
@click.option("--socket", "socket_name", metavar="PATH", help="The daemon's socket, if it is elsewhere.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option("-v", "--verbose", is_flag=True, help="Also every sender and every counter.")
def command(
    config_name: str | None, overrides: tuple[str, ...], socket_name: str | None, as_json: bool, verbose: bool
) -> int:
    """Show how a running daemon is doing: bus, rates, gates, estimate, and why it is not valid."""
    from canest.telemetry.status_socket import find_sockets, running_sockets, socket_path

    if overrides and config_name is None:
        raise click.UsageError("found --set without a config, expected -c CONFIG with it")
    config, broken = _config(config_name, overrides)
    if socket_name is not None:
        paths = [Path(socket_name)]
    elif config is not None:
        here = socket_path(config)
        paths = [here] if here.exists() else [p for p in find_sockets() if p.name == here.name] or [here]
    else:
        paths = running_sockets()
    answers, problems = _answers(paths)
    if broken is not None and socket_name is None:
        answers, problems = _of_config(answers, str(config_name)), []
        if not answers:
            click.echo(f"no daemon of a config of this name answers; {_ELSEWHERE}", err=True)
            raise broken
        click.echo(f"warning: {broken}", err=True)
    if as_json:
        import json

        print(json.dumps(list(answers.values()), indent=1))
    else:
        from canest.telemetry.status_view import show

        for answer in answers.values():
            show(answer, verbose)
        if config is not None and not answers:
            _print_last_learned(config)
    for problem in problems:
        click.echo(problem, err=True)
    if config is not None and socket_name is None and not answers:
        click.echo(_WITHOUT_CONFIG, err=True)
    if not paths:
        click.echo(f"no daemon is running here; {_ELSEWHERE}", err=True)
    if not answers and socket_name is None and which("journalctl"):
        name = Path(config_name).stem if config_name is not None else "*"
        click.echo(f"what a service has said last: journalctl -e -u 'canest@{name}'", err=True)
    return 0 if answers else 1


def _config(name: str | None, overrides: tuple[str, ...]) -> tuple[Config | None, ConfigError | None]:
    """Return the config, or what is wrong with a file that is there. Errors: ConfigError for no such file."""
    try:
        return (None if name is None else load(name, overrides, databases=False)), None
    except ConfigError as error:
        if not Path(str(name)).is_file():
            raise
        return None, error


def _answers(paths: list[Path]) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Return what the daemons answer, by their sockets, and why others do not."""
    from canest.telemetry.status_socket import read_status

    answers: dict[str, dict[str, Any]] = {}
    problems: list[str] = []
    for path in paths:
        try:
            answers[str(path)] = read_status(path)
        except FileNotFoundError:
            problems.append(f"{path}: no daemon (no such socket)")
        except ConnectionRefusedError:
            gone = "no daemon any more (it was killed and nothing restarted it)"
            problems.append(f"{path}: {gone if path.is_socket() else 'is no socket of a daemon'}")
        except (OSError, ValueError) as error:
            problems.append(f"{path}: the daemon does not answer ({error})")
    return answers, problems


def _of_config(answers: dict[str, dict[str, Any]], config_name: str) -> dict[str, dict[str, Any]]:
    """Return the answers of daemons whose config has this file's name: it may have been started elsewhere."""
    name = Path(config_name).name
    return {path: answer for path, answer in answers.items() if Path(answer.get("config", "")).name == name}


def _print_last_learned(config: Config) -> None:
    """Print what a daemon that is not running has learned."""
    import time

    from canest.config.state_directory import state_dir
    from canest.live.mass_store import file_name
    from canest.live.state import peek

    path = state_dir(config) / file_name(config)
    learned = peek(path)
    if learned is not None:
        age_h = (time.time() - learned.saved_s) / 3600
        mass = f"{learned.mass_kg:,.0f} kg +- {learned.mass_std_kg:,.0f}"
        print(f"last learned: {mass}, {age_h:.1f} h ago ({path})")
