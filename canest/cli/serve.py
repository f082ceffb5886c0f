"""`canest serve`: the live page of a running daemon."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from canest.cli.options import config_option, load

if TYPE_CHECKING:
    from canest.config import Config

EPILOG = """\b
Examples:
  canest serve -c my-truck.yaml                  open http://127.0.0.1:8080/ on this machine
  canest serve -c my-truck.yaml --port 9000
  canest serve -c my-truck.yaml --broadcast      from the bus alone: the daemon may run elsewhere
  canest run -c my-truck.yaml --serve 8080       the daemon, and this page beside it

\b
From another machine, by ssh (nothing to configure):
  ssh -L 8080:127.0.0.1:8080 TRUCK               then open http://127.0.0.1:8080/ where you are
In a network that you trust, with a token:
  openssl rand -hex 16 > token
  canest serve -c my-truck.yaml --address 0.0.0.0 --token-file token
  then open http://TRUCK:8080/?token=TOKEN once per browser. The network carries the token unencrypted.

The page is read-only and needs no internet. It follows the daemon, which may come and go. Ctrl-C ends it.
"""


@click.command(epilog=EPILOG)
@config_option(required=False)
@click.option("--port", type=click.IntRange(1, 65535), default=8080, show_default=True, help="TCP port.")
@click.option("--address", default="127.0.0.1", show_default=True, help="Another one needs --token-file.")
@click.option("--token-file", metavar="FILE", help="File whose first line whoever opens the page must know.")
@click.option("--socket", "socket_name", metavar="PATH", help="The daemon's status socket, without -c.")
@click.option("--broadcast", is_flag=True, help="Listen to the broadcast on the bus, not to the daemon.")
@click.option("--with-parent", is_flag=True, hidden=True, help="End when standard input is closed.")
def command(
    config_name: str | None,
    port: int,
    address: str,
    token_file: str | None,
    socket_name: str | None,
    broadcast: bool,
    with_parent: bool,
) -> None:
    """Serve a live page: mass, grade, speed, torque, gates, senders, and what is missing for `valid`."""
    import asyncio

    if (config_name is None) == (socket_name is None) or (broadcast and config_name is None):
        raise click.UsageError("found no daemon to follow, expected -c CONFIG (or --socket PATH)")
    config = None if config_name is None else load(config_name, databases=False)
    token = None if token_file is None else _token(Path(token_file))
    asyncio.run(_serve(config, socket_name, (address, port), token, broadcast, with_parent))


async def _serve(
    config: Config | None,
    socket_name: str | None,
    place: tuple[str, int],
    token: str | None,
    broadcast: bool,
    with_parent: bool,
) -> None:
    import asyncio
    import os
    import signal

    from canest.cli.live_source import source_of
    from canest.serve.hub import Hub
    from canest.serve.server import PageServer, Place

    source = source_of(config, socket_name, broadcast=broadcast)
    hub = Hub(source.name)
    server = PageServer(hub, Place(*place), token)
    os.nice(5)  # the daemon and whatever else runs here go first
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    if with_parent:
        loop.add_reader(0, stop.set)  # nothing is ever written there: it becomes readable by its end
    await server.run(
        source.follow, stop, lambda: click.echo(f"live page of {hub.source}: {server.place.url}")
    )


def _token(path: Path) -> str:
    """Return the first line of a file."""
    with path.open() as file:
        return file.readline(1000).strip()
