"""As much of HTTP/1.1 as one read-only page takes: requests without a body, one per connection."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

LONGEST_HEAD = 8192  #: bytes of a request
DEADLINE_S = 5.0  #: for a request as a whole

#: for every answer. Nothing is loaded from elsewhere, run inline, framed or sent
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}


@dataclass(frozen=True, slots=True)
class Request:
    """A request without its body. headers: names in lower case."""

    method: str
    path: str
    query: dict[str, list[str]]
    headers: dict[str, str]

    @property
    def takes_gzip(self) -> bool:
        """Return whether the answer may be compressed."""
        return "gzip" in self.headers.get("accept-encoding", "")

    def cookie(self, name: str) -> str:
        """Return a cookie, '' where there is none."""
        for part in self.headers.get("cookie", "").split(";"):
            key, _, value = part.strip().partition("=")
            if key == name:
                return value
        return ""


@dataclass(frozen=True, slots=True)
class Answer:
    """What is sent back. headers: beyond `HEADERS`."""

    status: HTTPStatus
    body: bytes = b""
    content_type: str = "text/plain; charset=utf-8"
    headers: tuple[tuple[str, str], ...] = ()

    def head(self, *, length: int | None) -> bytes:
        """Return status line and headers; ``length`` None: the body has no end."""
        lines = [f"HTTP/1.1 {self.status.value} {self.status.phrase}", f"Content-Type: {self.content_type}"]
        lines += [f"{name}: {value}" for name, value in (*HEADERS.items(), *self.headers)]
        if length is not None:
            lines.append(f"Content-Length: {length}")
        return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1")


def sentence(status: HTTPStatus, text: str, *headers: tuple[str, str]) -> Answer:
    """Return an answer of one sentence."""
    return Answer(status, text.encode() + b"\n", headers=headers)


async def read_request(reader: asyncio.StreamReader) -> Request | None:
    """Return the request on a connection, None where none comes in time or it is none."""
    try:
        async with asyncio.timeout(DEADLINE_S):
            head = await reader.readuntil(b"\r\n\r\n")
        first, *lines = head.decode("latin-1").split("\r\n")
        method, target, version = first.split(" ")
        if not version.startswith("HTTP/1.") or not target.startswith("/"):
            return None
        url = urlsplit(f"http://page{target}")
        query = parse_qs(url.query, max_num_fields=10)
    except (TimeoutError, OSError, ValueError, EOFError, asyncio.LimitOverrunError):
        return None
    headers = {}
    for line in lines:
        name, _, value = line.partition(":")
        headers[name.strip().lower()] = value.strip()
    return Request(method, url.path, query, headers)
