"""`canest monitor`: a live terminal view from the broadcast alone."""

from __future__ import annotations

import time

import click

from canest.cli.options import Number, config_option, load
from canest.core.errors import printable
from canest.system import terminal

REFRESH_HZ = 5.0

EPILOG = """\b
Examples:
  canest monitor                        on vcan0
  canest monitor socketcan:can0
  canest monitor -c my-truck.yaml       the bus and the group of this config

Any machine on the bus can watch: nothing is needed but the broadcast, and nothing is sent.
"""


@click.command(epilog=EPILOG)
@click.argument("bus", required=False, metavar="[INTERFACE:CHANNEL]")
@config_option(required=False)
@click.option("--pgn", type=str, metavar="PGN", help="Group of the broadcast (default 0xFF5A).")
@click.option("--for", "seconds", type=Number(0), metavar="S", help="Stop after this many seconds.")
def command(bus: str | None, config_name: str | None, pgn: str | None, seconds: float | None) -> None:
    """Watch mass and grade live, from the broadcast alone."""
    from contextlib import nullcontext

    from rich.live import Live

    from canest.bus.link import open_link, require_interface
    from canest.bus.protocols import UP, bus_state
    from canest.config.bus import Broadcast, Bus
    from canest.decode import j1939
    from canest.telemetry.broadcast_view import LiveView

    config = load(config_name, databases=False) if config_name is not None else None
    section = config.bus if config is not None else Bus()
    if bus is not None:
        interface, colon, channel = bus.partition(":")
        if not colon or not channel:
            raise click.UsageError(f"found {bus!r}, expected INTERFACE:CHANNEL, e.g. socketcan:vcan0")
        section = Bus(interface=interface, channel=channel)
        require_interface(section, lambda _: str(bus))
    elif config is not None:
        require_interface(config.bus, config.at)
    group = config.broadcast.pgn if config is not None else Broadcast().pgn
    if pgn is not None:
        try:
            group = Broadcast(pgn=int(pgn, 0)).pgn
        except ValueError as error:
            raise click.UsageError(
                f"--pgn: found {pgn!r}, expected a proprietary-B group, e.g. 0xFF5A"
            ) from error
    receiver, _ = open_link(section, [j1939.kernel_filter(group)], transmit=False)
    view = LiveView(group, printable(f"canest on {section.interface}:{section.channel}"))
    end_s = time.monotonic() + seconds if seconds is not None else float("inf")
    console = terminal.console()
    # a picture needs a terminal that can draw over it; a pipe or a dumb one gets a line a second
    draws = console.is_terminal and not console.is_dumb_terminal
    printed_s = -float("inf")
    if not draws:
        click.echo(view.title)
    try:
        with Live(console=console, auto_refresh=False) if draws else nullcontext() as live:
            while (now_s := time.monotonic()) < end_s:
                frames = receiver.drain().frames
                view.bus_fault = "" if receiver.state in UP else printable(bus_state(receiver))
                for can_id, length, word in zip(
                    frames.can_id.tolist(), frames.length.tolist(), frames.data.tolist(), strict=True
                ):
                    view.take(can_id, word.to_bytes(8, "little")[:length], now_s)
                if live is not None:
                    live.update(view.render(now_s), refresh=True)
                elif now_s - printed_s >= 1.0:
                    printed_s = now_s
                    click.echo(view.line(now_s))
                time.sleep(1 / REFRESH_HZ)
    except KeyboardInterrupt:
        pass
    finally:
        receiver.close()
