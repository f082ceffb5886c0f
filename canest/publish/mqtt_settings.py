"""Where an MQTT publisher connects, and as whom: secrets come from the environment or a file alone."""

from __future__ import annotations

import re
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field

from canest.core.errors import UsageError
from canest.publish.address import Address, parse, secret

USER, PASSWORD = "CANEST_MQTT_USER", "CANEST_MQTT_PASSWORD"
_PORTS = {"mqtt": 1883, "mqtts": 8883}


@dataclass(frozen=True, slots=True)
class Certificates:
    """Files for TLS.

    authority: of the broker's certificate (None: those of the system). own: our certificate and its key.
    """

    authority: str | None = None
    own: tuple[str, str] | None = None


@dataclass(frozen=True, slots=True)
class Broker:
    """A broker. tls: None for a connection in the clear."""

    address: Address
    tls: ssl.SSLContext | None = None
    user: str | None = None
    password: str | None = field(default=None, repr=False)

    @property
    def sends_password_in_the_clear(self) -> bool:
        """Return whether others in the network could read the password."""
        return self.password is not None and self.tls is None and not self.address.is_this_machine


def broker(url: str, certificates: Certificates, environment: Mapping[str, str]) -> Broker:
    """Return the broker of ``mqtt://HOST[:PORT]`` or ``mqtts://...``.

    environment: has user and password. Errors: UsageError.
    """
    address = parse(url, _PORTS, f"user and password in the environment ({USER}, {PASSWORD}_FILE)")
    encrypted = address.scheme == "mqtts"
    if certificates != Certificates() and not encrypted:
        raise UsageError(
            "--ca, --cert and --key are for TLS", where="--broker", found=url, expected="mqtts://"
        )
    user, password = _credentials(environment)
    tls = _tls(certificates) if encrypted else None
    return Broker(address, tls, user, password)


def topic_of(name: str) -> str:
    """Return the base topic of a vehicle: its name in the letters that every system takes."""
    slug = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
    return f"canest/{slug or 'vehicle'}"


def checked_topic(topic: str) -> str:
    """Return a base topic. Errors: UsageError for one that cannot be published to."""
    if not topic.strip("/") or re.search(r"[#+\x00-\x1f]|//|^/|/$|^\$", topic) or len(topic) > 200:
        raise UsageError(
            "is no base topic", where="--topic", found=topic, expected="e.g. fleet/truck-7: no #, no +, no $"
        )
    return topic


def _credentials(environment: Mapping[str, str]) -> tuple[str | None, str | None]:
    user, password = environment.get(USER), secret(environment, PASSWORD)
    if password is not None and user is None:
        raise UsageError("found a password without a user", expected=f"{USER} too")
    return user, password


def _tls(certificates: Certificates) -> ssl.SSLContext:
    try:
        context = ssl.create_default_context(cafile=certificates.authority)
        if certificates.own is not None:
            context.load_cert_chain(*certificates.own)
    except OSError as error:  # ssl.SSLError is one
        files = [name for name in (certificates.authority, *(certificates.own or ())) if name]
        raise UsageError(
            f"no certificates for TLS: {error.strerror or error}", where="--ca, --cert, --key",
            found=", ".join(files), expected="PEM files",
        ) from None  # fmt: skip
    return context
