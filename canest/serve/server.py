"""The server: answers requests for the page, and keeps the pages that are open up to date."""

from __future__ import annotations

import asyncio
import errno
import gzip
import socket
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from pathlib import Path
from typing import NamedTuple

from canest.core.errors import CanestError
from canest.serve.access import Access
from canest.serve.hub import MOST_PAGES, Hub, Page
from canest.serve.requests import LONGEST_HEAD, Answer, Request, read_request, sentence

CHECK_S = 0.5
_MOST_CONNECTIONS = 64  #: at once, open pages included
_SEND_S = 20.0  #: for an answer as a whole
_SENT_BYTES = 1 << 13  #: on their way to a page, as the system counts them
_FOLDER = Path(__file__).with_name("page")
_TYPES = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8", ".svg": "image/svg+xml", ".txt": "text/plain; charset=utf-8",
}  # fmt: skip
_EVENTS = Answer(HTTPStatus.OK, content_type="text/event-stream; charset=utf-8")


class Place(NamedTuple):
    """Where the page is served."""

    address: str
    port: int

    @property
    def url(self) -> str:
        """Return the page's address for a browser of this machine."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        return f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{self.port}/"


class PageServer:
    """Serves the page of a hub. Errors: see `Access`."""

    def __init__(self, hub: Hub, place: Place, token: str | None = None) -> None:
        self.hub, self.place = hub, place
        self._access = Access(place.address, token, place.port)
        self._files = {f"/{path.name}": _file(path) for path in _FOLDER.iterdir() if path.suffix in _TYPES}
        self._files["/"] = self._files["/index.html"]
        self._connections = 0

    async def open(self) -> asyncio.Server:
        """Open the port. Errors: CanestError where it cannot be had."""
        try:
            return await asyncio.start_server(
                self._serve, self.place.address, self.place.port, limit=LONGEST_HEAD
            )
        except OSError as error:
            taken = error.errno == errno.EADDRINUSE
            raise CanestError(
                "the port is taken" if taken else error.strerror or str(error),
                where=f"{self.place.address}:{self.place.port}",
                expected="another --port" if taken else "an address of this machine and a port that is free",
            ) from None

    async def run(
        self, follow: Callable[[Hub], Awaitable[None]], stop: asyncio.Event, opened: Callable[[], object]
    ) -> None:
        """Serve until ``stop``. follow: hands what it receives to the hub, for ever. opened: called once.

        Errors: CanestError where the port cannot be had, and those of ``follow``.
        """
        server = await self.open()
        opened()
        tasks = [asyncio.ensure_future(follow(self.hub)), asyncio.ensure_future(self._check())]
        waiting = asyncio.ensure_future(stop.wait())
        try:
            done, _ = await asyncio.wait([*tasks, waiting], return_when=asyncio.FIRST_COMPLETED)
            for task in done - {waiting}:
                task.result()  # these end by an error alone
        finally:
            server.close()
            for task in (*tasks, waiting):
                task.cancel()

    async def _check(self) -> None:
        while True:
            await asyncio.sleep(CHECK_S)
            self.hub.check()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections > _MOST_CONNECTIONS:
                return
            request = await read_request(reader)
            if request is None:
                answer = sentence(HTTPStatus.BAD_REQUEST, "This is no request for a page.")
            else:
                answer = self._access.refusal(request) or self._answer(request)
            if answer is _EVENTS:
                await self._stream(reader, writer)
                return
            body = b"" if request is not None and request.method == "HEAD" else answer.body
            writer.write(answer.head(length=len(answer.body)) + body)
            async with asyncio.timeout(_SEND_S):
                await writer.drain()
        except (OSError, TimeoutError):
            writer.transport.abort()
        finally:
            writer.close()
            try:
                async with asyncio.timeout(_SEND_S):
                    await writer.wait_closed()
            except (OSError, TimeoutError):  # who does not read what is left is not waited for
                writer.transport.abort()
            self._connections -= 1

    def _answer(self, request: Request) -> Answer:
        if request.method not in ("GET", "HEAD"):
            return sentence(HTTPStatus.METHOD_NOT_ALLOWED, "This page is read-only.", ("Allow", "GET, HEAD"))
        if request.path == "/events" and request.method == "GET":
            if len(self.hub.pages) >= MOST_PAGES:
                text = f"{MOST_PAGES} pages are open already: close one."
                return sentence(HTTPStatus.SERVICE_UNAVAILABLE, text, ("Retry-After", "10"))
            return _EVENTS
        if request.path == "/history":
            return _compressed(self.hub.opening(), "application/json", request)
        file = self._files.get(request.path)
        if file is None:
            return sentence(HTTPStatus.NOT_FOUND, "There is no such page.")
        return _compressed(file[0], file[1], request)

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Send events until the page is closed."""
        # what the system has taken can no longer be left out for a page that turns out to be slow
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SENT_BYTES)
        writer.write(_EVENTS.head(length=None) + b"retry: 1000\n\n")
        page = Page(writer.transport)
        self.hub.join(page)
        try:
            while await reader.read(LONGEST_HEAD):  # what a page sends is nothing to us; its end is
                pass
        finally:
            self.hub.pages.discard(page)
            writer.transport.abort()


def _file(path: Path) -> tuple[bytes, str]:
    return gzip.compress(path.read_bytes()), _TYPES[path.suffix]


def _compressed(packed: bytes, content_type: str, request: Request) -> Answer:
    if request.takes_gzip:
        headers = (("Content-Encoding", "gzip"), ("Vary", "Accept-Encoding"))
        return Answer(HTTPStatus.OK, packed, content_type, headers)
    return Answer(HTTPStatus.OK, gzip.decompress(packed), content_type)
