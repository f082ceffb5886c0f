"""What python-can's drivers have of their own: how they are opened, what their errors and messages mean."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import socket
from typing import Any

from canest.config.bus import Bus
from canest.core.frames import EXTENDED, ID_MASK
from canest.system.installation import how_to_add
from canest.system.python_can import can

# The destructor of a bus whose constructor failed logs a warning at every attempt to open it. The exception
# of the constructor has the reason, and is reported once.
logging.getLogger("can.bus").addFilter(lambda record: "not properly shut down" not in record.msg)

#: errors of an interface, or a driver, that is not installed
_MISSING = (can.CanInterfaceNotImplementedError, ImportError)
INTERFACES = can.VALID_INTERFACES  #: names, those of installed plugins too
#: interfaces that hand our own frames back to us although asked not to (python-can 4.6)
ECHOING = frozenset({"udp_multicast"})
#: interfaces whose `recv` returns None for input that is no frame (an adapter's answer, a byte of noise), too
_RETURNS_NONE_FOR_NOISE = frozenset({"slcan", "serial", "udp_multicast"})
#: extras of ours that bring what an interface of python-can needs
_EXTRAS = {"udp_multicast": "multicast", "slcan": "serial", "serial": "serial", "robotell": "serial"}
#: `serial` waits this long (s) for each byte, by default 0.1: no loop has that time
_OPTIONS: dict[str, dict[str, Any]] = {"serial": {"timeout": 0.01}}
#: how a driver is told that its adapter sends nothing at all, not even acknowledgments and error frames
_SILENT: dict[str, dict[str, Any]] = {
    "slcan": {"listen_only": True},
    "pcan": {"state": can.BusState.PASSIVE},
}
#: 0, where not named. pyserial, which slcan hands it to, takes 0 for "try for ever" once its buffer is full
_SEND_TIMEOUT_S = {"slcan": 0.05}
_LONGEST_LINE = 256  #: bytes of an slcan line, more than CAN FD's 64 bytes take

_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h


def never_opens(error: Exception, interface: str) -> str:
    """Return what has to be changed before an interface can open; '' where waiting may help, too."""
    if isinstance(error, TypeError):
        return f"bus.channel and bus.options with all that python-can's interface {interface} takes"
    # without a number it is not the system's word: a vendor's library that python-can did not find
    no_library = type(error) is OSError and error.errno is None and bool(error.args)
    return missing_driver(interface) if no_library or isinstance(error, _MISSING) else ""


def missing_driver(interface: str) -> str:
    """Return what an interface lacks that cannot be used, and how that is installed where an extra has it."""
    extra = _EXTRAS.get(interface)
    return "its driver" + (f": {how_to_add(extra)}" if extra else "")


def silenced(config: Bus) -> Bus:
    """Return an interface whose adapter acknowledges nothing either, where its driver can be told so."""
    return config.model_copy(update={"options": _SILENT.get(config.interface, {}) | config.options})


def open_bus(config: Bus) -> can.BusABC:
    """Open an interface; may take seconds. Errors: whatever its driver raises."""
    options = _OPTIONS.get(config.interface, {}) | config.options
    if config.bitrate is not None:
        options.setdefault("bitrate", config.bitrate)
    bus = can.Bus(interface=config.interface, channel=config.channel, **options)
    if config.interface == "udp_multicast":
        _exclude_other_groups(bus)
    return bus


def send_timeout_s(interface: str) -> float:
    """Return how long a driver may try to send a frame."""
    return _SEND_TIMEOUT_S.get(interface, 0.0)


def has_more_input(interface: str, bus: can.BusABC) -> bool:
    """Return whether input waits although `recv` returned None (what it returned None for was no frame)."""
    return interface in _RETURNS_NONE_FOR_NOISE and bool(select.select([bus.fileno()], [], [], 0)[0])


def discard_damaged_line(bus: can.BusABC) -> None:
    """Drop the line that a driver could not read, where it would try that again with every further byte.

    python-can 4.6 keeps an slcan line that is no ASCII, and any that never ends.
    """
    line = getattr(bus, "_buffer", None)
    if isinstance(line, bytearray):
        line.clear()


def has_overlong_line(bus: can.BusABC) -> bool:
    """Return whether a driver collects a line that is longer than any frame."""
    line = getattr(bus, "_buffer", None)
    return isinstance(line, bytearray) and len(line) > _LONGEST_LINE


def is_device_failure(error: BaseException) -> bool:
    """Return whether an error is the system's word that the device has failed, not one about what it sent."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and not isinstance(
            cause, BlockingIOError | InterruptedError | TimeoutError
        ):
            return True
        cause = cause.__cause__
    return False


def is_driver_error(error: BaseException) -> bool:
    """Return whether a driver itself reports that reading failed; other errors come from bad input."""
    return isinstance(error, can.CanError) and error.__cause__ is None


def error_text(error: BaseException) -> str:
    """Return an error in one line, in the words of the system or the driver."""
    text = (error.strerror if isinstance(error, OSError) else "") or str(error)
    # neither of the system nor of python-can: a driver's defect, whose type is part of the reason
    kind = "" if text and isinstance(error, OSError | can.CanError) else type(error).__name__
    return ": ".join(part for part in (kind, " ".join(text.split())) if part)


def is_whole(message: can.Message) -> bool:
    """Return whether a message can have been on a bus: its identifier fits, and no data are missing."""
    if message.is_error_frame:
        return True  # drivers put words of their own into these
    largest = ID_MASK if message.is_extended_id else 0x7FF
    length = 0 if message.is_remote_frame else message.dlc if message.is_fd else min(message.dlc, 8)
    return 0 <= message.arbitration_id <= largest and length <= len(message.data)


def message_of(can_id: int, payload: bytes) -> can.Message:
    """Return a frame as python-can sends it."""
    return can.Message(arbitration_id=can_id & ID_MASK, is_extended_id=bool(can_id & EXTENDED), data=payload)


def _exclude_other_groups(bus: can.BusABC) -> None:
    """Receive our group only: by default Linux delivers every group that any program here has joined."""
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(bus.fileno())) as sock:  # not on Linux
        if sock.family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        else:
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
