"""Where a publisher connects, and its secret: from the environment or a file, never a command line."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from canest.core.errors import UsageError

_LONGEST_SECRET = 10_000  #: characters; a signed token has some 1,000


class Address(NamedTuple):
    """Where a server listens. scheme: how it is spoken to."""

    scheme: str
    host: str
    port: int

    @property
    def name(self) -> str:
        """Return what a person calls it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"

    @property
    def is_this_machine(self) -> bool:
        """Return whether nothing that is sent there leaves this machine."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


def parse(url: str, ports: Mapping[str, int], secrets: str) -> Address:
    """Return the address of ``SCHEME://HOST[:PORT]``.

    ports: scheme -> usual port, the encrypted scheme last. secrets: where they belong. Errors: UsageError.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
        (host or "").encode("idna")  # what no name server can be asked for, nobody could connect to
    except ValueError:  # brackets without an end, a port that is none, a name with an empty part
        parts, host, port = urlsplit(""), None, None
    if "@" in url:
        raise UsageError(
            "everybody on this machine can read a command line", where="--broker", expected=secrets
        )
    odd = parts.path.strip("/") or parts.query or parts.fragment
    if parts.scheme not in ports or not host or odd or port == 0:
        clear, encrypted = ports
        raise UsageError(
            "is no broker", where="--broker", found=url,
            expected=f"{clear}://HOST[:PORT], or {encrypted}:// for TLS",
        )  # fmt: skip
    return Address(parts.scheme, host, port or ports[parts.scheme])


def secret(environment: Mapping[str, str], name: str) -> str | None:
    """Return the variable ``name``, or the first line of the file that ``name``_FILE names.

    None where there is neither. Errors: UsageError.
    """
    value, name_of_file = environment.get(name), f"{name}_FILE"
    path = environment.get(name_of_file)
    if not path:
        return value
    if value is not None:
        raise UsageError(f"found both {name} and {name_of_file}", expected="one of them")
    try:
        with Path(path).open() as file:
            return file.readline(_LONGEST_SECRET).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is no text"
        raise UsageError(f"cannot be read: {reason}", where=name_of_file, found=path) from None
