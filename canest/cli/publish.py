"""`canest publish`: a running daemon's estimates in other systems."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import click

from canest.cli.live_source import Source, source_options, token_of
from canest.cli.options import Number, grouped
from canest.cli.repeated_options import Group

if TYPE_CHECKING:
    from collections.abc import Mapping

EPILOG = """\b
Examples (they need the extras mqtt,foxglove,kuksa: docs/install.md):
  canest publish mqtt -c my-truck.yaml --broker mqtt://localhost
  canest publish foxglove -c my-truck.yaml
  canest publish kuksa -c my-truck.yaml --broker grpc://localhost:55555

Each is a program of its own that follows the daemon, which may come and go. It never holds the daemon up.
"""

MQTT_EPILOG = """\b
Examples:
  canest publish mqtt -c my-truck.yaml --broker mqtt://localhost
  canest publish mqtt -c my-truck.yaml --broker mqtts://fleet.example.org --ca ca.pem
  canest publish mqtt -c my-truck.yaml --broker mqtt://localhost --home-assistant

\b
User and password come from the environment, since a command line can be read by everybody:
  CANEST_MQTT_USER, and CANEST_MQTT_PASSWORD or CANEST_MQTT_PASSWORD_FILE (its first line)

\b
Topics below --topic, all retained:
  availability   online or offline (last will)
  estimate       JSON: t_s (UTC), mass_kg, mass_std_kg, grade, grade_std, status, gate, speed_mps, ...
  status         JSON of canest status, every 10 s
  publisher      JSON: published, confirmed, dropped_offline, dropped_slow, ..., every 10 s
"""

FOXGLOVE_EPILOG = """\b
Examples:
  canest publish foxglove -c my-truck.yaml      in Foxglove or Lichtblick: open ws://localhost:8765
  canest publish foxglove -c my-truck.yaml --port 9000

\b
From another machine, by ssh (nothing to configure):
  ssh -L 8765:127.0.0.1:8765 TRUCK              then open ws://localhost:8765 where you are
In a network that you trust, with a token:
  openssl rand -hex 16 > token
  canest publish foxglove -c my-truck.yaml --address 0.0.0.0 --token-file token
  then open ws://TRUCK:8765/?token=TOKEN. The network carries the token unencrypted.
"""

KUKSA_EPILOG = """\b
Examples:
  canest publish kuksa -c my-truck.yaml --broker grpc://localhost:55555
  canest publish kuksa -c my-truck.yaml --broker grpcs://vehicle.example.org:55555 --ca ca.pem

\b
A token comes from the environment, since a command line can be read by everybody:
  CANEST_KUKSA_TOKEN, or CANEST_KUKSA_TOKEN_FILE (its first line)

\b
Signals, as far as the databroker knows them:
  Vehicle.CurrentOverallWeight      of VSS, only while the mass is valid; its uint16 ends at 65,535 kg
  Vehicle.Canest.Mass, MassStd (kg), Grade, GradeStd (percent), Status, Gate
The latter are of the overlay canest.json: databroker --vss vss.json,canest.json
"""


class Security(NamedTuple):
    """Files of TLS: --ca, --cert, --key."""

    ca: str | None
    cert: str | None
    key: str | None


@click.group(cls=Group, epilog=EPILOG)
def command() -> None:
    """Hand a running daemon's estimates on: to an MQTT broker, to Foxglove or Lichtblick, to KUKSA (VSS)."""


