"""`canest serve`: the live page of a running daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from canest.cli.live_source import Source, source_options, token_of
from canest.cli.options import grouped

if TYPE_CHECKING:
    from canest.cli.live_source import LiveSource

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
@source_options
@click.option("--port", type=click.IntRange(1, 65535), default=8080, show_default=True, help="TCP port.")
@click.option("--address", default="127.0.0.1", show_default=True, help="Another one needs --token-file.")
@click.option("--token-file", metavar="FILE", help="File whose first line whoever opens the page must know.")
@click.option("--with-parent", is_flag=True, hidden=True, help="End when standard input is closed.")
@grouped(source=Source)
def command(source: Source, port: int, address: str, token_file: str | None, with_parent: bool) -> None:
    """Serve a live page: mass, grade, speed, torque, gates, senders, and what is missing for `valid`."""
    import asyncio

    _, live = source.load()
    asyncio.run(_serve(live, (address, port), token_of(token_file), with_parent))


async def _serve(live: LiveSource, place: tuple[str, int], token: str | None, with_parent: bool) -> None:
    import asyncio
    import os
    import signal

    from canest.serve.hub import Hub
    from canest.serve.server import PageServer, Place

    hub = Hub(live.name)
    server = PageServer(hub, Place(*place), token)
    os.nice(5)  # the daemon and whatever else runs here go first
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    if with_parent:
        loop.add_reader(0, stop.set)  # nothing is ever written there: it becomes readable by its end
    await server.run(live.follow, stop, lambda: click.echo(f"live page of {hub.source}: {server.place.url}"))
