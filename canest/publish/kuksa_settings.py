"""Where a KUKSA databroker is: its address, its certificate, and the token from the environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from canest.core.errors import UsageError
from canest.publish.address import Address, parse, secret

TOKEN = "CANEST_KUKSA_TOKEN"
_PORTS = {"grpc": 55555, "grpcs": 55555}


@dataclass(frozen=True, slots=True)
class Databroker:
    """A databroker.

    authority: certificates (PEM) that its own must be signed by, None for those of gRPC. token: a JWT, None
    where it wants none.
    """

    address: Address
    authority: bytes | None = None
    token: str | None = field(default=None, repr=False)

    @property
    def is_encrypted(self) -> bool:
        """Return whether it is reached by TLS."""
        return self.address.scheme == "grpcs"

    @property
    def sends_token_in_the_clear(self) -> bool:
        """Return whether others in the network could read the token."""
        return self.token is not None and not self.is_encrypted and not self.address.is_this_machine


def databroker(url: str, ca: str | None, environment: Mapping[str, str]) -> Databroker:
    """Return the databroker of ``grpc://HOST[:PORT]`` or ``grpcs://...``.

    ca: file of its authority. environment: has the token. Errors: UsageError.
    """
    address = parse(url, _PORTS, f"the token in the environment ({TOKEN}, {TOKEN}_FILE)")
    token = secret(environment, TOKEN)
    if token is not None and not (token.isascii() and token.isprintable() and token.strip() == token != ""):
        raise UsageError("is no token", where=TOKEN, expected="a JSON web token in one line")
    found = Databroker(address, None, token)
    if ca is None:
        return found
    if not found.is_encrypted:
        raise UsageError("--ca is for TLS", where="--broker", found=url, expected="grpcs://")
    return Databroker(address, _certificates(ca), token)


def _certificates(name: str) -> bytes:
    try:
        content = Path(name).read_bytes()
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}", where="--ca", found=name) from None
    if b"-----BEGIN CERTIFICATE-----" not in content:
        raise UsageError("has no certificate", where="--ca", found=name, expected="a PEM file")
    return content
