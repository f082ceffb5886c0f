"""Where the live page and the publishers get their data: a daemon of this machine, or the broadcast."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from canest.config import Config
    from canest.serve.watcher import Watcher


class LiveSource(NamedTuple):
    """What is watched, for a person, and how it is followed (for ever)."""

    name: str
    follow: Callable[[Watcher], Awaitable[None]]


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
