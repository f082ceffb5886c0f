"""Where the live page and the publishers get their data: a daemon of this machine, or the broadcast."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from canest.cli.options import F, config_option, load, started_with_option

if TYPE_CHECKING:
    from canest.config import Config
    from canest.serve.watcher import Watcher


class LiveSource(NamedTuple):
    """What is watched, for a person, and how it is followed (for ever)."""

    name: str
    follow: Callable[[Watcher], Awaitable[None]]


class Source(NamedTuple):
    """What the command line names to follow: -c with --set, --socket, --broadcast."""

    config_name: str | None
    overrides: tuple[str, ...]
    socket_name: str | None
    broadcast: bool

    def load(self) -> tuple[Config | None, LiveSource]:
        """Return the config (if there is one) and the source. Errors: a usage error, CanestError."""
        both = self.config_name is not None and self.socket_name is not None
        if both or (self.config_name is None and (self.socket_name is None or self.broadcast)):
            raise click.UsageError(
                "found no daemon to follow, expected -c CONFIG (or --socket PATH)" + ", not both" * both,
                click.get_current_context(),
            )
        config = None if self.config_name is None else load(self.config_name, self.overrides, databases=False)
        return config, source_of(config, self.socket_name, broadcast=self.broadcast)


def source_options(function: F) -> F:
    """Add the options of a `Source`."""
    for option in (
        click.option(
            "--broadcast", is_flag=True, help="Listen to the broadcast on the bus, not to the daemon."
        ),
        click.option(
            "--socket", "socket_name", metavar="PATH", help="The daemon's status socket, without -c."
        ),
        started_with_option,
        config_option(required=False),
    ):  # fmt: skip
        function = option(function)
    return function


def token_of(token_file: str | None) -> str | None:
    """Return the first line of a file, None for none. Errors: OSError."""
    if token_file is None:
        return None
    with Path(token_file).open() as file:
        return file.readline(1000).strip()


def source_of(config: Config | None, socket_name: str | None, *, broadcast: bool) -> LiveSource:
    """Return the source of a config or a status socket. Errors: see `BroadcastSource`."""
    if broadcast and config is not None:
        from canest.serve.broadcast_source import BroadcastSource  # brings the interfaces of a bus

        source = BroadcastSource(config)
        return LiveSource(source.name, source.follow)
    from functools import partial

    from canest.serve.daemon_source import follow_daemon
    from canest.telemetry.live_protocol import stream_path

    return LiveSource(
        "the daemon", partial(follow_daemon, lambda: stream_path(status_socket(config, socket_name)))
    )


def status_socket(config: Config | None, socket_name: str | None) -> Path:
    """Return the socket of the config's daemon, wherever one runs now; else where it would be."""
    if socket_name is not None or config is None:
        return Path(str(socket_name))

    from canest.telemetry.status_socket import find_sockets, socket_path  # with pydantic, for configs

    here = socket_path(config)
    if here.exists():
        return here
    return next((path for path in find_sockets() if path.name == here.name), here)