@command.command(epilog=MQTT_EPILOG)
@source_options
@click.option(
    "--broker", "url", required=True, metavar="URL", help="mqtt://HOST[:PORT], or mqtts:// for TLS."
)
@click.option("--topic", metavar="BASE", help="Base of all topics (default: canest/ and the vehicle's name).")
@click.option(
    "--rate", "rate_hz", type=Number(0.01, 50), default=1.0, show_default=True, metavar="HZ",
    help="Estimates a second at most; the daemon gives broadcast.rate_hz.",
)  # fmt: skip
@click.option("--home-assistant", is_flag=True, help="Announce the sensors to Home Assistant (discovery).")
@click.option("--ca", metavar="FILE", help="CA of the broker's certificate (default: those of the system).")
@click.option("--cert", metavar="FILE", help="Our own certificate, where the broker wants one; with --key.")
@click.option("--key", metavar="FILE", help="Its private key.")
@grouped(source=Source, security=Security)
def mqtt(
    source: Source, security: Security, url: str, topic: str | None, rate_hz: float, home_assistant: bool
) -> None:
    """Publish estimates to an MQTT broker. A broker that is away is tried again after 1 s to 60 s."""
    import asyncio
    import os

    from canest.publish.home_assistant import discovery
    from canest.publish.mqtt import MqttPublisher
    from canest.publish.mqtt_settings import Certificates, broker, checked_topic, topic_of
    from canest.publish.program import run
    from canest.system.journal import Journal

    if (security.cert is None) != (security.key is None):
        raise click.UsageError("--cert and --key belong together", click.get_current_context())
    own = None if security.cert is None or security.key is None else (security.cert, security.key)
    target, journal = broker(url, Certificates(security.ca, own), os.environ), Journal()
    config, live = source.load()
    name = config.vehicle.name if config is not None else "vehicle"
    base = topic_of(name) if topic is None else checked_topic(topic)
    sensors = discovery(base, name) if home_assistant else []
    publisher = MqttPublisher(live.name, target, base, rate_hz, journal, sensors)
    if target.sends_password_in_the_clear:
        journal.warning("password-unencrypted", broker=target.address.name, expected="mqtts://")

    async def beside(stop: asyncio.Event) -> None:
        publisher.start()
        await stop.wait()
        await publisher.stop()

    click.echo(f"{live.name} to {target.address.name}, topics {base}/...")
    asyncio.run(run(publisher, live.follow, beside))
    click.echo(_counted(publisher.counters))


@command.command(epilog=FOXGLOVE_EPILOG)
@source_options
@click.option("--port", type=click.IntRange(1, 65535), default=8765, show_default=True, help="TCP port.")
@click.option("--address", default="127.0.0.1", show_default=True, help="Another one needs --token-file.")
@click.option("--token-file", metavar="FILE", help="File whose first line whoever connects must know.")
@click.option(
    "--allow-origin", "origins", multiple=True, metavar="URL",
    help="Let the pages of this site connect too, e.g. https://lichtblick.example.org; may be repeated.",
)  # fmt: skip
@grouped(source=Source)
def foxglove(
    source: Source, port: int, address: str, token_file: str | None, origins: tuple[str, ...]
) -> None:
    """Serve estimates live to Foxglove and Lichtblick (the Foxglove WebSocket protocol), read-only."""
    import asyncio

    from canest.publish.foxglove import FoxgloveServer, serve_forever
    from canest.publish.program import run
    from canest.serve.server import Place

    _, live = source.load()
    place = Place(address, port)
    server = FoxgloveServer(live.name, place, token_of(token_file), origins)

    def opened() -> None:
        click.echo(f"{live.name} for Foxglove: {place.url.replace('http', 'ws', 1)}")

    asyncio.run(run(server, live.follow, lambda stop: serve_forever(server, stop, opened)))


@command.command(epilog=KUKSA_EPILOG)
@source_options
@click.option(
    "--broker", "url", default="grpc://localhost:55555", show_default=True, metavar="URL",
    help="grpc://HOST[:PORT], or grpcs:// for TLS.",
)  # fmt: skip
@click.option(
    "--rate", "rate_hz", type=Number(0.01, 50), default=1.0, show_default=True, metavar="HZ",
    help="Estimates a second at most; the daemon gives broadcast.rate_hz.",
)  # fmt: skip
@click.option("--ca", metavar="FILE", help="CA of the databroker's certificate (default: those of gRPC).")
@grouped(source=Source)
def kuksa(source: Source, url: str, rate_hz: float, ca: str | None) -> None:
    """Publish estimates to an Eclipse KUKSA databroker as signals of VSS (kuksa.val.v2)."""
    import asyncio
    import os

    from canest.publish.kuksa import KuksaPublisher
    from canest.publish.kuksa_settings import databroker
    from canest.publish.program import run
    from canest.system.journal import Journal

    target, journal = databroker(url, ca, os.environ), Journal()
    _, live = source.load()
    publisher = KuksaPublisher(live.name, target, rate_hz, journal)
    if target.sends_token_in_the_clear:
        journal.warning("token-unencrypted", broker=target.address.name, expected="grpcs://")
    click.echo(f"{live.name} to {target.address.name}")
    asyncio.run(run(publisher, live.follow, publisher.serve))
    click.echo(_counted(publisher.counters))


def _counted(counters: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counters.items())
