"""Every other interface python-can has (udp_multicast, virtual, slcan, pcan, ...), behind the same halves.

No thread is started: a reader thread that dies of an unplugged adapter leaves a daemon that looks healthy
and hears nothing. Here the loop itself reads, and whatever goes wrong leads to a new attempt to open.
"""

from __future__ import annotations

import logging
import re
import sys
import time
from collections import Counter, deque

from canest.bus.kernel_drain import Drained
from canest.bus.link import REOPEN_S, Filters
from canest.config.bus import Bus
from canest.core.errors import BusError, how_to_add
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.core.samples import STEP_US

# Where asammdf is installed, python-can imports it for its log formats: a second and 80 MB that a bus has no
# need of. Hidden while python-can is imported for the first time, it is not found, which python-can accepts.
_HIDDEN = "can" not in sys.modules and "asammdf" not in sys.modules
if _HIDDEN:
    sys.modules["asammdf"] = None  # type: ignore[assignment]
try:
    import can
finally:
    if _HIDDEN:
        del sys.modules["asammdf"]

# A bus whose constructor has failed is complained of by its destructor, at every attempt to open it. The
# exception of the constructor says more, and is told once.
logging.getLogger("can.bus").addFilter(lambda record: "not properly shut down" not in record.msg)

INTERFACES = can.VALID_INTERFACES  #: names, those of installed plugins too
GUARD_US = 20_000  #: drivers hand a frame over this long after its stamp at the latest
_IDS_REMEMBERED = 4096  #: a bus has some hundreds of identifiers, noise has millions
_MAX_FRAMES = 4096  #: read at once, so that a flood cannot keep a tick from ending
#: stamps further from the machine's clock may be those of a log that somebody plays at any speed
_PRESENT_US = 1_000_000
_STAMP_MAX_S = 9e12  #: what microseconds in 64 bits can hold
#: interfaces that hand our own frames back to us although asked not to (python-can 4.6)
_ECHOING = frozenset({"udp_multicast"})
#: extras of ours that bring what an interface of python-can needs
_EXTRAS = {"udp_multicast": "multicast", "slcan": "serial", "serial": "serial", "robotell": "serial"}


def driver_of(interface: str) -> str:
    """Return what an interface lacks that cannot be used, and how that is installed where an extra has it."""
    extra = _EXTRAS.get(interface)
    return "its driver" + (f": {how_to_add(extra)}" if extra else "")


