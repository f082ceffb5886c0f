"""Which receiver a bus gets, and who may send on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from canest.bus.protocols import Filters, Receiver, Transmitter
from canest.config.bus import Broadcast, Bus
from canest.config.schema import Config
from canest.core.errors import ConfigError

#: python-can interfaces that end inside this machine or its network, never at a vehicle
_VIRTUAL_INTERFACES = frozenset({"virtual", "udp_multicast"})


def is_virtual(bus: Bus) -> bool:
    """Return True where no physical bus can be behind an interface."""
    if bus.interface in _VIRTUAL_INTERFACES:
        return True
    if bus.interface != "socketcan" or not bus.channel.startswith(("vcan", "vxcan")):
        return False
    return not Path("/sys/class/net", bus.channel, "device").exists()


def may_transmit(bus: Bus, broadcast: Broadcast) -> bool:
    """Return whether anything may be sent: never when listen-only, on a physical bus only when asked."""
    if broadcast.listen_only:
        return False
    return is_virtual(bus) if broadcast.enabled is None else broadcast.enabled


def require_interface(bus: Bus, at: Callable[[str], str]) -> None:
    """Refuse an interface that is none of python-can's, and a channel that it can never open.

    at: a config's key -> where it was written. Errors: ConfigError with the nearest names.
    """
    if bus.interface == "udp_multicast":
        _require_group(bus.channel, at("bus.channel"))
    if bus.interface == "socketcan" or bus.interface in _VIRTUAL_INTERFACES:
        return  # no check of these needs python-can, whose import is slow
    from difflib import get_close_matches

    from canest.bus.drivers import INTERFACES

    if bus.interface not in INTERFACES:
        near = get_close_matches(bus.interface.lower(), INTERFACES, n=3, cutoff=0.5)
        raise ConfigError(
            "unknown interface",
            where=at("bus.interface"),
            found=bus.interface,
            expected="an interface of python-can, "
            + ("perhaps " + " or ".join(near) if near else "one of " + ", ".join(sorted(INTERFACES))),
        )


def _require_group(channel: str, where: str) -> None:
    """Refuse what is no address of a group: python-can looks a name up for seconds, and then fails."""
    from ipaddress import ip_address

    try:
        is_group = ip_address(channel).is_multicast and "%" not in channel
    except ValueError:
        is_group = False
    if not is_group:
        raise ConfigError(
            "no multicast group", where=where, found=channel, expected="its address, e.g. 239.74.163.2"
        )


def require_frames(config: Config) -> None:
    """Refuse a config that would wait on a bus for ever. Errors: ConfigError."""
    if all(source.column is not None for source in config.signals.values()):
        raise ConfigError(
            "the config maps only table columns, and a bus carries frames",
            where=config.at("signals"),
            expected="roles with message: and signal: of a DBC",
        )


def open_link(
    bus: Bus, filters: Filters, *, transmit: bool, silent: bool = False
) -> tuple[Receiver, Transmitter | None]:
    """Open a bus: its receiver and, only when ``transmit``, its transmitter.

    silent: an adapter is told to acknowledge nothing either. SocketCAN's is told by `ip link`.
    An interface that is absent is waited for. Errors: BusError when it can never be opened here.
    """
    if bus.interface == "socketcan":
        from canest.bus.socketcan import SocketCanReceiver, SocketCanTransmitter

        receiver = SocketCanReceiver(bus.channel, filters)
        return receiver, SocketCanTransmitter(receiver) if transmit else None
    from canest.bus.drivers import silenced
    from canest.bus.pythoncan import PythonCanReceiver
    from canest.bus.pythoncan_transmitter import PythonCanTransmitter

    other = PythonCanReceiver(silenced(bus) if silent else bus, filters)
    return other, PythonCanTransmitter(other) if transmit else None
