"""`canest status`: what a person on call needs, from the daemon's local socket."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from canest.cli.options import config_option, load

EPILOG = """\b
Examples:
  canest status                         every daemon in the usual places of this machine
  canest status -c my-truck.yaml        the daemon of this config, in its own service.state_dir too
  canest status --json

Exits 1 when no daemon answers.
"""


@click.command(epilog=EPILOG)
@config_option(required=False)
@click.option("--socket", "socket_name", metavar="PATH", help="The daemon's socket, if it is elsewhere.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option("-v", "--verbose", is_flag=True, help="Also every sender and every counter.")
def command(config_name: str | None, socket_name: str | None, as_json: bool, verbose: bool) -> int:
    """Show how a running daemon is doing: bus, rates, gates, estimate, and why it is not valid."""
    from canest.telemetry.status_socket import find_sockets, read_status, socket_path

    config = load(config_name, databases=False) if config_name is not None else None
    if socket_name is not None:
        paths = [Path(socket_name)]
    elif config is not None:
        here = socket_path(config)
        paths = [here] if here.exists() else [p for p in find_sockets() if p.name == here.name] or [here]
    else:
        paths = list(find_sockets())
    answers: dict[str, dict[str, Any]] = {}
    problems: list[str] = []
    for path in paths:
        try:
            answers[str(path)] = read_status(path)
        except FileNotFoundError:
            problems.append(f"{path}: no daemon (no such socket)")
        except ConnectionRefusedError:
            problems.append(f"{path}: no daemon any more (it was killed and nothing restarted it)")
        except (OSError, ValueError) as error:
            problems.append(f"{path}: the daemon does not answer ({error})")
    if as_json:
        import json

        print(json.dumps(list(answers.values()), indent=1))
    else:
        from canest.telemetry.status_view import show

        for answer in answers.values():
            show(answer, verbose)
        if config is not None and not answers:
            _last_words(config)
    for problem in problems:
        click.echo(problem, err=True)
    if not paths:
        click.echo(
            "no daemon is running here (looked in /run/canest and ~/.local/state/canest); one with its own "
            "service.state_dir is found with -c CONFIG",
            err=True,
        )
    return 0 if answers else 1


def _last_words(config: Any) -> None:
    """Say what a daemon that is not running has learned."""
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
