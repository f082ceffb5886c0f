"""Who may see the page: programs of this machine without a token, everybody else with one."""

from __future__ import annotations

import hmac
import ipaddress
from http import HTTPStatus

from canest.core.errors import UsageError
from canest.serve.requests import Answer, Request, sentence

SHORTEST_TOKEN = 16
_KEPT_S = 400 * 86_400  #: the longest that browsers keep a cookie
_DENIED = "This page needs its token: open /?token=TOKEN once, or send 'Authorization: Bearer TOKEN'."


def is_loopback(address: str) -> bool:
    """Return whether only this machine reaches an address. Errors: UsageError where it is none."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        raise UsageError(
            "is no address", where="--address", found=address, expected="an IP address, e.g. 0.0.0.0"
        ) from None


class Access:
    """Checks every request.

    token: what whoever asks has to know; None for an address that only this machine reaches. port: where the
    page is served; cookies know no ports, and another page of the same host has another token.
    Errors: UsageError for an address that others reach without a token, and for a token too short.
    """

    def __init__(self, address: str, token: str | None, port: int) -> None:
        if token is None and not is_loopback(address):
            raise UsageError(
                "everybody in the network could read the page",
                where=f"--address {address}",
                expected="--token-file FILE too; 'openssl rand -hex 16 > FILE' makes one",
            )
        if token is not None and (len(token) < SHORTEST_TOKEN or not token.isascii() or not token.isalnum()):
            raise UsageError(
                f"cannot serve as a token, found {len(token)} characters",
                where="--token-file",
                expected=f"{SHORTEST_TOKEN} or more letters and digits: 'openssl rand -hex 16' makes them",
            )
        self._token = token
        self._cookie = f"canest_token_{port}"
        self._names = {"localhost", "127.0.0.1", "::1", address}

    def refusal(self, request: Request) -> Answer | None:
        """Return why a request gets nothing else, None where it may pass."""
        if self._token is None:
            # a page of another site could reach us under its own name (DNS rebinding)
            if _host(request) in self._names:
                return None
            return sentence(HTTPStatus.FORBIDDEN, "This page is served under http://localhost only.")
        if given := "".join(request.query.get("token", [])):
            if not self._is_token(given):
                return sentence(HTTPStatus.UNAUTHORIZED, "Wrong token.")
            # Strict would lose it behind a link of another site; nothing here changes by a GET
            cookie = f"{self._cookie}={given}; HttpOnly; SameSite=Lax; Path=/; Max-Age={_KEPT_S}"
            return Answer(HTTPStatus.SEE_OTHER, headers=(("Location", "/"), ("Set-Cookie", cookie)))
        scheme, _, bearer = request.headers.get("authorization", "").partition(" ")
        known = scheme.lower() == "bearer" and self._is_token(bearer.strip())
        if known or self._is_token(request.cookie(self._cookie)):
            return None
        return sentence(HTTPStatus.UNAUTHORIZED, _DENIED, ("WWW-Authenticate", "Bearer"))

    def _is_token(self, given: str) -> bool:
        return self._token is not None and hmac.compare_digest(given.encode(), self._token.encode())


def _host(request: Request) -> str:
    """Return the name under which a request came, without its port."""
    host = request.headers.get("host", "")
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]
