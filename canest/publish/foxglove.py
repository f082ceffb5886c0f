"""Serves live estimates over the Foxglove WebSocket protocol (extra ``foxglove``), read-only.

Foxglove and Lichtblick connect to it; the messages are those of an MCAP file. A viewer that reads too slowly
misses messages. Protocol: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

from __future__ import annotations

import asyncio
import json
import re
import struct
import time
from collections.abc import Callable, Sequence
from http import HTTPStatus
from typing import Any

from canest import __version__
from canest.core.errors import CanestError, UsageError
from canest.logs.estimate_message import SCHEMA_NAME, TOPIC, message, schema
from canest.publish.follower import NUMBERS, Follower, LiveEstimate
from canest.serve.access import Access
from canest.serve.requests import Request
from canest.serve.server import Place
from canest.system.installation import how_to_add

SUBPROTOCOLS: Any = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MOST_VIEWERS = 16
_OPEN_TIMEOUT_S = 5.0  #: who connects and asks for nothing is let go
BACKLOG_BYTES = 1 << 18  #: that may wait for one viewer; a second of messages has 3 kB
#: pages that may connect to this machine: the viewers' own. Any other page could read along otherwise
ORIGINS: tuple[Any, ...] = (
    None,  # a program
    "file://",  # the desktop applications
    "https://app.foxglove.dev",
    re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"),
)
_ESTIMATE, _STATUS = 1, 2  #: identifiers of channels
_MESSAGE_DATA = 1  #: opcode
_STATUS_SCHEMA = {"type": "object", "title": "canest.Status", "properties": {}}


class Viewer:
    """A connection.

    subscriptions: channel -> the viewer's own number. missed: messages that it was too slow for.
    """

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        self.subscriptions: dict[int, int] = {}
        self.missed = 0

    def send(self, channel: int, t_s: float, payload: bytes) -> None:
        """Send a message of a channel that it has subscribed to, unless too much waits already."""
        number = self.subscriptions.get(channel)
        if number is None:
            return
        transport = self.connection.transport
        if transport.get_write_buffer_size() > BACKLOG_BYTES:
            self.missed += 1
            return
        head = struct.pack("<BIQ", _MESSAGE_DATA, number, round(t_s * 1e6) * 1000)
        # the protocol object frames and writes without waiting, as a broadcast does
        _broadcast([self.connection], head + payload)

    def take(self, text: str | bytes) -> str | None:
        """Take what the viewer sends; return what is wrong with it, None where nothing is."""
        try:
            request = json.loads(text) if isinstance(text, str) else {}
            if request.get("op") == "subscribe":
                for wanted in request["subscriptions"]:
                    channel, number = int(wanted["channelId"]), int(wanted["id"])
                    if channel not in (_ESTIMATE, _STATUS) or not 0 <= number < 1 << 32:
                        return f"there is no channel {channel}"
                    self.subscriptions[channel] = number
            elif request.get("op") == "unsubscribe":
                ended = set(request["subscriptionIds"])
                self.subscriptions = {c: n for c, n in self.subscriptions.items() if n not in ended}
            else:
                return "this server is read-only: it takes subscribe and unsubscribe"
        except (ValueError, KeyError, TypeError, AttributeError):
            return "this is no message of the protocol"
        return None


class FoxgloveServer(Follower):
    """Serves two channels: estimates (`TOPIC`) and the status once a second (``/canest/status``).

    origins: pages that may connect, beyond those of `ORIGINS`; whoever knows a token may from everywhere.
    Errors: those of `Access`; UsageError without the extra.
    """

    def __init__(
        self, source: str, place: Place, token: str | None = None, origins: Sequence[str] = ()
    ) -> None:
        super().__init__(source)
        require_websockets()
        self.place = place
        self.viewers: set[Viewer] = set()
        self._access = Access(place.address, token, place.port)
        self._origins = None if token is not None else [*ORIGINS, *origins]
        self._session = str(time.time_ns())

    async def open(self) -> Any:
        """Open the port. Errors: CanestError where it cannot be had."""
        from websockets.asyncio.server import serve

        try:
            return await serve(
                self._serve, self.place.address, self.place.port,
                subprotocols=SUBPROTOCOLS, origins=self._origins, process_request=self._refuse,
                server_header="canest", max_size=1 << 16, write_limit=BACKLOG_BYTES, compression=None,
                open_timeout=_OPEN_TIMEOUT_S,
            )  # fmt: skip
        except OSError as error:
            raise CanestError(
                "the port cannot be opened", where=f"{self.place.address}:{self.place.port}",
                found=error.strerror or str(error), expected="another --port, or an address of this machine",
            ) from None  # fmt: skip

    def on_estimate(self, estimate: LiveEstimate) -> None:
        """Send it to whoever has subscribed."""
        if self.viewers:
            payload = message(estimate.numbers, estimate.status, estimate.gate)
            self._publish(_ESTIMATE, estimate.t_s, payload)

    def on_status(self, status: dict[str, Any]) -> None:
        """Send it to whoever has subscribed."""
        if self.viewers:
            self._publish(_STATUS, time.time(), json.dumps(status, separators=(",", ":")).encode())

    def on_source(self) -> None:
        """Show every viewer whether the source is there."""
        for viewer in self.viewers.copy():
            _broadcast([viewer.connection], self._source())

    def _publish(self, channel: int, t_s: float, payload: bytes) -> None:
        for viewer in self.viewers.copy():
            viewer.send(channel, t_s, payload)

    async def _serve(self, connection: Any) -> None:
        """Serve one viewer until it leaves."""
        from websockets.exceptions import ConnectionClosed

        viewer = Viewer(connection)
        try:
            for text in (self._info(), self._channels(), self._source()):
                await connection.send(text)
            self.viewers.add(viewer)
            async for text in connection:
                if problem := viewer.take(text):
                    await connection.send(_status_text(1, problem))
        except ConnectionClosed:
            pass
        finally:
            self.viewers.discard(viewer)

    def _refuse(self, connection: Any, request: Any) -> Any:
        """Return an answer for who may not connect, None for who may."""
        if len(self.viewers) >= MOST_VIEWERS:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_VIEWERS} viewers are connected.\n"
            )
        from urllib.parse import parse_qs, urlsplit

        url = urlsplit(request.path)
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        given = Request("GET", url.path, parse_qs(url.query, max_num_fields=10), headers)
        answer = self._access.refusal(given)
        if answer is None or answer.status is HTTPStatus.SEE_OTHER:  # the page's way to keep a right token
            return None
        return connection.respond(answer.status, answer.body.decode())

    def _info(self) -> str:
        return json.dumps({
            "op": "serverInfo", "name": f"canest {__version__}", "capabilities": [],
            "metadata": {"source": self.source}, "sessionId": self._session,
        })  # fmt: skip

    def _channels(self) -> str:
        kinds = (
            (_ESTIMATE, TOPIC, SCHEMA_NAME, schema(NUMBERS)),
            (_STATUS, "/canest/status", "canest.Status", json.dumps(_STATUS_SCHEMA)),
        )
        channels = [
            {"id": number, "topic": topic, "encoding": "json", "schemaName": name, "schema": text,
             "schemaEncoding": "jsonschema"}
            for number, topic, name, text in kinds
        ]  # fmt: skip
        return json.dumps({"op": "advertise", "channels": channels})

    def _source(self) -> str:
        if self.problem:
            return _status_text(2, self.problem)
        return _status_text(0, f"following {self.source}")


def _status_text(level: int, text: str) -> str:
    """Return a status for a person. level: 0 a notice, 1 a warning, 2 an error."""
    return json.dumps({"op": "status", "level": level, "message": text})


def _broadcast(connections: list[Any], data: str | bytes) -> None:
    from websockets.asyncio.server import broadcast

    broadcast(connections, data)


def require_websockets() -> None:
    """Errors: UsageError without the extra."""
    try:
        import websockets.asyncio.server  # noqa: F401 - whether it is there
    except ImportError:
        raise UsageError(
            "cannot serve WebSockets", expected=f"the websockets package: {how_to_add('foxglove')}"
        ) from None


async def serve_forever(server: FoxgloveServer, stop: asyncio.Event, opened: Callable[[], object]) -> None:
    """Keep the port open until ``stop``, then let all viewers go. opened: called once."""
    port = await server.open()
    opened()
    await stop.wait()
    port.close()