class PythonCanReceiver:
    """Receives from any python-can interface; see `canest.bus.link.Receiver`.

    Errors: BusError when python-can does not know the interface or lacks its driver; an interface that is
    merely not there now is waited for.
    """

    rest_us = STEP_US  # nobody tells how much a driver's buffer holds

    def __init__(self, bus: Bus, filters: Filters) -> None:
        self._config = bus
        # python-can's own filters make recv(0) say "nothing there" for every frame they refuse
        self._filters = [(i & m, m) for i, m in filters]
        self._wanted: dict[int, bool] = {}
        self.state, self.reason = "absent", ""
        self.opened = 0
        self.counters: Counter[str] = Counter()
        self._bus: can.BusABC | None = None
        self._rows: list[tuple[int, int, bytes]] = []
        #: the newest stamp less the monotonic time at which it was read: stamps may come from any clock
        self._ahead_us: int | None = None
        #: frames sent whose echo is to be dropped when it comes
        self._echoes: deque[tuple[int, bytes]] | None = (
            deque(maxlen=64) if bus.interface in _ECHOING else None
        )
        self._retry_at_s = 0.0
        try:
            self._open()
        except (can.CanInterfaceNotImplementedError, ImportError) as error:
            raise BusError(
                f"cannot be used ({error})",
                where=f"bus.interface {bus.interface}",
                expected=driver_of(bus.interface),
            ) from error

    def collect(self) -> bool:
        """Empty the driver's buffer; see `canest.bus.link.Receiver`."""
        try:
            if self._bus is None:
                self._reopen()
            for _ in range(_MAX_FRAMES):
                message = None if self._bus is None else self._bus.recv(0)
                if message is None:
                    return True
                self._take(message)
        except Exception as error:  # drivers raise anything; none of it may end the loop
            self._failed(error)
        return self._bus is None

    def drain(self) -> Drained:
        """Return what has arrived; see `canest.bus.link.Receiver`."""
        before_us = time.monotonic_ns() // 1000
        reached_us = None
        if self.collect() and self._ahead_us is not None:
            # a frame waits before it is read, so the clock of the stamps is at least this far
            stamping_us = before_us + self._ahead_us
            if abs(stamping_us - time.time_ns() // 1000) < _PRESENT_US:
                reached_us = stamping_us - GUARD_US
        rows, self._rows = self._rows, []
        return Drained(FrameBlock.from_frames(rows), reached_us)

    def close(self) -> None:
        """Let the interface go."""
        bus, self._bus, self.state = self._bus, None, "absent"
        if bus is not None:
            try:
                bus.shutdown()
            except Exception:  # closing a device that is gone
                self.counters["close_failed"] += 1

    def _take(self, message: can.Message) -> None:
        if not abs(message.timestamp) < _STAMP_MAX_S:  # or not a number
            self.counters["unusable_stamp"] += 1
            return
        row = _row(message)
        self._ahead_us = row[0] - time.monotonic_ns() // 1000
        if not self._is_wanted(row[1]):
            return
        if self._echoes and row[1:] in self._echoes:
            self._echoes.remove(row[1:])
        else:
            self._rows.append(row)

    def _is_wanted(self, can_id: int) -> bool:
        wanted = self._wanted.get(can_id)
        if wanted is None:
            wanted = bool(can_id & ERROR) or any(can_id & mask == value for value, mask in self._filters)
            if len(self._wanted) >= _IDS_REMEMBERED:
                self._wanted.clear()
            self._wanted[can_id] = wanted
        return wanted

    def _open(self) -> None:
        options = dict(self._config.options)
        if self._config.bitrate is not None:
            options.setdefault("bitrate", self._config.bitrate)
        try:
            self._bus = can.Bus(
                interface=self._config.interface,
                channel=self._config.channel,
                **options,
            )
        except (can.CanInterfaceNotImplementedError, ImportError):
            raise
        except Exception as error:  # drivers raise anything when a device is not there
            self.reason = _words_of(error)
            self.counters["open_failed"] += 1
            self._retry_at_s = time.monotonic() + REOPEN_S
            return
        self.opened += 1
        self.state, self.reason = "up", ""

    def _reopen(self) -> None:
        if time.monotonic() >= self._retry_at_s:
            self._open()

    def _failed(self, error: Exception) -> None:
        kind = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", type(error).__name__).lower()
        self.counters[f"receive_{kind}"] += 1
        self.counters["interface_lost"] += 1
        self.close()
        self.reason = _words_of(error)
        self._retry_at_s = time.monotonic() + REOPEN_S


class PythonCanTransmitter:
    """Sends through the receiver's bus."""

    def __init__(self, receiver: PythonCanReceiver) -> None:
        self._receiver = receiver
        self.counters: Counter[str] = Counter()

    def send(self, can_id: int, payload: bytes) -> bool:
        """Send one frame if the interface takes it at once; see `canest.bus.link.Transmitter`."""
        bus = self._receiver._bus  # two halves of one bus
        if bus is None:
            self.counters["dropped_interface_absent"] += 1
            return False
        message = can.Message(
            arbitration_id=can_id & ID_MASK, is_extended_id=bool(can_id & EXTENDED), data=payload
        )
        try:
            bus.send(message, timeout=0)
        except Exception:  # full queues and dead devices, in every driver's own words
            self.counters["dropped_send_failed"] += 1
            return False
        self.counters["sent"] += 1
        if self._receiver._echoes is not None:
            self._receiver._echoes.append((can_id, payload))
        return True


def _words_of(error: Exception) -> str:
    text = (error.strerror if isinstance(error, OSError) else "") or str(error)
    # what is neither of the system nor of python-can is a driver that stumbles: its kind tells half of it
    kind = "" if text and isinstance(error, OSError | can.CanError) else type(error).__name__
    return ": ".join(part for part in (kind, " ".join(text.split())) if part)


def _row(message: can.Message) -> tuple[int, int, bytes]:
    can_id = message.arbitration_id & ID_MASK
    if message.is_extended_id:
        can_id |= EXTENDED
    if message.is_remote_frame:
        can_id |= REMOTE
    if message.is_error_frame:
        can_id = can_id & ~EXTENDED | ERROR
    payload = b"" if message.is_remote_frame else bytes(message.data)
    return round(message.timestamp * 1e6), can_id, payload
