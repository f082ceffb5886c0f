"""What a config needs beyond the CAN and local sockets that the systemd unit allows."""

from __future__ import annotations

import errno
import os
import socket

from canest.config.bus import Bus
from canest.config.schema import Config

_HINT = "canest install-service --install -c CONFIG writes a drop-in that allows it"
DROP_IN = "network.conf"  #: in the folder canest@NAME.service.d


def address_families(bus: Bus) -> tuple[str, ...]:
    """Return the address families, by systemd's names, that an interface opens sockets of; of CAN none."""
    if bus.interface == "udp_multicast":
        return ("AF_INET6" if ":" in bus.channel else "AF_INET",)
    if bus.interface == "socketcand":
        return "AF_INET", "AF_INET6"
    return ()


def drop_in(config: Config) -> str | None:
    """Return a drop-in for the unit that allows the network a config uses, None where it uses none."""
    needed = dict.fromkeys(address_families(config.bus))
    users = [f"bus.interface {config.bus.interface}"] if needed else []
    # frames may come from any node of the network
    addresses = "any" if needed else "localhost"
    if config.service.metrics_port is not None:
        needed["AF_INET"] = None
        users.append("service.metrics_port")
    if not users:
        return None
    return (
        f"# Written by canest install-service: {' and '.join(users)} of this instance's config.\n"
        f"[Service]\nRestrictAddressFamilies={' '.join(needed)}\nIPAddressAllow={addresses}\n"
    )


def forbidden_sockets(bus: Bus) -> str:
    """Return one sentence on why this process may not open an interface's sockets, '' where it may."""
    for family in address_families(bus):
        try:
            socket.socket(getattr(socket, family), socket.SOCK_DGRAM).close()
        except OSError as error:
            if error.errno == errno.EAFNOSUPPORT:
                return _explanation(family)
    return ""


def socket_error_text(error: OSError, family: str) -> str:
    """Return a socket error's text, with the remedy where the systemd unit forbids the address family."""
    if error.errno == errno.EAFNOSUPPORT:
        return _explanation(family)
    return error.strerror or str(error)


def _explanation(family: str) -> str:
    if "INVOCATION_ID" not in os.environ:  # which systemd gives to every service
        return f"this system allows no {family} sockets"
    return f"RestrictAddressFamilies of the unit forbids {family}: {_HINT}"
